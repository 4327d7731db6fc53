"""What every program shares: options, tables, one-line errors with exit status 2, recordings read with warnings."""

from __future__ import annotations

import argparse
import io
import os
import shlex
import signal
import sys
import textwrap
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any, Generic, NoReturn, TextIO, TypeVar

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console, JustifyMethod
from rich.markup import escape
from rich.table import Column, Table

from ces_cli.terminal.heartbeat import heartbeat
from ces_cli.terminal.options import Argument, OptionRule, ProgramRequest, find_given, list_actions, require_applicable
from ces_data.bags.reader import LogTimeWarning, read_recording
from ces_data.compilation import CompilationNotice
from ces_data.findings import require_usable
from ces_data.log_formats import is_log
from ces_data.reading import read_log
from ces_data.recording import Recording
from ces_identify.jobs import end_process
from ces_observer.errors import CesError, OptionName, suggest
from ces_observer.fields import REQUIRED, Field
from ces_observer.options import Option
from ces_observer.signals import Signals
from ces_report import table as declared

R = TypeVar("R")
Request = TypeVar("Request", bound=ProgramRequest)

FORCE = ("position", "current", "force")  # signals of a recording with a measured force
USER_ERROR = 2
PART = "request of the part"  # key of the values: which subprogram is asked for
UNRECOGNIZED = "unrecognized arguments: "  # how argparse's message begins
MIN_TEXT_WIDTH = 12  # characters of a column of texts that may wrap
INTERRUPTED = 130
PATIENCE_S = 1.0

_said: set[str] = set()  # warnings that a run prints once; `run` empties it
out = Console()
err = Console(stderr=True)


class Parser(argparse.ArgumentParser, Generic[Request]):
    """An argument parser whose errors are one line, with `rules` on the options that apply together.

    `read` makes a `request` of the words. With `intermixed`, arguments may follow options.
    """

    request: type[Request]
    rules: Sequence[OptionRule] = ()
    intermixed = False

    def read(self, argv: Sequence[str] | None = None) -> Request:
        """Return the request that the words make, by default those of this process; raises CesError."""
        words = list(sys.argv[1:] if argv is None else argv)
        values = vars(self.parse_args(words))
        request: type[Request] = values.get(PART) or self.request
        return request.of(values, find_given(self, words, values))

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> argparse.Namespace:  # type: ignore[override]
        """Return the options; raises CesError for one that does not apply. Refuses empty values, as of unset names."""
        words = list(sys.argv[1:] if args is None else args)
        for before, word in zip(["", *words], words, strict=False):
            if not word or (word.startswith("--") and word.endswith("=")):
                self.error(f"{word.rstrip('=') or before or 'the first argument'}: a value is empty")
        parse = super().parse_intermixed_args if self.intermixed else super().parse_args
        options: argparse.Namespace = parse(words, namespace)
        require_applicable(find_given(self, words, vars(options)), vars(options), self.rules)
        return options

    def error(self, message: str) -> NoReturn:
        """Print `message`, an option that may be meant, and where to find help, then exit with status 2."""
        if message.startswith(UNRECOGNIZED):
            word = message.removeprefix(UNRECOGNIZED).split()[0].partition("=")[0]
            known = [text for action in list_actions(self) for text in action.option_strings]
            near = suggest(word, known) if word.startswith("--") else ""
            message += near if "did you mean" in near else ""
        text = as_one_line(f"{self.prog}: error: {message}; see '{self.prog} --help'")
        self.exit(USER_ERROR, f"{text}\n")


def read(request: type[Request], argv: Sequence[str] | None = None) -> Request:
    """Return the request that the words make, by default those of this process; raises CesError."""
    return parser(request).read(argv)


def parser(request: type[Request]) -> Parser[Request]:
    """Return the parser of the program that makes a request, and of its parts."""

    def texts(of: type[ProgramRequest]) -> dict[str, Any]:
        about = of.about or " ".join((of.__doc__ or "").split())
        head = {"description": textwrap.fill(about, 100), "epilog": f"example:\n  {of.example}"}
        return {**head, "formatter_class": argparse.RawDescriptionHelpFormatter}

    made = Parser[Request](prog=f"ces {request.program}", **texts(request))
    made.request, made.rules, made.intermixed = request, request.option_rules, request.intermixed
    add_options(made, *request.options())
    if request.parts:
        inner = made.add_subparsers(metavar="|".join(request.parts), required=True)
        for word, own in request.parts.items():
            does = (own.__doc__ or "").rstrip(".")
            part = inner.add_parser(word, help=f"{does[0].lower()}{does[1:]}", **texts(own))
            add_options(part, *own.options())
            part.set_defaults(**{PART: own})
    return made


def add_options(to: Any, *options: Option) -> None:
    """Add arguments and options to a parser or a group, those with a group under its heading."""
    groups: dict[str, Any] = {"": to}
    for option in options:
        if option.group not in groups:
            groups[option.group] = to.add_argument_group(option.group)
        name, words = _as_argument(option)
        groups[option.group].add_argument(name, **words)


def _as_argument(option: Option) -> tuple[str, dict[str, Any]]:
    """Return the flag or name of an option, and what argparse has to know of it."""
    words: dict[str, Any] = {"help": option.help.replace("%", "%%") or None}
    if option.kind is bool:
        action = "store_false" if option.default else "store_true"
        return option.flag, {**words, "dest": option.name, "action": action}
    plain = option.kind in (str, Path) and option.check_text is None
    words["type"] = option.kind if plain else parse_as(option.one)
    words |= {"choices": option.choices} if option.choices else {}
    words |= {"metavar": option.metavar} if option.metavar else {}
    default = None if option.default is REQUIRED else list(option.default) if option.many else option.default
    if isinstance(option, Argument):
        return option.name, {**words, "default": default, "nargs": option.count or None}
    if len(values := option.metavar.split()) > 1:  # so many values, each by its name
        return option.flag, {**words, "default": default, "nargs": len(values), "metavar": tuple(values)}
    words |= {"nargs": "+"} if option.together else {"action": "append"} if option.many else {}
    return option.flag, {**words, "default": default, "required": option.default is REQUIRED}


def parse_as(field: Field) -> Callable[[str], Any]:
    """Return a function that parses a text for a field, with errors for argparse."""

    def parse(text: str) -> Any:
        try:
            return field.parse(text)
        except CesError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


@contextmanager
def step(text: str) -> Iterator[Callable[[str], None]]:
    """Show what is done while the context is open; what it gives changes the text. Lines come from the heartbeat."""
    with err.status(escape(text)) as status, heartbeat.step(text, live=err.is_terminal):

        def change(text: str) -> None:
            status.update(escape(text))
            heartbeat.change(text)

        yield change


def read_one(path: Path, signals: Signals, need: Sequence[str] = FORCE[:2], part: Sequence[float] = ()) -> Recording:
    """Read and check a bag, or a log, or a `part` [s] of it, and say what of it was taken; warnings are a line each.

    Raises CesError.
    """
    if is_log(path):
        return _read_log(path, need, part)
    with warnings.catch_warnings(record=True) as caught, step(f"reading {path}"):
        warnings.simplefilter("always")
        recording = _take_part(read_recording(path, signals, need), part)
        findings = require_usable(recording)
    for warning in caught:
        text, of_log_time = str(warning.message), isinstance(warning.message, LogTimeWarning)
        if of_log_time and text in _said:
            continue  # most bags share it
        _said.update([text] if of_log_time else [])
        print_warning(f"{recording.name}: {text}" + " (said once for all recordings)" * of_log_time)
    for finding in findings:
        print_warning(f"{recording.name}: {finding.text}")
    return recording


def _take_part(recording: Recording, part: Sequence[float]) -> Recording:
    """Return the part of a recording, and say what is left out."""
    taken = recording.part(*part)
    if part:
        whole_s, span = recording.duration_s, f"from {part[0]:g} s to {min(part[1], recording.duration_s):.4g} s"
        left = f"{whole_s - taken.duration_s:.1f} of {whole_s:.1f} s left out"
        print_line(f"{recording.name}: used {span}; {left}", console=err)
    return taken


def _read_log(path: Path, need: Sequence[str], part: Sequence[float]) -> Recording:
    with warnings.catch_warnings(record=True) as caught, step(f"reading {path}"):
        warnings.simplefilter("always")
        recording = read_log(
            path,
            need=need,
            say=lambda found: print_line(f"{path}: {found}", console=err),
            take=lambda whole: _take_part(whole, part),
        )
    for warning in caught:
        print_warning(str(warning.message))
    return recording


def command_line(program: str, argv: Sequence[str] | None) -> str:
    """Return the command that runs `program` again, as reports state it."""
    return shlex.join(["ces", program, *(sys.argv[2:] if argv is None else argv)])


def print_line(text: str, style: str = "", console: Console = out) -> None:
    """Print a line as it is, without markup and without breaks of our own."""
    console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)
    heartbeat.touch()


def print_warning(text: str) -> None:
    """Print a warning line to the error stream."""
    print(as_one_line(f"warning: {text}"), file=sys.stderr)
    heartbeat.touch()


def as_one_line(text: str) -> str:
    """Return `text` with line breaks and other characters that do not print as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def lay_out(table: declared.Table[R], style: Callable[[R], str] = lambda row: "") -> Table:
    """Return a declared table for the terminal, without the columns for pages; `style` is that of a row.

    Texts may wrap, figures do not.
    """
    made = Table(title=table.title or None, title_justify="left", header_style="bold", padding=(0, 1, 0, 0))
    made.box = SIMPLE_HEAD
    columns = [c for c in table.columns if not c.page_only]
    for column in columns:
        justify: JustifyMethod = "right" if column.figure else "left"
        made.add_column(column.short or column.heading, justify=justify, no_wrap=column.figure, overflow="fold")
    groups = [None if table.group is None else table.group(row) for row in table.rows]
    for row, group, after in zip(table.rows, groups, [*groups[1:], None], strict=True):
        made.add_row(*(escape(c.line(row)) for c in columns), style=style(row), end_section=group != after)
    return made


def print_table(table: Table) -> None:
    """Print a table; one that is wider than the terminal in parts, each with the first column."""
    first, *others = table.columns
    parts: list[list[Column]] = [[first]]
    for column in others:
        if len(parts[-1]) > 1 and _measure_width([*parts[-1], column], table) > out.width:
            parts.append([first])
        parts[-1].append(column)
    if len(parts) == 1:
        out.print(table)
        return
    for columns in parts:
        part = Table(title_justify="left", header_style=table.header_style, padding=table.padding, box=table.box)
        part.title = table.title if columns is parts[0] else None
        part.columns = [replace(column, _index=i) for i, column in enumerate(columns)]
        part.rows = list(table.rows)
        out.print(part)


def _measure_width(columns: Sequence[Column], table: Table) -> int:
    """Return the width that a table needs at least; a text that may wrap needs no more than MIN_TEXT_WIDTH."""
    width = 1
    for column in columns:
        lines = [line for cell in [column.header, *column.cells] for line in str(cell).splitlines()]
        longest = max((cell_len(line) for line in lines), default=0)
        width += longest if column.no_wrap else min(longest, column.min_width or MIN_TEXT_WIDTH)
        width += sum(table.padding[1::2]) + 1
    return width


def run(name: str, program: Callable[[Sequence[str] | None], int], argv: Sequence[str] | None = None) -> int:
    """Run `program`; a user's mistake gives one line on stderr and exit status 2, Ctrl-C gives status 130."""
    _said.clear()
    notice = CompilationNotice(print_warning)
    try:
        accept_all_characters()
        interrupt_as_exception()
        status = program(argv)
        sys.stdout.flush()
        return status
    except CesError as error:
        _print_error(name, f"error: {error.word(OptionName.as_flag)}")
    except BrokenPipeError:
        _silence(sys.stdout)
        return 0
    except OSError as error:
        _print_error(name, f"error: {_describe_system_error(error)}")
        _silence(sys.stdout)
    except (KeyboardInterrupt, SystemError) as error:
        if not _is_interrupt(error):
            raise
        _print_error(name, "interrupted")
        return INTERRUPTED
    finally:
        notice.close()
    return USER_ERROR


def _is_interrupt(error: BaseException | None) -> bool:
    """Return whether Ctrl-C is behind an error; compiled code makes a chain of SystemErrors of it."""
    return error is not None and (isinstance(error, KeyboardInterrupt) or _is_interrupt(error.__cause__))


def accept_all_characters() -> None:
    """Let the output streams escape characters that their encoding does not have, such as umlauts in ASCII."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")


def interrupt_as_exception() -> None:
    """Let Ctrl-C raise KeyboardInterrupt; a second one, `PATIENCE_S` later, ends the process without waiting for work.

    Until then the first one removes what is half written. While modules were imported it ended the process at once.
    """
    pressed: list[float] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        pressed.append(time.monotonic())
        if len(pressed) == 1:
            raise KeyboardInterrupt
        if pressed[-1] - pressed[0] > PATIENCE_S:
            end_process(number)

    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, interrupt)


def _print_error(name: str, text: str) -> None:
    with suppress(OSError):  # the error stream may be full or gone, too
        print(as_one_line(f"ces {name}: {text}"), file=sys.stderr)


def _describe_system_error(error: OSError) -> str:
    what = error.strerror or str(error)
    return f"{error.filename}: {what}" if error.filename else f"{what}, while reading or writing"


def _silence(stream: TextIO) -> None:
    """Discard the buffered rest of a stream that cannot be written, so that Python's exit does not fail."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
