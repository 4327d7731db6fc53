"""The costs in words and numbers: what a reader who stops after ten lines must know."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ces_identify.evaluate import VALIDATION, Evaluation

MUCH_OUTSIDE = 0.05  # share of the ticks outside the envelope that calls for a warning


@dataclass(frozen=True)
class CostRow:
    """An evaluation as a row of the cost table; texts are ready to show, `bar` is the bar's length in percent."""

    number: int
    name: str
    role: str
    span: str
    duration: str
    cost: str
    bar: float
    diverged: bool
    rms: str
    outside: str
    dropped: str
    reasons: str


def in_order(evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Return the evaluations with validation first, otherwise in the order they came."""
    return sorted(evaluations, key=lambda e: e.role != VALIDATION)


def of_role(evaluations: Sequence[Evaluation], role: str) -> list[Evaluation]:
    """Return the evaluations of `role`."""
    return [e for e in evaluations if e.role == role]


def headline(evaluations: Sequence[Evaluation]) -> str:
    """Return one sentence on the costs."""
    held_out = of_role(evaluations, VALIDATION)
    if held_out:
        return f"Validation: {_range(held_out)}."
    if not evaluations:
        return "Not validated, and not run on any recording."
    return f"Not validated: fit and selection have seen every recording below. There: {_range(evaluations)}."


def warnings(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return what a reader must be warned of: runs that diverged, and inputs often outside the envelope."""
    diverged = [
        f"{e.name} ({e.role}) at {e.series.time_s[e.run.diverged]:.2f} s" for e in evaluations if e.run.diverged >= 0
    ]
    outside = [
        f"{100.0 * e.clamped_share:.0f} % of {e.name} ({e.role})" for e in evaluations if e.clamped_share > MUCH_OUTSIDE
    ]
    texts = ("Diverged: the simulated force left the force envelope on ", "Inputs outside the model's envelope: ")
    return [f"{text}{', '.join(which)}." for text, which in zip(texts, (diverged, outside), strict=True) if which]


def cost_rows(evaluations: Sequence[Evaluation]) -> list[CostRow]:
    """Return the rows of the cost table."""
    longest = max([e.cost for e in evaluations if math.isfinite(e.cost)] + [1e-9])
    return [_row(i, e, longest) for i, e in enumerate(evaluations)]


def three_figures(value: float) -> str:
    """Return a cost, share or force to three figures, `∞` if it is infinite, a dash if there is none."""
    if not math.isfinite(value):
        return "\N{INFINITY}" if math.isinf(value) else "\N{EN DASH}"
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def _row(number: int, e: Evaluation, longest: float) -> CostRow:
    finite = math.isfinite(e.cost)
    gaps = len(e.series.segments) - 1
    reasons = {**{reason: n for reason, n in e.series.dropped.items() if n}, **({"gaps": gaps} if gaps else {})}
    return CostRow(
        number=number,
        name=e.name,
        role=e.role,
        span=f"{e.series.time_s[0]:.1f}\N{EN DASH}{e.series.time_s[-1]:.1f}",
        duration=f"{e.series.scored.sum() / e.series.rate_Hz:.1f}",
        cost=three_figures(e.cost),
        bar=100.0 * e.cost / longest if finite else 100.0,
        diverged=not finite or e.run.diverged >= 0,
        rms=three_figures(e.rms_N),
        outside=three_figures(100.0 * e.clamped_share) if e.clamped_share else "0",
        dropped=f"{sum(e.series.dropped.values())} / {gaps}",
        reasons=", ".join(f"{reason}: {n}" for reason, n in reasons.items()),
    )


def _range(evaluations: Sequence[Evaluation]) -> str:
    finite = sorted((e for e in evaluations if math.isfinite(e.cost)), key=lambda e: e.cost)
    lost = len(evaluations) - len(finite)
    if not finite:
        return f"the free run diverged on every recording ({lost})"
    best, worst = (f"{three_figures(e.cost)} % ({e.name})" for e in (finite[0], finite[-1]))
    costs = f"cost J = {best}" if len(finite) == 1 else f"cost J from {best} to {worst}, {len(finite)} recordings"
    return costs + (f"; the free run diverged on {lost} more" if lost else "")
