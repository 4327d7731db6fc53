"""Proposals: a signals file for bags, a mapping for a log, with the reasons for each choice as comments."""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import yaml

from ces_data.logs.can import CanLog
from ces_data.logs.csv import CsvTable
from ces_data.logs.log_file import LogTable, Progress, TimedLog, open_log
from ces_data.logs.log_import import join_blocks, read_blocks
from ces_data.logs.log_mapping import DynoMapping, LogColumn, parse_mapping_without_force
from ces_data.mapping.candidates import ANY, LogCandidates, find_bag_candidates, find_log_candidates
from ces_data.mapping.choice import Choice, NotFound, Selection, choose
from ces_data.mapping.doubts import BY_SCRIPT, GIVE_RATE, NO_NUMBER, NO_TIME, NOT_READ, WAY, script_remedy, tell_doubts
from ces_data.mapping.rating import Candidate, Rating, read_meaning
from ces_data.mapping.yaml_text import format_number, name_yaml, on_one_line, quote, write_key
from ces_data.recording import Recording
from ces_observer.errors import OptionName, RecordingError, Words
from ces_observer.signals import MOTIONS

WIDTH = 110
MAX_OTHERS = 4
CHECK = "CHECK"
SIGNALS_HEAD = """\
# Signals file proposed by `ces signals` from {sources}.
# Every signal is value in SI units = scale * number + offset; position and force are positive in compression.
"""
MAPPING_HEAD = """\
# Mapping proposed by `ces import {name} --propose`.
# Every signal is value in SI units = scale * cell + offset; position and force are positive in compression.
"""
AMPERES = re.compile(r"(?<![0-9.])([0-9]+(?:\.[0-9]+)?) ?A(?![A-Za-z0-9])")
NAME_PATTERN = '"([0-9]+(?:[.][0-9]+)?) ?A(?![A-Za-z0-9])"'
REQUIRED = ("position", "current", "force")
TAKEN = (*REQUIRED, "speed")


@dataclass(frozen=True)
class SignalsProposal:
    """The proposed signals, the text of the file, and the topics that were not examined with the reason."""

    selection: Selection
    text: str
    skipped: dict[str, str]


def propose_signals(paths: Sequence[Path]) -> SignalsProposal:
    """Return a signals file for bags; raises RecordingError if one is damaged or nothing looks like a signal."""
    candidates, skipped = find_bag_candidates(paths)
    selection = choose(candidates)
    if not any(damper.choices for damper in selection.dampers.values()):
        labels = ", ".join(candidate.label for candidate in candidates[:20])
        text = f"nothing looks like position, current or force; it has {labels}"
        raise RecordingError(f"{paths[0]}: {text}; write a signals file by hand, see docs/recordings.md")
    head = SIGNALS_HEAD.format(sources=", ".join(map(on_one_line, paths)))
    return SignalsProposal(selection, head + "\n".join(_signals_lines(selection)) + "\n", skipped)


def _signals_lines(selection: Selection) -> Iterator[str]:
    def describe(c: Candidate) -> str:
        return f"topic: {name_yaml(c.topic)}, type: {name_yaml(c.kind)}, field: {quote(c.field)}"

    if selection.checks:
        yield from _comment(f"Lines with {CHECK} are to be confirmed before the file is used.")
    if selection.names:
        yield from _comment(f"Several dampers: select one with --signals FILE#{selection.names[0]}")
    yield "/**:"
    yield "  ros__parameters:"
    if selection.names:
        yield f"    dampers: [{', '.join(selection.names)}]"
    for name, damper in selection.dampers.items():
        if name and damper.choices:
            yield f"    {name}:"
        indent = " " * (6 if name else 4)
        for choice in damper.choices.values():
            c, remark = choice.candidate, describe_scale(choice)
            yield from _explain(choice, indent)
            if choice.signal == "speed":  # a model that needs it is the user's decision
                yield f"{indent}# speed: {{{describe(c)}, scale: {format_number(choice.scale)}}}"
                continue
            yield f"{indent}{choice.signal}:"
            for key, text in (("topic", c.topic), ("type", c.kind), ("field", c.field)):
                yield f"{indent}  {key}: {name_yaml(text)}"
            yield f"{indent}  scale: {format_number(choice.scale)}" + (f"  # {remark}" if remark else "")
            yield f"{indent}  offset: {format_number(choice.offset)}"
        for missing in damper.missing.values():
            yield from _explain_missing(missing, describe, "; or the value that was set", indent)


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
    missing: frozenset[str] = frozenset()  # those doubts that say what was not found

    def read(self) -> Recording:
        """Return the log as a recording; raises RecordingError if the mapping is not complete and certain."""
        return join_blocks(list(self.blocks()))

    def blocks(self) -> Iterator[Recording]:
        """Yield the same in blocks, as `read_blocks` does."""
        if self.mapping is None or self.doubts:
            raise RecordingError(f"{self.log.path}: ", self.tell(self.doubts, WAY.format(self.log.path), BY_SCRIPT))
        yield from read_blocks(self.log, self.mapping)

    def tell(self, doubts: Sequence[str], remedy: str = "", where: str = "") -> Words:
        """Return the first of these doubts, or all that was not found, with remedies for programs and for scripts."""
        by_script = partial(script_remedy, yaml.safe_load(self.text) or {}, getattr(self.log, "names", ()), where)
        return tell_doubts(doubts, self.missing, self.faults, remedy, by_script)


def propose_mapping(
    path: Path,
    *,
    rate: float | None = None,
    dbc: Sequence[Path] = (),
    progress: Progress = lambda share: None,
    need: Sequence[str] = REQUIRED,
) -> MappingProposal:
    """Return a mapping for a log from the names, units and numbers of its columns; raises RecordingError.

    `log.csv#front` selects one of several dampers. `rate` [Hz] is that of a table without a time, `dbc` are the
    databases of a CAN log, `progress` is that of `open_log`. A force that is not in `need` may be missing.
    """
    path, damper = split_damper(path)
    log = open_log(path, DynoMapping(source="a mapping", signals={}, blank="missing", dbc=tuple(dbc)), progress)
    if rate is not None and isinstance(log, TimedLog):
        times = " does not apply: the channels of this log have their own times"
        raise RecordingError(f"{path}: ", OptionName("rate"), times)
    if dbc and not isinstance(log, CanLog):
        raise RecordingError(f"{path}: ", OptionName("dbc"), " does not apply: this is no CAN log")
    return propose_for(log, rate, dbc, damper, need)


def propose_for(
    log: LogTable | TimedLog,
    rate: float | None = None,
    dbc: Sequence[Path] = (),
    damper: str = "",
    need: Sequence[str] = REQUIRED,
) -> MappingProposal:
    """Return the same for an open log."""
    candidates = find_log_candidates(log, rate)
    unread, selection = candidates.unread, choose(candidates.candidates, integrates=True)
    selection = selection.with_reasons(
        {signal: unread[key] for signal in REQUIRED for key in (ANY, signal) if key in unread}
    )
    if damper and damper not in selection.names:
        names = ", ".join(selection.names) or "one damper only"
        raise RecordingError(f"{log.path}: no damper '{damper}'; found: {names}")
    writer = _MappingWriter(log, candidates, selection, dbc, damper, need)
    text = "\n".join(writer.lines()) + "\n"
    source = f"the mapping proposed for {log.path}"
    mapping = None if writer.missing else parse_mapping_without_force(yaml.safe_load(text), source)
    # a mapping may resolve the form of a time; what may be any signal is the fault of each
    causes = [(s, why) for key, why in unread.items() for s in (REQUIRED if key == ANY else (key,))]
    faults = frozenset(f"{s}: {why}" for s, why in causes if s != "time" or why.endswith(NO_NUMBER))
    doubts = (*writer.missing, *writer.doubts)
    return MappingProposal(
        selection,
        text,
        mapping,
        log,
        doubts,
        writer.remarks,
        tuple(writer.summary()),
        faults,
        frozenset(writer.missing),
    )


def split_damper(path: Path) -> tuple[Path, str]:
    """Return the path of a log and the damper that `log.csv#front` selects, '' if none."""
    stem, _, damper = ("", "", "") if path.exists() else path.name.rpartition("#")
    return (path.with_name(stem), damper) if stem else (path, "")


class _MappingWriter:
    """Writes a proposed mapping: `missing` is needed, `doubts` a person checks, `remarks` are taken and said."""

    def __init__(
        self,
        log: LogTable | TimedLog,
        candidates: LogCandidates,
        selection: Selection,
        dbc: Sequence[Path],
        damper: str,
        need: Sequence[str],
    ) -> None:
        self.log, self.found, self.dbc = log, candidates, dbc
        self.name = f"{log.path.name}#{damper}" if damper else log.path.name
        names = selection.names
        damper_choice = selection.dampers[damper or (names[0] if names else "")]
        self.choices = {**selection.dampers[""].choices, **damper_choice.choices}
        self.absent = list(damper_choice.missing.values())
        stated = tuple(dict.fromkeys(AMPERES.findall(log.path.name)))
        self.amperes = (
            stated[0] if len(stated) == 1 and not getattr(log, "called", "") and self._lacks_current() else ""
        )
        optional = {*({"current"} if self.amperes else ()), *({"force"} - set(need))}
        unknown = [missing for missing in self.absent if missing.signal not in optional]
        hints = {"current": f"the name says {' and '.join(stated)} A, but no column: "} if stated else {}
        self.missing = [f"{m.signal}: {hints.get(m.signal, '')}{m.reason}" for m in unknown]
        if not candidates.time_text:
            self.missing.append(f"time: {candidates.unread.get('time', f'{NO_TIME}; {GIVE_RATE}')}")
        self.doubts = [f"{signal}: {check}" for signal, choice in self.choices.items() for check in choice.checks]
        guesses = [f"{signal}: {g}" for signal, choice in self.choices.items() for g in choice.guesses]
        unread = [m for m in self.absent if m.signal in optional and (m.signal in candidates.unread or m.label)]
        guesses += (
            [f"current: {self.amperes} A, as the file's name says: no column is read as it"] if self.amperes else []
        )
        self.remarks = (*guesses, *(f"{m.signal}: {m.reason}{NOT_READ}" for m in unread))
        self.doubts = [*(log.doubts if isinstance(log, LogTable) else ()), *self.doubts]
        if candidates.time_doubt:
            self.doubts.append(candidates.time_doubt)
        if names and not damper:
            select = shlex.quote(f"{log.path}#{names[0]}")
            self.doubts.append(f"several dampers ({', '.join(names)}); select one with {select}, as this mapping does")
        masks = {}
        if isinstance(log, CsvTable):
            masks = {signal: log.missing(self._column(choice.candidate).key) for signal, choice in self.choices.items()}
        self.blanks = ", ".join(f"{mask.sum()} of {signal}" for signal, mask in masks.items() if mask is not None)

    def _lacks_current(self) -> bool:
        """Return whether no column is the current; a voltage is left out, as the name of a file says more."""
        choice = self.choices.get("current")
        if choice is None or choice.unit is None or choice.unit.quantity != "voltage":
            return choice is None
        del self.choices["current"]
        label = choice.candidate.label
        self.absent.append(NotFound("current", f"'{label}' may be it, but {choice.checks[-1]}", (), label))
        return True

    def summary(self) -> Iterator[str]:
        """Yield what was taken for each signal, for one line on the terminal."""
        if self.found.time_text:
            yield self.found.time_text
        for choice in (self.choices[signal] for signal in self.choices if signal in TAKEN):
            remark = describe_scale(choice) or (choice.unit.text if choice.unit else "")
            beside = " to check the position with" if choice.signal == "speed" and "position" in self.choices else ""
            yield f"{choice.signal} from '{choice.candidate.label}'" + (f" [{remark}]" if remark else "") + beside
        yield from self._unused_motions()
        if self.amperes:
            yield f"current {self.amperes} A from the file's name"
        if self.blanks:
            yield f"blank cells are missing samples ({self.blanks})"

    def _unused_motions(self) -> Iterator[str]:
        """Yield which speeds and accelerations were not taken."""
        taken = {choice.candidate.label for choice in self.choices.values()}
        for candidate in self.found.candidates:
            quantity = candidate.unit.quantity if candidate.unit else read_meaning(candidate.names).quantity
            if quantity in MOTIONS and candidate.label not in taken:
                contrary = quantity == "speed" and "position" in self.choices and "speed" not in self.choices
                why = ", it does not go as the position does" if contrary else ""
                yield f"'{candidate.label}' ({quantity}) not used{why}"

    def lines(self) -> Iterator[str]:
        """Yield the lines of the file."""

        def describe(c: Candidate) -> str:
            return f"column: {write_key(self._column(c).key)}"

        yield from MAPPING_HEAD.format(name=on_one_line(self.name)).splitlines()
        if any(choice.to_check for choice in self.choices.values()):
            yield from _comment(f"Lines with {CHECK} are to be confirmed before the file is used.")
        own = [f"{signal}: {check}" for signal, choice in self.choices.items() for check in choice.checks]
        for doubt in (doubt for doubt in self.doubts if doubt not in own):
            yield from _comment(f"{CHECK}: {doubt}")
        yield from self._layout()
        yield from self._time()
        for choice in self.choices.values():
            yield from _explain(choice)
            yield ("" if choice.signal in TAKEN else "# ") + self._signal(choice)
        for missing in self.absent:
            if missing.signal == "current" and self.amperes:
                yield from _comment("current: no column; the file's name states it")
                yield f"current: {{from_name: {NAME_PATTERN}}}"
            else:
                yield from _explain_missing(missing, describe, ", or the current that was set")

    def _layout(self) -> Iterator[str]:
        if isinstance(self.log, LogTable) and self.log.rows:
            yield f"rows: {quote(self.log.rows)}"
        if isinstance(self.log, CsvTable):
            dialect = self.log.dialect
            if dialect.delimiter != ",":
                yield f"delimiter: {quote(dialect.delimiter)}"
            if dialect.decimal != ".":
                yield f"decimal: {quote(dialect.decimal)}"
        if self.blanks:
            yield f"blank: missing  # blank cells ({self.blanks}) are samples that were not taken"
        if self.dbc:
            yield f"dbc: [{', '.join(quote(str(path.resolve())) for path in self.dbc)}]"

    def _time(self) -> Iterator[str]:
        time, rate = self.found.time, self.found.rate
        if time is not None:
            unit = f", unit: {time.unit}" if time.unit else ""
            if time.offset:
                unit = f", scale: {format_number(time.scale)}, offset: {format_number(time.offset)}"
            yield f"time: {{column: {write_key(time.key)}{unit}}}"
        elif isinstance(rate, LogColumn):
            yield f"rate: {{column: {write_key(rate.key)}}}"
        elif rate is not None:
            yield f"rate: {format_number(rate)}"
        elif not self.found.time_text:
            yield from _comment(f"not found: time: {self.found.unread.get('time', 'give its column, or the rate')}")
            yield "# time: {column: NAME}"
            yield "# rate: 1000.0  # [Hz]"

    def _signal(self, choice: Choice) -> str:
        column, unit, remark = self._column(choice.candidate), choice.unit, ""
        parts = [f"column: {write_key(column.key)}"]
        if column.group is not None:
            parts.append(f"group: {write_key(column.group)}")
        if unit is not None and choice.scale == unit.scale and unit.quantity != "voltage":
            plain = unit.text.isalpha() and unit.text not in ("N", "n", "y", "Y")  # truth values in YAML 1.1
            parts.append(f"unit: {unit.text if plain else quote(unit.text)}")
        else:
            parts.append(f"scale: {format_number(choice.scale)}")
            parts += [f"offset: {format_number(choice.offset)}"] if choice.offset else []
            remark = f"  # {describe_scale(choice) or (unit.text if unit else 'SI')}"
        return f"{choice.signal}: {{{', '.join(parts)}}}{remark}"

    def _column(self, candidate: Candidate) -> LogColumn:
        return self.found.keys[candidate.label]


def describe_scale(choice: Choice) -> str:
    """Return what the scale does, such as `mm to m, sign turned`; '' if nothing."""
    unit = choice.unit
    parts = [f"{unit.text} to SI"] if unit is not None and (unit.scale != 1.0 or unit.offset != 0.0) else []
    return ", ".join([*parts, *(["sign turned"] if choice.scale < 0.0 else [])])


def _explain(choice: Choice, indent: str = "") -> Iterator[str]:
    """Yield the comment lines above a choice: reasons, range, checks, and what was not chosen."""
    c = choice.candidate
    yield from _comment(f"{choice.signal}: {'; '.join(choice.reasons)}.", indent)
    yield from _comment(f"range {c.range_text}, as logged", indent)
    for check in choice.to_check:
        yield from _comment(f"{CHECK}: {check}", indent)
    yield from _list_others("not chosen", choice.others, indent)


def _explain_missing(
    missing: NotFound, describe: Callable[[Candidate], str], or_else: str, indent: str = ""
) -> Iterator[str]:
    """Yield the comment lines in the place of a signal that was not found."""
    yield from _comment(f"not found: {missing.signal}: {missing.reason}", indent)
    yield from _list_others("candidates", missing.others, indent)
    likely = [r for r in missing.others if not r.excluded]
    yield from (f"{indent}# {missing.signal}: {{{describe(r.candidate)}}}" for r in likely[:2])
    if missing.signal == "current":
        yield f"{indent}# current: {{constant: 0.0}}  # a passive damper{or_else} [A]"


def _list_others(title: str, others: Sequence[Rating], indent: str) -> Iterator[str]:
    shown = [f"{r.candidate.label} ({r.why})" for r in others[:MAX_OTHERS]]
    more = [f"{len(others) - MAX_OTHERS} more"] if len(others) > MAX_OTHERS else []
    if shown:
        yield from _comment(f"{title}: {', '.join(shown + more)}", indent)


def _comment(text: str, indent: str = "") -> Iterator[str]:
    """Yield a text as comment lines."""
    lines = textwrap.wrap(text, WIDTH - len(indent) - 2, break_long_words=False, break_on_hyphens=False)
    yield from (f"{indent}# {line if i == 0 else '  ' + line}" for i, line in enumerate(lines))
