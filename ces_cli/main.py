"""The program `ces`, and what `ros2 run ces_observer NAME` starts: finds the program's module and imports only that.

With `--ros-args`, which ros2 launch always adds, `identify` and `rig` run as nodes; `rig` also without any arguments.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import platform
import re
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from ces_cli.terminal.heartbeat import heartbeat
from ces_identify.jobs import end_process
from ces_observer import __version__
from ces_observer.errors import CesError, suggest

ProgramTable = Mapping[str, tuple[str, str]]
Program = Callable[[Sequence[str] | None], int]

PROGRAMS: ProgramTable = {  # module and summary by name
    "info": ("bags.info", "inspect recordings: signals, rates, gaps, ranges, coverage"),
    "signals": ("bags.signals", "propose a signals file from the topics of recordings, with reasons"),
    "import": ("bags.import_", "convert logs (CSV, JSON, MAT, MDF, CAN, ROS 1, Parquet) to bags"),
    "characterise": (
        "bags.characterise",
        "show force over speed, loops, work, hysteresis and valve response of a damper",
    ),
    "rig": ("rig", "run an experiment on the virtual rig and record it (synthetic data)"),
    "identify": ("identify.program", "identify a force model from recordings"),
    "iterate": ("iterate", "design experiments, run them on a rig and identify, until the model is good"),
    "validate": ("identify.validate", "evaluate a model on recordings by free-run simulation"),
    "compare": ("compare", "compare models on the same recordings: costs, and whether they differ"),
    "serve": ("desk.program", "work in a folder with the browser: see recordings, run programs, read reports"),
    "replay": ("bags.replay", "run the estimator over a recording as the observer node would"),
    "simulate": ("bags.simulate", "run any simulation over a recording and write its force as CSV"),
    "export-data": ("bags.export_data", "write recordings and a model's estimates as CSV or Parquet"),
    "export": ("identify.export", "write a model as C source, as an FMU, or as a ROS 2 package in C++"),
    "calibrate": ("calibrate", "fit the named parameters of a simulation to recordings"),
    "diagnose": (
        "diagnose.program",
        "find where a simulation differs from reality and which missing effect is the cause",
    ),
    "blind": ("blind", "create, run and score blind tests of the diagnosis (synthetic data)"),
    "schema": ("schema", "print the JSON Schema of a kind of YAML file, for editors"),
}
ROS_ARGS = "--ros-args"
ENDS = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
M_MMAP_THRESHOLD, LARGE = -3, 4 << 20  # of malloc.h, and bytes: larger arrays are given back at once
# what no node of a vehicle imports
DESK = ("numpy", "scipy", "numba", "jinja2", "rich", "yaml", "joblib", "rosbags", "mcap")
NODES = {"identify": "ces_cli.identify.node", "rig": "ces_rig.live.node"}
CACHE_VARIABLE = "NUMBA_CACHE_DIR"
PACKAGE = Path(__file__).resolve().parents[1] / "ces_identify" / "numerics"
DISTRIBUTION = "ces_observer"
DEVELOPMENT = ("dev", "test", "docs", "bench", "fuzz")  # extras that no program uses
BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # the environment's own values win


def main(argv: Sequence[str] | None = None) -> int:
    """Run `ces`; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    if words and words[0] == "help":
        words = [*words[1:], "--help"]  # `ces help blind make` is `ces blind make --help`
    if not words or words[0] in ("-h", "--help"):
        return _print_usage()
    if words[0] == "--version":
        return _run_program("--version", lambda: print_versions, words[1:])
    return _run(words[0], words[1:])


def _print_usage() -> int:
    rows = "\n".join(f"  {name:<14}{text}" for name, (_, text) in PROGRAMS.items())
    text = (
        "usage: ces PROGRAM [OPTIONS]\n\n"
        "Identify models of a semi-active damper from rig recordings and run them as force observers.\n\n"
        f"programs:\n{rows}\n\n"
        "options:\n  -h, --help     show this help\n  --version      show the versions in use, with --json as JSON\n\n"
        "`ces help PROGRAM` lists a program's options. With ROS 2 sourced, `ros2 run ces_observer PROGRAM` runs the\n"
        "same programs. The nodes are `observer`, `controller`, `rig`, and `identify` with --ros-args.\n"
    )
    print(text, end="", flush=True)
    return 0


def _run(name: str, words: Sequence[str]) -> int:
    if name not in PROGRAMS:
        print(f"ces: error: unknown program '{name}'{suggest(name, PROGRAMS)}", file=sys.stderr)
        return 2
    if ROS_ARGS in words:
        text = f"{ROS_ARGS} is only for nodes; with ROS 2 sourced, run 'ros2 run ces_observer identify' or '... rig'"
        print(f"ces {name}: error: {text}", file=sys.stderr)
        return 2
    return _run_program(name, lambda: import_module(f"ces_cli.{PROGRAMS[name][0]}").main, words)


def _run_program(name: str, load: Callable[[], Program], words: Sequence[str]) -> int:
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (getattr(signal, end) for end in ENDS if hasattr(signal, end)):
            if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
                before[number] = signal.signal(number, _quit)  # `run` installs its own handler of SIGINT later
    for variable in BLAS_THREADS:
        os.environ.setdefault(variable, "1")  # matrices are small here; waiting threads cost ten times the time if busy
    with suppress(OSError, AttributeError, TypeError):  # only glibc keeps freed memory of this size for later
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE)
    require_folder_for_compiled_code()
    try:
        with heartbeat.beat(f"ces {name}: starting"):
            from ces_cli.terminal.terminal import run

            program = load()
            heartbeat.change(f"ces {name}: working")
            return run(name, program, words)
    finally:
        for number in before.keys() - {signal.SIGINT}:  # Ctrl-C while Python ends is no error
            signal.signal(number, before[number] or signal.SIG_DFL)


def require_folder_for_compiled_code() -> None:
    """Set NUMBA_CACHE_DIR to a folder of this run if none of the usual folders can be written, with a warning.

    Without any such folder Numba ends a program while its modules are imported.
    """
    if any(map(_is_writable, _usual_folders())):
        return
    folder = tempfile.mkdtemp(prefix="ces_observer_")  # private: code is loaded from it
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[CACHE_VARIABLE] = folder
    text = "compiled code is kept for this run only, because neither the package nor the home can be written"
    print(f"warning: {text}; name a folder in {CACHE_VARIABLE} to start faster", file=sys.stderr)


def _usual_folders() -> Iterator[Path]:
    if os.environ.get(CACHE_VARIABLE):
        yield Path(os.environ[CACHE_VARIABLE])
    yield PACKAGE / "__pycache__"
    yield Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "numba"


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, RuntimeError):  # no home at all
        return False
    return True


def _quit(number: int, frame: FrameType | None) -> NoReturn:
    ended = f"ended by {signal.Signals(number).name}; finished results are kept"
    with suppress(OSError):  # the terminal may be gone
        os.write(2, b"ces: interrupted\n" if number == signal.SIGINT else f"ces: {ended}\n".encode())
    end_process(number)


def print_versions(argv: Sequence[str] | None = None) -> int:
    """Print the versions of the suite, Python and its packages, of ROS 2, and of the machine; returns the exit status.

    Raises CesError for words other than --json.
    """
    from ces_cli.terminal.outputs import print_document

    words = list(argv or ())
    if words not in ([], ["--json"]):
        raise CesError(f"found '{' '.join(words)}'; expected nothing more, or --json")
    facts = find_versions()
    if words:
        print_document("version", facts)
        return 0
    packages = facts.pop("packages")
    rows = {**facts, **packages}
    print(
        "\n".join([f"{DISTRIBUTION} {__version__}", *(f"{name:<13} {fact or 'absent'}" for name, fact in rows.items())])
    )
    return 0


def find_versions() -> dict[str, Any]:
    """Return the versions by the suite's own metadata: None if absent; no packages if it was never installed."""
    try:
        lines = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        lines = []
    used = [line for line in lines if not any(f'extra == "{extra}"' in line for extra in DEVELOPMENT)]
    return {
        "python": f"{platform.python_version()} ({sys.executable})",
        "platform": f"{platform.platform()}, {os.cpu_count() or 1} processors",
        "ROS 2": os.environ.get("ROS_DISTRO"),
        "middleware": os.environ.get("RMW_IMPLEMENTATION"),
        "packages": {name: _find_version(name) for name in (re.split(r"[^\w.-]", line)[0] for line in used)},
    }


def _find_version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def run_for_ros() -> int:
    """Run the node or program named by this process's executable; returns the exit status."""
    name, words = Path(sys.argv[0]).name, sys.argv[1:]
    if missing := [library for library in DESK if find_spec(library) is None]:
        cure = "run 'rosdep install --from-paths src --ignore-src' without CES_VEHICLE, and 'pip install rosbags mcap'"
        print(f"ces {name}: error: not installed: {', '.join(missing)}, as on a vehicle; {cure}", file=sys.stderr)
        return 2
    if not is_node(name, words):
        return main([name, *words])
    signal.signal(signal.SIGINT, _end_start)
    status: int = import_module(NODES[name]).main(sys.argv)
    return status


def _end_start(number: int, frame: FrameType | None) -> NoReturn:
    """End in order at Ctrl-C while modules are imported; the node installs its own handler later."""
    os._exit(0)


def is_node(name: str, words: Sequence[str]) -> bool:
    """Return whether NAME runs as a node with these arguments."""
    return name in NODES and (ROS_ARGS in words or (name == "rig" and not words))


if __name__ == "__main__":
    sys.exit(main())
