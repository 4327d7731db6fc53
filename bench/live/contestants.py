"""The compared nodes, each built and run as a process of its own, the generator that loads one, and busy cores."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType

from bench.measurement import print_note

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
FOLDER = ROOT / "out" / "live"  # kept, so that a second run builds only what has changed
TWIN_PACKAGE = "ces_observer_cpp"


class BuildError(Exception):
    """A program that cannot be built, in one line."""


def build_programs() -> Path:
    """Build generator and relay; return their folder. Raises BuildError."""
    folder = FOLDER / "programs"
    for tool in ("cmake", "c++"):
        if shutil.which(tool) is None:
            raise BuildError(f"{tool} is missing; the generator and the relay are in C++")
    _run(["cmake", "-S", str(HERE / "relay_cpp"), "-B", str(folder)])
    _run(["cmake", "--build", str(folder)])
    return folder


def build_twin() -> Path:
    """Build the C++ package; return its executable. Raises BuildError."""
    workspace = FOLDER / "twin"
    workspace.mkdir(parents=True, exist_ok=True)
    flags = ["--base-paths", str(ROOT / TWIN_PACKAGE), "--cmake-args", "-DCMAKE_BUILD_TYPE=Release"]
    _run(["colcon", "build", *flags], workspace)
    return workspace / "install" / TWIN_PACKAGE / "lib" / TWIN_PACKAGE / "observer"


def export_flat(model: Path) -> Path:
    """Write the flat file of a model, which the C++ package loads; return its path. Raises BuildError."""
    flat = FOLDER / "model.ces"
    _run([sys.executable, "-m", "ces_cli.main", "export", str(model), "--out", str(flat), "--overwrite"])
    return flat


def _run(command: Sequence[str], folder: Path = ROOT) -> None:
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BuildError(f"{command[0]}: {error}") from None
    if done.returncode:
        raise BuildError(f"{' '.join(command[:4])}: {' '.join((done.stderr or done.stdout).split()[-40:])}")


PROGRAM = "import os, sys\nos.sched_setaffinity(0, {int(sys.argv[1])})\nwhile True:\n    pass"


class Hogs:
    """A busy process on each core while the context lasts; none if `busy` is False."""

    def __init__(self, busy: bool) -> None:
        self._cores = sorted(os.sched_getaffinity(0)) if busy else []
        self._processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Hogs:
        self._processes = [subprocess.Popen([sys.executable, "-c", PROGRAM, str(core)]) for core in self._cores]
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.wait()


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
    """The generator's messages, a position and a current at a time."""

    rate_Hz: float
    seconds: float
    warm_up_s: float


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
        twin = ("-p", f"model:={export_flat(model)}", *words)
        found.append(Contestant(TWIN, (str(build_twin()),), "observer", twin))
    except BuildError as error:
        print_note(f"no C++ twin: {error}")
    return programs / "generator", found


class ContestField:
    """All contestants, running at the same time; `measure` loads one of them while the others idle.

    The generator runs under SCHED_FIFO with `priority`, if that is permitted.
    """

    def __init__(self, contestants: Sequence[Contestant], generator: Path, *, priority: int) -> None:
        self._generator = [str(generator), str(priority)]
        self._numbers = {one.name: k for k, one in enumerate(contestants)}
        self._processes = [self._start(one, k) for k, one in enumerate(contestants)]

    def __enter__(self) -> ContestField:
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
        parameters: dict[str, object] = {**asdict(load), "pid": self._processes[k].pid}
        if observed:
            parameters["observed"] = observed
        words = ["--ros-args", "-r", f"__ns:={_namespace(k)}"]
        words += ["-r", f"estimate:={_namespace(k)}/{contestant.node}/estimate"]
        words += [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        done = subprocess.run([*self._generator, *words], stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{contestant.name} at {load.rate_Hz:g} Hz: the generator received nothing to measure")
        return GeneratorRun(**json.loads(done.stdout))

    def _start(self, contestant: Contestant, number: int) -> subprocess.Popen[bytes]:
        words = [*contestant.command, "--ros-args", "-r", f"__ns:={_namespace(number)}", *contestant.ros_args]
        return subprocess.Popen(words, cwd=ROOT, stderr=subprocess.DEVNULL, start_new_session=True)


def _namespace(number: int) -> str:
    return f"/live{number}"
