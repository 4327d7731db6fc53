"""Lines that both proposals share: comments that explain a choice, and numbers as YAML writes them."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ces_data.logs.can import CanLog
from ces_data.logs.csv import CsvTable
from ces_data.logs.log_file import LogTable, TimedLog, open_log
from ces_data.logs.log_import import to_recording
from ces_data.logs.log_mapping import Column, DynoMapping, parse_dyno_mapping
from ces_data.mapping.candidates import find_bag_candidates
from ces_data.mapping.choice import UNCHECKED, Choice, DamperChoice, NotFound, Selection, choose
from ces_data.mapping.log_candidates import ANY, LogCandidates, find_log_candidates
from ces_data.mapping.rating import Rating
from ces_data.recording import Recording
from ces_observer.errors import RecordingError

WIDTH = 110
MAX_OTHERS = 4
CHECK = "CHECK"
PLAIN = re.compile(r"/?[A-Za-z_][A-Za-z0-9_./]*")


def explain(choice: Choice, indent: str) -> Iterator[str]:
    """Yield the comment lines above a choice: reasons, range, checks, and what was not chosen."""
    c = choice.candidate
    yield from comment(f"{choice.signal}: {'; '.join(choice.reasons)}.", indent)
    yield from comment(f"range {c.low:.4g} to {c.high:.4g} as logged, {c.rate_Hz:.4g} Hz", indent)
    for check in choice.checks:
        yield from comment(f"{CHECK}: {check}", indent)
    yield from _list_others("not chosen", choice.others, indent)


def explain_missing(missing: NotFound, indent: str) -> Iterator[str]:
    """Yield the comment lines in the place of a signal that was not found."""
    yield from comment(f"not found: {missing.signal}: {missing.reason}", indent)
    yield from _list_others("candidates", missing.others, indent)


def comment(text: str, indent: str) -> Iterator[str]:
    """Yield a text as comment lines."""
    lines = textwrap.wrap(text, WIDTH - len(indent) - 2, break_long_words=False, break_on_hyphens=False)
    yield from (f"{indent}# {line if i == 0 else '  ' + line}" for i, line in enumerate(lines))


def one_line(text: object) -> str:
    """Return a text for a comment that is not wrapped, in which a control character is written as Python does."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(text))


def quote_yaml(text: str) -> str:
    """Return a text as a double-quoted YAML scalar."""
    return json.dumps(text, ensure_ascii=False)


def name_yaml(text: str) -> str:
    """Return a topic, type or field as a YAML scalar, quoted only if it holds more than letters, digits and /_."""
    return text if PLAIN.fullmatch(text) else quote_yaml(text)


def format_number(value: float) -> str:
    """Return a number as YAML reads it back: always a float, without rounding."""
    text = repr(float(value) + 0.0)
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{int(exponent):+d}" if mark else text


def describe_scale(choice: Choice) -> str:
    """Return what the scale does, such as `mm to m, sign turned`; '' if nothing."""
    unit = choice.unit.unit
    parts = [f"{unit.text} to SI"] if unit is not None and (unit.scale != 1.0 or unit.offset != 0.0) else []
    turned = choice.scale < 0.0
    return ", ".join([*parts, *(["sign turned"] if turned else [])])


def _list_others(title: str, others: Sequence[Rating], indent: str) -> Iterator[str]:
    shown = [f"{r.candidate.label} ({r.why})" for r in others[:MAX_OTHERS]]
    more = [f"{len(others) - MAX_OTHERS} more"] if len(others) > MAX_OTHERS else []
    if shown:
        yield from comment(f"{title}: {', '.join(shown + more)}", indent)


HEAD = """\
# Signals file proposed by `ces signals` from {sources}.
# Every signal is value in SI units = scale * number + offset; position and force are positive in compression.
"""
PASSIVE = "current: {constant: 0.0}  # a passive damper; or the value that was set [A]"


@dataclass(frozen=True)
class SignalsProposal:
    """The proposed signals, the text of the file, and the topics that were not examined with the reason."""

    selection: Selection
    text: str
    skipped: dict[str, str]


def propose_signals(paths: Sequence[Path]) -> SignalsProposal:
    """Return a signals file for bags; raises RecordingError if one is damaged or nothing looks like a signal."""
    found = find_bag_candidates(paths)
    selection = choose(found.candidates)
    if not any(damper.choices for damper in selection.dampers.values()):
        labels = ", ".join(candidate.label for candidate in found.candidates[:20])
        raise RecordingError(
            f"{paths[0]}: nothing looks like position, current or force; it has {labels}; write a signals file by hand,"
            " see docs/recordings.md"
        )
    lines = HEAD.format(sources=", ".join(map(one_line, paths))).splitlines()
    lines += _format(selection)
    return SignalsProposal(selection, "\n".join(lines) + "\n", found.skipped)


def _format(selection: Selection) -> Iterator[str]:
    if selection.checks:
        yield from comment(f"Lines with {CHECK} are to be confirmed before the file is used.", "")
    if selection.names:
        first = selection.names[0]
        yield from comment(f"Several dampers: select one with --signals FILE#{first}", "")
    yield "/**:"
    yield "  ros__parameters:"
    if selection.names:
        yield f"    dampers: [{', '.join(selection.names)}]"
    for name, damper in selection.dampers.items():
        if name and damper.choices:
            yield f"    {name}:"
        yield from _format_damper(damper, " " * (6 if name else 4))


def _format_damper(damper: DamperChoice, indent: str) -> Iterator[str]:
    for choice in damper.choices.values():
        yield from explain(choice, indent)
        yield from _format_signal(choice, indent)
    for missing in damper.missing.values():
        yield from explain_missing(missing, indent)
        for rating in missing.others[:2]:
            c = rating.candidate
            signal = f"topic: {name_yaml(c.topic)}, type: {name_yaml(c.kind)}, field: {quote_yaml(c.field)}"
            yield f"{indent}# {missing.signal}: {{{signal}}}"
        if missing.signal == "current":
            yield f"{indent}# {PASSIVE}"


def _format_signal(choice: Choice, indent: str) -> Iterator[str]:
    c, remark = choice.candidate, describe_scale(choice)
    yield f"{indent}{choice.signal}:"
    yield f"{indent}  topic: {name_yaml(c.topic)}"
    yield f"{indent}  type: {name_yaml(c.kind)}"
    yield f"{indent}  field: {name_yaml(c.field)}"
    yield f"{indent}  scale: {format_number(choice.scale)}" + (f"  # {remark}" if remark else "")
    yield f"{indent}  offset: {format_number(choice.offset)}"


MAPPING_HEAD = """\
# Mapping proposed by `ces import {name} --propose`.
# Every signal is value in SI units = scale * cell + offset; position and force are positive in compression.
"""
AMPERES = re.compile(r"(?<![0-9.])([0-9]+(?:\.[0-9]+)?) ?A(?![A-Za-z0-9])")
NAME_PATTERN = '"([0-9]+(?:[.][0-9]+)?) ?A(?![A-Za-z0-9])"'
NO_TIME = "no column is named like a time and goes forward; give --rate HZ"
REQUIRED = ("position", "current", "force")


@dataclass(frozen=True)
class MappingProposal:
    """The proposed mapping as text; `mapping` is None if it is not complete.

    `doubts` are to be resolved by a person, `remarks` are not in the way of an import, `found` says what was taken.
    `faults` are those doubts that no mapping resolves: cells that are no numbers, and channels without samples.
    """

    selection: Selection
    text: str
    mapping: DynoMapping | None
    log: LogTable | TimedLog
    doubts: tuple[str, ...]
    remarks: tuple[str, ...]
    found: tuple[str, ...]
    faults: frozenset[str] = frozenset()

    def read(self) -> Recording:
        """Return the log as a recording; raises RecordingError if the mapping is not complete and certain."""
        path = self.log.path
        if self.doubts and self.doubts[0] in self.faults:
            raise RecordingError(f"{path}: {self.doubts[0]}")
        if self.mapping is None or self.doubts:
            raise RecordingError(
                f"{path}: {self.doubts[0]}; 'ces import {path} --propose > my.yaml' writes a mapping to correct, "
                "for --mapping my.yaml"
            )
        return to_recording(self.log, self.mapping)


def propose_mapping(
    path: Path,
    *,
    rate: float | None = None,
    dbc: Sequence[Path] = (),
    progress: Callable[[float], None] = lambda share: None,
) -> MappingProposal:
    """Return a mapping for a log from the names, units and numbers of its columns; raises RecordingError.

    `rate` [Hz] is that of a table without a time, `dbc` are the databases of a CAN log, `progress` is that of
    `open_log`.
    """
    bare = DynoMapping(source="a mapping", signals={}, blank="missing", dbc=tuple(dbc))
    log = open_log(path, bare, progress)
    if rate is not None and isinstance(log, TimedLog):
        raise RecordingError(f"{path}: --rate does not apply: the channels of this log have their own times")
    if dbc and not isinstance(log, CanLog):
        raise RecordingError(f"{path}: --dbc does not apply: this is no CAN log")
    candidates = find_log_candidates(log, rate)
    selection = choose(candidates.candidates)
    writer = _Writer(path, log, candidates, selection, dbc)
    text = "\n".join(writer.lines()) + "\n"
    mapping = None if writer.missing else parse_dyno_mapping(text, f"the mapping proposed for {path}")
    remarks = tuple(check for check in writer.checks if UNCHECKED in check)
    return MappingProposal(
        selection,
        text,
        mapping,
        log,
        (*writer.missing, *writer.doubts),
        remarks,
        tuple(writer.summary()),
        frozenset(f"{s}: {reason}" for key, reason in candidates.unread.items() for s in _signals_of(key)),
    )


def _signals_of(key: str) -> tuple[str, ...]:
    """Return the signals of a key of `LogCandidates.unread`; a mapping may resolve the form of a time."""
    return REQUIRED if key == ANY else () if key == "time" else (key,)


class _Writer:
    """Writes the lines of a proposed mapping."""

    def __init__(
        self, path: Path, log: LogTable | TimedLog, found: LogCandidates, selection: Selection, dbc: Sequence[Path]
    ) -> None:
        self.path, self.log, self.found, self.dbc = path, log, found, dbc
        self.names = selection.names
        self.choices: dict[str, Choice] = {}
        self.damper = selection.dampers[""]
        if self.names:
            first = selection.dampers[self.names[0]]
            self.damper = DamperChoice({**self.damper.choices, **first.choices}, first.missing)
        self.choices = dict(self.damper.choices)
        self.amperes = AMPERES.search(path.name) if "current" not in self.choices else None

    @property
    def missing(self) -> tuple[str, ...]:
        """What a mapping needs and was not found."""
        texts = [
            f"{signal}: {self._reason(self.damper.missing[signal])}"
            for signal in REQUIRED
            if signal in self.damper.missing and not (signal == "current" and self.amperes)
        ]
        if not self.found.time_text:
            texts.append(f"time: {self.found.unread.get('time', NO_TIME)}")
        return tuple(texts)

    def _reason(self, missing: NotFound) -> str:
        """Return why a signal was not found: the fault of the column that is named like it, if there is one."""
        return self.found.unread.get(missing.signal, self.found.unread.get(ANY, missing.reason))

    @property
    def checks(self) -> tuple[str, ...]:
        """What the choices leave to check; a sign that cannot be checked is taken as logged."""
        return tuple(f"{signal}: {check}" for signal, choice in self.choices.items() for check in choice.checks)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What a person should check."""
        texts = [check for check in self.checks if UNCHECKED not in check]
        if self.found.time_doubt:
            texts.append(self.found.time_doubt)
        if self.names:
            texts.append(f"several dampers ({', '.join(self.names)}); this mapping is for {self.names[0]}")
        return tuple(texts)

    def summary(self) -> Iterator[str]:
        """Yield what was taken for each signal, for one line on the terminal."""
        if self.found.time_text:
            yield self.found.time_text
        for signal, choice in self.choices.items():
            if signal not in REQUIRED:
                continue
            remark = describe_scale(choice) or (choice.unit.unit.text if choice.unit.unit else "")
            yield f"{signal} from '{choice.candidate.label}'" + (f" [{remark}]" if remark else "")
        if self.amperes:
            yield f"current {self.amperes.group(1)} A from the file's name"
        if counts := self._count_blanks():
            yield f"blank cells are missing samples ({counts})"

    def lines(self) -> Iterator[str]:
        """Yield the lines of the file."""
        yield from MAPPING_HEAD.format(name=one_line(self.path.name)).splitlines()
        for doubt in self.doubts:
            yield from comment(f"{CHECK}: {doubt}", "")
        yield from self._layout()
        yield from self._time()
        for choice in self.choices.values():
            yield from explain(choice, "")
            yield ("" if choice.signal in REQUIRED else "# ") + self._signal(choice)
        for missing in self.damper.missing.values():
            if missing.signal == "current" and self.amperes:
                yield from comment("current: no column; the file's name states it", "")
                yield f"current: {{from_name: {NAME_PATTERN}}}"
                continue
            yield from explain_missing(replace(missing, reason=self._reason(missing)), "")
            yield from (
                f"# {missing.signal}: {{column: {quote_yaml(str(self._key(r.candidate.label).key))}}}"
                for r in missing.others[:2]
            )
            if missing.signal == "current":
                yield "# current: {constant: 0.0}  # a passive damper, or the current that was set [A]"

    def _layout(self) -> Iterator[str]:
        if isinstance(self.log, LogTable) and self.log.rows:
            yield f"rows: {quote_yaml(self.log.rows)}"
        if isinstance(self.log, CsvTable):
            dialect = self.log.dialect
            if dialect.delimiter != ",":
                yield f"delimiter: {quote_yaml(dialect.delimiter)}"
            if dialect.decimal != ".":
                yield f"decimal: {quote_yaml(dialect.decimal)}"
            if counts := self._count_blanks():
                yield f"blank: missing  # blank cells ({counts}) are samples that were not taken"
        if self.dbc:
            yield f"dbc: [{', '.join(quote_yaml(str(path.resolve())) for path in self.dbc)}]"

    def _count_blanks(self) -> str:
        """Return how many cells of each signal of a text table are blank, '' if none is."""
        if not isinstance(self.log, CsvTable):
            return ""
        blanks = {
            signal: self.log.missing(self._key(choice.candidate.label).key) for signal, choice in self.choices.items()
        }
        return ", ".join(f"{missing.sum()} of {signal}" for signal, missing in blanks.items() if missing is not None)

    def _time(self) -> Iterator[str]:
        time, rate = self.found.time, self.found.rate
        if time is not None:
            unit = f", unit: {time.unit}" if time.unit else ""
            if time.offset:
                unit = f", scale: {format_number(time.scale)}, offset: {format_number(time.offset)}"
            yield f"time: {{column: {_key_text(time.key)}{unit}}}"
        elif isinstance(rate, Column):
            yield f"rate: {{column: {_key_text(rate.key)}}}"
        elif rate is not None:
            yield f"rate: {format_number(rate)}"
        elif not self.found.time_text:
            yield from comment(f"not found: time: {self.found.unread.get('time', 'give its column, or the rate')}", "")
            yield "# rate: 1000.0  # [Hz]"

    def _signal(self, choice: Choice) -> str:
        column, unit = self._key(choice.candidate.label), choice.unit.unit
        parts = [f"column: {_key_text(column.key)}"]
        if column.group is not None:
            parts.append(f"group: {_key_text(column.group)}")
        if unit is not None and choice.scale == unit.scale:
            return f"{choice.signal}: {{{', '.join([*parts, f'unit: {_unit_text(unit.text)}'])}}}"
        parts.append(f"scale: {format_number(choice.scale)}")
        parts += [f"offset: {format_number(choice.offset)}"] if choice.offset else []
        return f"{choice.signal}: {{{', '.join(parts)}}}  # {describe_scale(choice)}"

    def _key(self, label: str) -> Column:
        return self.found.keys[label]


def _key_text(key: str | int) -> str:
    return str(key) if isinstance(key, int) else quote_yaml(key)


def _unit_text(text: str) -> str:
    return text if text.isalpha() and text not in ("N", "n", "y", "Y") else quote_yaml(text)
