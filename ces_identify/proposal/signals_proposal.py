"""A signals file from bags: the topics that look like position, current and force, each with the reason."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ces_identify.proposal.bag_candidates import find_bag_candidates
from ces_identify.proposal.choice import Choice, DamperChoice, Selection
from ces_identify.proposal.choose import choose
from ces_identify.proposal.text import (
    CHECK,
    comment,
    describe_scale,
    explain,
    explain_missing,
    format_number,
    name_yaml,
    one_line,
    quote_yaml,
)
from ces_observer.errors import RecordingError

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
