"""The compared nodes, each a process in its own namespace, and the C++ programs, built when needed."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
PYTHON_RELAYS = {
    "single": "relay, rclpy.spin",
    "events": "relay, rclpy EventsExecutor",
    "raw": "relay, rclpy EventsExecutor, raw bytes",
    "both": "the same, receives the current too",
}
CPP_RELAYS = {"single": "relay, rclcpp::spin", "events": "relay, rclcpp EventsExecutor"}


@dataclass(frozen=True)
class Contestant:
    """A node as a command; `node` is its name, `baseline` names the empty relay of the same executor."""

    name: str
    command: tuple[str, ...]
    node: str = "relay"
    ros_args: tuple[str, ...] = ()
    baseline: str = ""


@dataclass(frozen=True)
class GeneratorLoad:
    """The generator's messages: a current every `current_every` samples, midway between two if `current_apart`."""

    rate_Hz: float
    seconds: float
    warm_up_s: float
    current_every: int
    current_apart: bool
    max_gap_s: float  # bridged by the model
    after_gap_s: float  # warm-up after a longer gap


@dataclass(frozen=True)
class GeneratorRun:
    """The results of one run of the generator; times in us, CPU as a share of one core.

    `after_pause` samples had no estimate because the generator itself had paused for longer than the model bridges.
    """

    sent: int
    lost: int
    after_pause: int
    p50_us: float
    p99_us: float
    max_us: float
    cpu_share: float
    late_p50_us: float
    late_p99_us: float


def python_relays() -> list[Contestant]:
    return [Contestant(name, (sys.executable, str(HERE / "relay.py"), kind)) for kind, name in PYTHON_RELAYS.items()]


def cpp_relays(folder: Path) -> list[Contestant]:
    return [Contestant(name, (str(folder / "relay"), kind)) for kind, name in CPP_RELAYS.items()]


def observer(name: str, model: Path, baseline: str, *parameters: str) -> Contestant:
    """Return the observer with a model and further parameters as `name:=value`."""
    words = [word for one in (f"model:={model}", *parameters) for word in ("-p", one)]
    return Contestant(name, (sys.executable, "-m", "ces_observer.nodes.observer"), "observer", tuple(words), baseline)


def build_cpp(folder: Path) -> bool:
    """Build relay and generator into `folder`; returns False, printing the reason, if that is impossible."""
    if shutil.which("cmake") is None or shutil.which("c++") is None:
        print_note("no C++: cmake or a compiler is missing; only the relays in Python are measured")
        return False
    for command in (["-S", str(HERE / "relay_cpp"), "-B", str(folder)], ["--build", str(folder)]):
        done = subprocess.run(["cmake", *command], capture_output=True, text=True, check=False)
        if done.returncode:
            print_note(f"no C++: {' '.join(done.stderr.split()[-40:])}")
            return False
    return True


class Field:
    """All contestants, running at the same time; `measure` loads one of them while the others idle."""

    def __init__(self, contestants: Sequence[Contestant], generator: Sequence[str]) -> None:
        self._generator = generator
        self._numbers = {one.name: k for k, one in enumerate(contestants)}
        self._processes = [_start(one, k) for k, one in enumerate(contestants)]

    def __enter__(self) -> Field:
        time.sleep(3.0)
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
        parameters = {**asdict(load), "pid": self._processes[k].pid}
        words = ["--ros-args", "-r", f"__ns:={_namespace(k)}", "-r", f"estimate:={contestant.node}/estimate"]
        words += [word for name, value in parameters.items() for word in ("-p", f"{name}:={_word(value)}")]
        done = subprocess.run([*self._generator, *words], stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{contestant.name} at {load.rate_Hz:g} Hz: the generator received nothing to measure")
        return GeneratorRun(**json.loads(done.stdout))

    def resident_kB(self, contestant: Contestant) -> int:
        """Return the resident memory of a contestant [kB]."""
        status = Path(f"/proc/{self._processes[self._numbers[contestant.name]].pid}/status").read_text(encoding="utf-8")
        return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")))


def _start(contestant: Contestant, number: int) -> subprocess.Popen[bytes]:
    words = [*contestant.command, "--ros-args", "-r", f"__ns:={_namespace(number)}", *contestant.ros_args]
    return subprocess.Popen(words, cwd=ROOT, stderr=subprocess.DEVNULL, start_new_session=True)


def _word(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _namespace(number: int) -> str:
    return f"/live{number}"


def print_note(text: str) -> None:
    """Print on standard error: standard output contains only the table."""
    print(text, file=sys.stderr, flush=True)
