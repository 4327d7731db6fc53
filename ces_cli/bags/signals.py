"""`ces signals`: proposes a signals file from the topics of bags, with the reason for each guess."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from ces_cli.terminal import terminal
from ces_cli.terminal.options import BAGS, OutputRequest, option
from ces_cli.terminal.outputs import print_document, schema_line
from ces_data.bags.find import find_bags
from ces_data.mapping.choice import Choice, Selection
from ces_data.mapping.proposals import describe_scale, propose_signals
from ces_data.mapping.rating import Rating
from ces_data.outputs import OUT, require_outputs
from ces_observer.json_text import write_atomically
from ces_observer.records import declare
from ces_report.table import text_table

MAX_OTHERS = 3


@dataclass(frozen=True, kw_only=True)
class SignalsRequest(OutputRequest):
    """Propose a signals file from the topics that bags hold: which field is position, current and force, in which unit
    and with which sign, with the reason for each guess, and with what could not be known. Without --out the file goes
    to the standard output. Several bags have to have the same topics.
    """

    program = "signals"
    example = "ces signals bags/noise --out my_signals.yaml"

    bags: tuple[str, ...] = declare(BAGS)
    out: Path | None = option(None, "signals file to write (YAML)", metavar="FILE")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError if nothing looks like a signal."""
    request = terminal.read(SignalsRequest, argv)
    require_outputs(request.overwrite, {OUT: request.out})
    paths = find_bags(request.bags)
    with terminal.step("reading all topics"):
        proposal = propose_signals(paths)
    text = schema_line("signals") + proposal.text
    if request.out:
        write_atomically(request.out, text)
    if request.json:
        chosen = proposal.selection
        facts = {"dampers": list(chosen.names), "signals": proposal_rows(chosen), "checks": list(chosen.checks)}
        print_document("signals", {**facts, "not_examined": proposal.skipped})
    elif request.out is None:
        print(text, end="")
    print_proposal(
        proposal.selection, terminal.err if request.json or request.out is None else terminal.out, proposal.skipped
    )
    if request.out:
        example = f"{request.out}#{proposal.selection.names[0]}" if proposal.selection.names else f"{request.out}"
        missing = " and ".join(dict.fromkeys(choice.signal for choice in proposal.selection.missing))
        by_hand = f"complete {example} by hand: nothing was found for {missing} (its comments say why)"
        terminal.print_line(f"signals: {request.out}", console=terminal.err)
        step = by_hand if missing else f"ces info {paths[0]} --signals '{example}'"
        terminal.print_line(f"next:    {step}", console=terminal.err)
    return 0


def print_proposal(selection: Selection, console: Console, skipped: Mapping[str, str] | None = None) -> None:
    """Print the table of a proposal, then one line for each thing to check and each signal that was not found."""
    table = terminal.lay_out(text_table(("signal", "candidate, range, rate", "why"), _rows(selection), left=3))
    table.columns[0].no_wrap = True
    console.print(table, highlight=False)
    for check in selection.checks:
        terminal.print_line(f"check: {check}", "yellow", console)
    for missing in selection.missing:
        terminal.print_line(f"not found: {missing.signal}: {missing.reason}", "yellow", console)
    if selection.names:
        names = ", ".join(selection.names)
        terminal.print_line(f"several dampers: {names}; select one with FILE#{selection.names[0]}", console=console)
    if skipped:
        names = ", ".join(f"{name} ({why})" for name, why in skipped.items())
        terminal.print_line(f"not examined: {names}", "dim", console)


def proposal_rows(selection: Selection) -> list[dict[str, Any]]:
    """Return the choices and what was not found as mappings for JSON."""
    rows: list[dict[str, Any]] = []
    for name, damper in selection.dampers.items():
        for choice in damper.choices.values():
            c = choice.candidate
            facts = {"source": c.label, "type": c.kind, "scale": choice.scale, "offset": choice.offset}
            facts |= {"low": c.low, "high": c.high, "rate_Hz": c.rate_Hz}
            facts |= {"reasons": choice.reasons, "checks": choice.to_check}
            others = [{"source": r.candidate.label, "reason": r.why} for r in choice.others]
            rows.append({"damper": name, "signal": choice.signal, "found": True, **facts, "not_chosen": others})
    rows += [
        {"damper": name, "signal": missing.signal, "found": False, "reason": missing.reason}
        for name, damper in selection.dampers.items()
        for missing in damper.missing.values()
    ]
    return rows


def _rows(selection: Selection) -> Iterator[tuple[str, ...]]:
    for name, damper in selection.dampers.items():
        mark = f"{name}." if name else ""
        for signal, choice in damper.choices.items():
            remark = describe_scale(choice)
            why = "; ".join(choice.reasons) + (f" [{remark}]" if remark else "")
            yield (f"{mark}{signal}", _describe(choice), why)
            yield from _others(choice.others)
        for missing in damper.missing.values():
            yield (f"{mark}{missing.signal}", "not found", missing.reason)
            yield from _others(missing.others)


def _others(ratings: tuple[Rating, ...]) -> Iterator[tuple[str, ...]]:
    for rating in ratings[:MAX_OTHERS]:
        yield ("  not", _describe(rating), rating.why)


def _describe(of: Choice | Rating) -> str:
    c = of.candidate
    return f"{c.label}\n{c.range_text}"
