"""The program `ces`: finds the subcommand's module, imports only that, and runs it."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence
from importlib import import_module
from types import FrameType
from typing import NoReturn

from ces_observer import __version__

PROGRAMS = {
    "info": "look at recordings: signals, rates, gaps, ranges, coverage",
    "import": "turn dyno logs (CSV, JSON, MAT) into bags",
    "rig": "run an experiment on the virtual rig and record it (synthetic data)",
    "identify": "identify a force model from recordings",
    "validate": "judge a model on recordings by free-run simulation",
    "replay": "run the estimator over a recording as the observer node would",
    "simulate": "run any simulation over a recording and write its force as CSV",
    "export": "write a model as C source for a microcontroller, or as an FMU",
    "diagnose": "find where a simulation and reality disagree, which effect causes it, what it buys",
    "blind": "make, run and score blind tests of the diagnosis (synthetic data)",
}
MODULES = {
    "info": "bags.info",
    "import": "bags.import_",
    "rig": "rig.program",
    "identify": "identify.program",
    "validate": "identify.validate",
    "replay": "bags.replay",
    "simulate": "bags.simulate",
    "export": "identify.export",
    "diagnose": "diagnose.program",
    "blind": "blind.program",
}
ROS_ARGS = "--ros-args"


def usage() -> str:
    """Return the manual page of `ces`."""
    rows = "\n".join(f"  {name:<10}{text}" for name, text in PROGRAMS.items())
    return (
        "usage: ces PROGRAM [OPTIONS]\n\n"
        "Identify models of a semi-active damper from rig recordings and run them as force observers.\n\n"
        f"programs:\n{rows}\n\n"
        "options:\n  -h, --help     show this help\n  --version      show the version\n\n"
        "Each program tells its options with `ces PROGRAM --help`; with ROS 2 sourced the same programs run as\n"
        "`ros2 run ces_observer PROGRAM`. Nodes are `observer`, `controller`, `rig`, and `identify` with --ros-args.\n"
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run `ces`; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in ("-h", "--help", "help"):
        print(usage(), end="")
        return 0
    if words[0] == "--version":
        print(f"ces_observer {__version__}")
        return 0
    return _run(words[0], words[1:])


def _run(name: str, words: Sequence[str]) -> int:
    if name not in PROGRAMS:
        print(f"ces: error: no program '{name}'; there are {', '.join(PROGRAMS)}", file=sys.stderr)
        return 2
    if ROS_ARGS in words:
        line = f"{ROS_ARGS} is of nodes; 'ros2 run ces_observer identify' and 'rig' are such, in a sourced ROS 2"
        print(f"ces {name}: error: {line}", file=sys.stderr)
        return 2
    _quit_at_ctrl_c()
    from ces_cli.terminal.terminal import run

    return run(name, import_module(f"ces_cli.{MODULES[name]}").main, words)


def _quit_at_ctrl_c() -> None:
    """End at Ctrl-C with one line while modules are imported; `terminal.run` takes over from here."""
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    if threading.current_thread() is threading.main_thread() and not ignored:
        signal.signal(signal.SIGINT, _quit)


def _quit(number: int, frame: FrameType | None) -> NoReturn:
    os.write(2, b"ces: interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    sys.exit(main())
