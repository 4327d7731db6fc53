"""The program `ces`: finds the subcommand's module, imports only that, and runs it."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from importlib import import_module
from types import FrameType
from typing import NoReturn

from ces_cli.terminal.compiled_code import require_folder_for_compiled_code
from ces_identify.jobs import end_process

ProgramTable = Mapping[str, tuple[str, str]]

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
    "serve": ("desk.program", "browse models, reports and results of a folder as pages"),
    "replay": ("bags.replay", "run the estimator over a recording as the observer node would"),
    "simulate": ("bags.simulate", "run any simulation over a recording and write its force as CSV"),
    "export-data": ("bags.export_data", "write recordings and a model's estimates as CSV or Parquet"),
    "export": ("identify.export", "write a model as C source, as an FMU, or as a ROS 2 package in C++"),
    "calibrate": ("calibrate", "fit the named parameters of a simulation to recordings"),
    "diagnose": (
        "diagnose.program",
        "find where a simulation differs from reality and which missing effect is the cause",
    ),
    "blind": ("blind.program", "create, run and score blind tests of the diagnosis (synthetic data)"),
    "schema": ("schema", "print the JSON Schema of a kind of YAML file, for editors"),
}
ROS_ARGS = "--ros-args"
ENDS = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
M_MMAP_THRESHOLD, LARGE = -3, 4 << 20  # of malloc.h, and bytes: larger arrays are given back at once
BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # the environment's own values win


def main(argv: Sequence[str] | None = None) -> int:
    """Run `ces`; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    if words and words[0] == "help":
        words = [*words[1:], "--help"]  # `ces help blind make` is `ces blind make --help`
    if not words or words[0] in ("-h", "--help"):
        return _print_usage()
    if words[0] == "--version":
        return _run_program("--version", "versions", words[1:])
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
        near = get_close_matches(name, PROGRAMS, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else f"; expected one of {', '.join(PROGRAMS)}"
        print(f"ces: error: unknown program '{name}'{hint}", file=sys.stderr)
        return 2
    if ROS_ARGS in words:
        text = f"{ROS_ARGS} is only for nodes; with ROS 2 sourced, run 'ros2 run ces_observer identify' or '... rig'"
        print(f"ces {name}: error: {text}", file=sys.stderr)
        return 2
    return _run_program(name, PROGRAMS[name][0], words)


def _run_program(name: str, module: str, words: Sequence[str]) -> int:
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
    from ces_cli.terminal.terminal import run

    try:
        return run(name, import_module(f"ces_cli.{module}").main, words)
    finally:
        for number in before.keys() - {signal.SIGINT}:  # Ctrl-C while Python ends is no error
            signal.signal(number, before[number] or signal.SIG_DFL)


def _quit(number: int, frame: FrameType | None) -> NoReturn:
    ended = f"ended by {signal.Signals(number).name}; finished results are kept"
    with suppress(OSError):  # the terminal may be gone
        os.write(2, b"ces: interrupted\n" if number == signal.SIGINT else f"ces: {ended}\n".encode())
    end_process(number)


if __name__ == "__main__":
    sys.exit(main())
