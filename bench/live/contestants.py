"""The compared nodes, each a process of its own, and runs of the generator that loads one of them."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from builds import HERE, ROOT, BuildError, build_programs, build_twin

CPP_RELAY, PYTHON_RELAY = "empty relay, C++", "empty relay, Python"
OBSERVER, TWIN = "**Python node**", "**C++ twin**"


@dataclass(frozen=True)
class Contestant:
    """A node as a command; `node` is its name. An observer counts its samples in its diagnostics."""

    name: str
    command: tuple[str, ...]
    node: str = "relay"
    ros_args: tuple[str, ...] = ()

    @property
    def is_observer(self) -> bool:
        return self.node == "observer"


@dataclass(frozen=True)
class GeneratorLoad:
    """The generator's messages: a current every `current_every` samples, midway between two if `current_apart`."""

    rate_Hz: float
    seconds: float
    warm_up_s: float
    current_every: int = 1
    current_apart: bool = False


@dataclass(frozen=True)
class GeneratorRun:
    """The results of one run of the generator, as relay_cpp/generator.cpp defines them; times in us."""

    sent: int
    received: int
    late: int
    all_sent: int
    lost_in: int
    lost_out: int
    withheld: dict[str, int]
    p50_us: float
    p99_us: float
    max_us: float
    cpu_share: float
    late_p50_us: float
    late_p99_us: float
    late_max_us: float
    priority: int

    @property
    def lost(self) -> int:
        """Samples of the whole run that were lost before or after the node."""
        return self.lost_in + self.lost_out

    @property
    def without_estimate(self) -> int:
        """Samples after the warm-up that the node withheld, or that were lost then."""
        return self.sent - self.received


def make_contestants(model: Path, parameters: Sequence[str] = ()) -> tuple[Path, list[Contestant]]:
    """Build what is in C++; return the generator and the contestants, without the twin if it cannot be built.

    `parameters` of the observers are NAME:=VALUE. Raises BuildError.
    """
    programs = build_programs()
    words = [word for one in parameters for word in ("-p", one)]
    python = (sys.executable, "-m", "ces_observer.nodes.observer")
    found = [
        Contestant(CPP_RELAY, (str(programs / "relay"),)),
        Contestant(PYTHON_RELAY, (sys.executable, str(HERE / "relay.py"))),
        Contestant(OBSERVER, python, "observer", ("-p", f"model:={model}", *words)),
    ]
    try:
        found.append(Contestant(TWIN, (str(build_twin(model)),), "observer", tuple(words)))
    except BuildError as error:
        print_note(f"no C++ twin: {error}")
    return programs / "generator", found


class Field:
    """All contestants, running at the same time; `measure` loads one of them while the others idle.

    With `shared` they all have the same inputs, so that `measure` loads them all. The generator runs under SCHED_FIFO
    with `priority`, if that is permitted.
    """

    def __init__(
        self, contestants: Sequence[Contestant], generator: Path, *, priority: int, shared: bool = False
    ) -> None:
        self._generator = [str(generator), str(priority)]
        self._shared = shared
        self._numbers = {one.name: k for k, one in enumerate(contestants)}
        self._processes = [self._start(one, k) for k, one in enumerate(contestants)]

    def __enter__(self) -> Field:
        time.sleep(4.0)
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._processes:
            process.send_signal(signal.SIGINT)
        for process in self._processes:
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()

    def measure(self, contestant: Contestant, load: GeneratorLoad) -> GeneratorRun:
        """Return the generator's results; raises RuntimeError if the node has ended or publishes nothing."""
        k = self._numbers[contestant.name]
        observed = f"{_namespace(k)}/observer" if contestant.is_observer else ""
        parameters: dict[str, object] = {**asdict(load), "pid": self.pid(contestant)}
        if observed:
            parameters["observed"] = observed
        inputs = 0 if self._shared else k
        words = ["--ros-args", "-r", f"__ns:={_namespace(inputs)}"]
        words += ["-r", f"estimate:={_namespace(k)}/{contestant.node}/estimate"]
        words += [word for name, value in parameters.items() for word in ("-p", f"{name}:={_word(value)}")]
        done = subprocess.run([*self._generator, *words], stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{contestant.name} at {load.rate_Hz:g} Hz: the generator received nothing to measure")
        return GeneratorRun(**json.loads(done.stdout))

    def pid(self, contestant: Contestant) -> int:
        return self._processes[self._numbers[contestant.name]].pid

    def _start(self, contestant: Contestant, number: int) -> subprocess.Popen[bytes]:
        words = [*contestant.command, "--ros-args", "-r", f"__ns:={_namespace(number)}", *contestant.ros_args]
        if self._shared:
            words += [
                f for name in ("joint_states", "valve_current") for f in ("-r", f"{name}:={_namespace(0)}/{name}")
            ]
        return subprocess.Popen(words, cwd=ROOT, stderr=subprocess.DEVNULL, start_new_session=True)


def _word(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _namespace(number: int) -> str:
    return f"/live{number}"


def print_note(text: str) -> None:
    """Print on standard error: standard output contains only the table."""
    print(text, file=sys.stderr, flush=True)
