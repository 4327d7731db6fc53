"""What every program shares: options, one-line errors with exit status 2, reading recordings with their warnings."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn, TextIO, TypeVar

from rich.console import Console

from ces_identify.recordings.bag_reader import read_recording
from ces_identify.recordings.checks import require_usable
from ces_identify.recordings.consistency import require_consistent
from ces_identify.recordings.recording import Recording
from ces_identify.recordings.signals_file import load_signals
from ces_observer.errors import CesError
from ces_observer.signals import Signals

Number = TypeVar("Number", int, float)

USER_ERROR = 2
INTERRUPTED = 130

out = Console()
err = Console(stderr=True)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Print `message` and where to find help, then exit with status 2."""
        self.exit(USER_ERROR, f"{self.prog}: error: {message}; see '{self.prog} --help'\n")


def parser(name: str, description: str, example: str) -> Parser:
    """Return the parser of the program `ces NAME`."""
    return Parser(
        prog=f"ces {name}",
        description=description,
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_signals(to: argparse.ArgumentParser) -> None:
    """Add the option --signals."""
    told = "where each signal is; FILE#NAME for one of several dampers in it (default: the packaged ones)"
    to.add_argument("--signals", type=Path, metavar="FILE", help=told)


def add_part(to: argparse.ArgumentParser) -> None:
    """Add the option --part."""
    to.add_argument(
        "--part",
        type=parse_part,
        default=(0.0, 1.0),
        metavar="FROM:TO",
        help="share of each recording to use (default 0:1)",
    )


def parse_part(text: str) -> tuple[float, float]:
    """Read `FROM:TO`, two shares of a recording."""
    first, _, last = text.partition(":")
    try:
        share = float(first or 0.0), float(last or 1.0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not FROM:TO, such as 0.6:1") from None
    if not 0.0 <= share[0] < share[1] <= 1.0:
        raise argparse.ArgumentTypeError(f"'{text}': expected 0 <= FROM < TO <= 1")
    return share


def number_between(low: float, high: float) -> Callable[[str], float]:
    """Return a reader of a number in [low, high]."""
    return _parser_between(float, "a number", low, high)


def integer_between(low: int, high: int) -> Callable[[str], int]:
    """Return a reader of a whole number in [low, high]."""
    return _parser_between(int, "a whole number", low, high)


def _parser_between(kind: Callable[[str], Number], name: str, low: Number, high: Number) -> Callable[[str], Number]:
    def number(text: str) -> Number:
        try:
            value = kind(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{text}' is not {name}") from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is outside {low:.10g} to {high:.10g}")
        return value

    return number


def read_all(paths: Iterable[Path], signals: Signals, need: Sequence[str] = ("position", "current")) -> list[Recording]:
    """Read and check the recordings; warnings go to the terminal, one line each. Raises CesError."""
    return [read_one(path, signals, need) for path in paths]


def read_one(path: Path, signals: Signals, need: Sequence[str] = ("position", "current")) -> Recording:
    """Read and check one recording; warnings go to the terminal, one line each. Raises CesError."""
    with warnings.catch_warnings(record=True) as caught, err.status(f"reading {path}"):
        warnings.simplefilter("always")
        recording = read_recording(path, signals, need)
        findings = require_usable(recording)
    for text in [str(w.message) for w in caught] + [f"{recording.name}: {f.text}" for f in findings]:
        print_warning(text)
    return recording


def warn_of_differences(recordings: Sequence[Recording]) -> None:
    """Warn of differences between recordings that belong together; raises CesError if units or signs differ."""
    for finding in require_consistent(recordings):
        print_warning(finding.text)


def print_warning(text: str) -> None:
    """Print a warning line to the error stream."""
    print(f"warning: {text}", file=sys.stderr)


def load_described_signals(options: argparse.Namespace) -> Signals:
    """Return the signals that --signals names."""
    return load_signals(options.signals)


def run(name: str, program: Callable[[Sequence[str] | None], int], argv: Sequence[str] | None = None) -> int:
    """Run `program`; a user's mistake becomes one line on stderr and exit status 2, Ctrl-C status 130."""
    try:
        interrupt_as_exception()
        status = program(argv)
        sys.stdout.flush()
        return status
    except CesError as error:
        _print_error(name, f"error: {error}")
    except BrokenPipeError:
        _silence(sys.stdout)
        return 0
    except OSError as error:
        _print_error(name, f"error: {_describe_system_error(error)}")
        _silence(sys.stdout)
    except KeyboardInterrupt:
        _print_error(name, "interrupted")
        return INTERRUPTED
    return USER_ERROR


def interrupt_as_exception() -> None:
    """Let Ctrl-C raise KeyboardInterrupt from here on, whatever it did while modules were imported."""
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _print_error(name: str, text: str) -> None:
    with suppress(OSError):  # the error stream may be full or gone, too
        print(f"ces {name}: {text}", file=sys.stderr)


def _describe_system_error(error: OSError) -> str:
    """Return what the system says, with the file if it says which."""
    what = error.strerror or str(error)
    return f"{error.filename}: {what}" if error.filename else f"{what}, while reading or writing"


def _silence(stream: TextIO) -> None:
    """Send what is left in a stream that cannot be written nowhere, so that Python's exit does not fail over it."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
