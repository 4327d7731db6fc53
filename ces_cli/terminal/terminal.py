"""What every program shares: options, tables, one-line errors with exit status 2, recordings read with warnings."""

from __future__ import annotations

import argparse
import csv
import io
import os
import signal
import sys
import textwrap
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from traceback import walk_tb
from typing import Any, NoReturn, TextIO, TypeVar

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.table import Column, Table

from ces_cli.terminal.compiled_code import VARIABLE
from ces_cli.terminal.option_rules import OptionRule, find_given, require_applicable
from ces_cli.terminal.outputs import add_report
from ces_identify.preparation.weighting import FORMS
from ces_identify.recordings.bag_reader import LogTimeWarning, read_recording
from ces_identify.recordings.checks import require_usable
from ces_identify.recordings.recording import Recording
from ces_identify.recordings.signals_file import load_signals
from ces_observer.errors import CesError
from ces_observer.signals import Signals

Number = TypeVar("Number", int, float)

FORCE = ("position", "current", "force")  # signals of a recording with a measured force
USER_ERROR = 2
MIN_TEXT_WIDTH = 12  # characters of a column of texts that may wrap
INTERRUPTED = 130
CACHE_MODULE = str(Path("numba", "core", "caching.py"))

_said: set[str] = set()  # warnings that a run prints once; `run` empties it
out = Console()
err = Console(stderr=True)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, with `rules` on the options that apply together."""

    rules: tuple[OptionRule, ...] = ()
    _inside = False  # another method of this parser is parsing

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> argparse.Namespace:  # type: ignore[override]
        """Return the options; raises CesError for one that does not apply."""
        words = self._words(args)
        with self._inside_a_method():
            options = super().parse_args(words, namespace)
        return self._apply_rules(words, options)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Return the options and the words that are none; raises CesError for an option that does not apply."""
        if self._inside:
            return super().parse_known_args(args, namespace)
        words = self._words(args)
        with self._inside_a_method():
            options, unknown = super().parse_known_args(words, namespace)
        return self._apply_rules(words, options), unknown

    def parse_intermixed_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> argparse.Namespace:  # type: ignore[override]
        """Return the options, between which arguments may be; raises CesError for an option that does not apply."""
        words = self._words(args)
        with self._inside_a_method():
            options = super().parse_intermixed_args(words, namespace)
        return self._apply_rules(words, options)

    def error(self, message: str) -> NoReturn:
        """Print `message` and where to find help, then exit with status 2."""
        text = as_one_line(f"{self.prog}: error: {message}; see '{self.prog} --help'")
        self.exit(USER_ERROR, f"{text}\n")

    @contextmanager
    def _inside_a_method(self) -> Iterator[None]:
        """Let the methods that argparse calls from another one parse without the rules."""
        self._inside = True
        try:
            yield
        finally:
            self._inside = False

    def _words(self, args: Sequence[str] | None) -> list[str]:
        """Return the command line; an empty argument, such as a variable that is not set, is an error."""
        words = list(sys.argv[1:] if args is None else args)
        for before, word in zip(["", *words], words, strict=False):
            if not word or (word.startswith("--") and word.endswith("=")):
                self.error(f"{word.rstrip('=') or before or 'the first argument'}: a value is empty")
        return words

    def _apply_rules(self, words: Sequence[str], options: argparse.Namespace) -> argparse.Namespace:
        require_applicable(find_given(self, words, options), options, self.rules)
        return options


def parser(name: str, description: str, example: str) -> Parser:
    """Return the parser of the program `ces NAME`."""
    return Parser(
        prog=f"ces {name}",
        description=textwrap.fill(description, 100),
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_signals(to: argparse.ArgumentParser) -> None:
    """Add the option --signals."""
    text = "signals file (YAML); FILE#NAME for one of several dampers in it (default: the packaged file)"
    to.add_argument("--signals", type=Path, metavar="FILE", help=text)


def add_part(to: argparse.ArgumentParser) -> None:
    """Add the option --part."""
    text = "part of each recording to use, from 0 to 1 (default 0:1)"
    to.add_argument("--part", type=_parse_part, default=(0.0, 1.0), metavar="FROM:TO", help=text)


def add_weight(to: argparse.ArgumentParser, purpose: str) -> None:
    """Add the option --weight; `purpose` says what the weights do."""
    text = f"{purpose}; may be repeated: {FORMS} [m/s, share of the stroke, A, m]"
    to.add_argument("--weight", action="append", default=[], metavar="REGION=W", help=text)


def add_report_and_picture(to: argparse.ArgumentParser) -> None:
    """Add the options --report and --picture."""
    add_report(to)
    to.add_argument("--picture", type=Path, metavar="FILE", help="draw speed-force and time plots (.png, .svg, .pdf)")


def _parse_part(text: str) -> tuple[float, float]:
    first, _, last = text.partition(":")
    try:
        share = float(first or 0.0), float(last or 1.0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not FROM:TO, such as 0.6:1") from None
    if not 0.0 <= share[0] < share[1] <= 1.0:
        raise argparse.ArgumentTypeError(f"'{text}': expected 0 <= FROM < TO <= 1")
    return share


def number_between(low: float, high: float) -> Callable[[str], float]:
    """Return a function that parses a number in [low, high]."""
    return _parser_between(float, "a number", low, high)


def integer_between(low: int, high: int) -> Callable[[str], int]:
    """Return a function that parses a whole number in [low, high]."""
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


def read_one(path: Path, signals: Signals, need: Sequence[str] = FORCE[:2]) -> Recording:
    """Read and check a recording; warnings go to the terminal, one line each. Raises CesError."""
    with warnings.catch_warnings(record=True) as caught, err.status(f"reading {path}"):
        warnings.simplefilter("always")
        recording = read_recording(path, signals, need)
        findings = require_usable(recording)
    for warning in caught:
        _print_reading_warning(recording.name, warning.message)
    for finding in findings:
        print_warning(f"{recording.name}: {finding.text}")
    return recording


def _print_reading_warning(name: str, message: Warning | str) -> None:
    """Print a warning with the recording's name; those on log times, which most bags share, once in a run."""
    if isinstance(message, LogTimeWarning):
        if str(message) in _said:
            return
        _said.add(str(message))
        message = f"{message} (said once for all recordings)"
    print_warning(f"{name}: {message}")


def print_warning(text: str) -> None:
    """Print a warning line to the error stream."""
    print(as_one_line(f"warning: {text}"), file=sys.stderr)


def as_one_line(text: str) -> str:
    """Return `text` with line breaks and other characters that do not print as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def make_table(title: str | None, left: Sequence[str], right: Sequence[str], padding: int = 1) -> Table:
    """Return an empty table: columns headed `left` hold texts that may wrap, columns headed `right` hold numbers."""
    table = Table(title=title, title_justify="left", header_style="bold", padding=(0, padding, 0, 0), box=SIMPLE_HEAD)
    for heading in left:
        table.add_column(heading, overflow="fold")
    for heading in right:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def print_table(table: Table) -> None:
    """Print a table; one that is wider than the terminal in parts, each with the first column."""
    for part in _split_table(table, out.width):
        out.print(part)


def _split_table(table: Table, width: int) -> list[Table]:
    """Return the table, or parts of it with the first column and as many others as fit."""
    first, *others = table.columns
    parts: list[list[Column]] = [[first]]
    for column in others:
        if len(parts[-1]) > 1 and _measure_width([*parts[-1], column], table) > width:
            parts.append([first])
        parts[-1].append(column)
    return [table] if len(parts) == 1 else [_pick_columns(table, columns, parts) for columns in parts]


def _measure_width(columns: Sequence[Column], table: Table) -> int:
    """Return the width that a table of these columns needs at least."""
    around = sum(table.padding[1::2]) + 1
    return 1 + sum(_measure_column(column) + around for column in columns)


def _measure_column(column: Column) -> int:
    """Return the width of a column; a text that may wrap needs no more than MIN_TEXT_WIDTH."""
    lines = [line for cell in [column.header, *column.cells] for line in str(cell).splitlines()]
    longest = max((cell_len(line) for line in lines), default=0)
    return longest if column.no_wrap else min(longest, column.min_width or MIN_TEXT_WIDTH)


def _pick_columns(table: Table, columns: Sequence[Column], parts: Sequence[Sequence[Column]]) -> Table:
    """Return a part of a table; the first one keeps the title."""
    part = Table(title_justify="left", header_style=table.header_style, padding=table.padding, box=table.box)
    part.title = table.title if columns is parts[0] else None
    part.columns = [replace(column, _index=i) for i, column in enumerate(columns)]
    part.rows = list(table.rows)
    return part


def as_csv(rows: Iterable[Sequence[object]]) -> str:
    """Return rows as CSV text."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def load_described_signals(options: argparse.Namespace) -> Signals:
    """Return the signals that --signals names."""
    return load_signals(options.signals)


def run(name: str, program: Callable[[Sequence[str] | None], int], argv: Sequence[str] | None = None) -> int:
    """Run `program`; a user's mistake gives one line on stderr and exit status 2, Ctrl-C gives status 130."""
    _said.clear()
    try:
        accept_all_characters()
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


def accept_all_characters() -> None:
    """Let the output streams escape characters that their encoding does not have, such as umlauts in ASCII."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")


def interrupt_as_exception() -> None:
    """Let Ctrl-C raise KeyboardInterrupt; while modules were imported it ended the process at once."""
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _print_error(name: str, text: str) -> None:
    with suppress(OSError):  # the error stream may be full or gone, too
        print(as_one_line(f"ces {name}: {text}"), file=sys.stderr)


def _describe_system_error(error: OSError) -> str:
    """Return the system's message, with the file if it is known."""
    what = error.strerror or str(error)
    if any(frame.f_code.co_filename.endswith(CACHE_MODULE) for frame, _ in walk_tb(error.__traceback__)):
        return f"compiled code cannot be kept: {what}; free space in its folder, or name another in {VARIABLE}"
    return f"{error.filename}: {what}" if error.filename else f"{what}, while reading or writing"


def _silence(stream: TextIO) -> None:
    """Discard the buffered rest of a stream that cannot be written, so that Python's exit does not fail."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
