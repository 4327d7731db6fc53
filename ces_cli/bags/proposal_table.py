"""The table of a proposal: what was chosen for each signal and why, what was not, and what a person should check."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import Console

from ces_cli.terminal.terminal import make_table
from ces_identify.proposal.choice import Choice, Selection
from ces_identify.proposal.rating import Rating
from ces_identify.proposal.text import describe_scale

MAX_OTHERS = 3


def print_proposal(selection: Selection, console: Console, skipped: Mapping[str, str] | None = None) -> None:
    """Print the table of a proposal, then one line for each thing to check and each signal that was not found."""
    table = make_table(None, ("signal", "candidate, range, rate", "why"), ())
    table.columns[0].no_wrap = True
    for row in _rows(selection):
        table.add_row(*row)
    console.print(table, highlight=False, markup=False)
    for check in selection.checks:
        _print(console, f"check: {check}", "yellow")
    for missing in selection.missing:
        _print(console, f"not found: {missing.signal}: {missing.reason}", "yellow")
    if selection.names:
        _print(console, f"several dampers: {', '.join(selection.names)}; select one with FILE#{selection.names[0]}", "")
    if skipped:
        _print(console, "not examined: " + ", ".join(f"{name} ({why})" for name, why in skipped.items()), "dim")


def proposal_rows(selection: Selection) -> list[dict[str, Any]]:
    """Return the choices and what was not found as mappings for JSON."""
    return [
        *(_as_row(name, choice) for name, damper in selection.dampers.items() for choice in damper.choices.values()),
        *(
            {"damper": name, "signal": missing.signal, "found": False, "reason": missing.reason}
            for name, damper in selection.dampers.items()
            for missing in damper.missing.values()
        ),
    ]


def _as_row(damper: str, choice: Choice) -> dict[str, Any]:
    c = choice.candidate
    return {
        "damper": damper,
        "signal": choice.signal,
        "found": True,
        "source": c.label,
        "type": c.kind,
        "scale": choice.scale,
        "offset": choice.offset,
        "low": c.low,
        "high": c.high,
        "rate_Hz": c.rate_Hz,
        "reasons": list(choice.reasons),
        "checks": list(choice.checks),
        "not_chosen": [{"source": r.candidate.label, "reason": r.why} for r in choice.others],
    }


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
    return f"{c.label}\n{c.low:.4g} to {c.high:.4g}, {c.rate_Hz:.4g} Hz"


def _print(console: Console, text: str, style: str) -> None:
    console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)
