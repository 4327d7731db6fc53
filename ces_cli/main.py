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

PROGRAMS = {  # module and summary by name
    "info": ("bags.info", "inspect recordings: signals, rates, gaps, ranges, coverage"),
    "import": ("bags.import_", "convert dyno logs (CSV, JSON, MAT) to bags"),
    "rig": ("rig.program", "run an experiment on the virtual rig and record it (synthetic data)"),
    "learn-stroke": ("rig.learn_stroke", "learn the command that makes the rig's piston follow a wanted stroke"),
    "identify": ("identify.program", "identify a force model from recordings"),
    "iterate": ("iterate.program", "design experiments, run them on a rig and identify, until the model is good"),
    "validate": ("identify.validate", "evaluate a model on recordings by free-run simulation"),
    "compare": ("compare.program", "compare models on the same recordings: costs, and whether they differ"),
    "serve": ("serve.program", "browse models, reports, results and running searches of a folder as pages"),
    "replay": ("bags.replay", "run the estimator over a recording as the observer node would"),
    "simulate": ("bags.simulate", "run any simulation over a recording and write its force as CSV"),
    "export": ("identify.export", "write a model as C source for a microcontroller, or as an FMU"),
    "diagnose": (
        "diagnose.program",
        "find where a simulation differs from reality and which missing effect is the cause",
    ),
    "blind": ("blind.program", "create, run and score blind tests of the diagnosis (synthetic data)"),
}
ROS_ARGS = "--ros-args"


def _usage() -> str:
    rows = "\n".join(f"  {name:<14}{text}" for name, (_, text) in PROGRAMS.items())
    return (
        "usage: ces PROGRAM [OPTIONS]\n\n"
        "Identify models of a semi-active damper from rig recordings and run them as force observers.\n\n"
        f"programs:\n{rows}\n\n"
        "options:\n  -h, --help     show this help\n  --version      show the version\n\n"
        "`ces PROGRAM --help` lists a program's options. With ROS 2 sourced, `ros2 run ces_observer PROGRAM` runs the\n"
        "same programs. The nodes are `observer`, `controller`, `rig`, and `identify` with --ros-args.\n"
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run `ces`; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in ("-h", "--help", "help"):
        print(_usage(), end="")
        return 0
    if words[0] == "--version":
        print(f"ces_observer {__version__}")
        return 0
    return _run(words[0], words[1:])


def _run(name: str, words: Sequence[str]) -> int:
    if name not in PROGRAMS:
        print(f"ces: error: unknown program '{name}'; expected one of {', '.join(PROGRAMS)}", file=sys.stderr)
        return 2
    if ROS_ARGS in words:
        text = f"{ROS_ARGS} is only for nodes; with ROS 2 sourced, run 'ros2 run ces_observer identify' or '... rig'"
        print(f"ces {name}: error: {text}", file=sys.stderr)
        return 2
    _quit_at_ctrl_c()
    from ces_cli.terminal.terminal import run

    return run(name, import_module(f"ces_cli.{PROGRAMS[name][0]}").main, words)


def _quit_at_ctrl_c() -> None:
    """Exit at Ctrl-C with one line while modules are imported; `terminal.run` installs its own handler later."""
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    if threading.current_thread() is threading.main_thread() and not ignored:
        signal.signal(signal.SIGINT, _quit)


def _quit(number: int, frame: FrameType | None) -> NoReturn:
    os.write(2, b"ces: interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    sys.exit(main())
