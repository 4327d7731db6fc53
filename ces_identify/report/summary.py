"""The summary of a report: the most important costs as texts and table rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ces_identify.preparation.cost import weighted_cost
from ces_identify.preparation.weighting import EQUAL, Weighting
from ces_identify.structures.auto import advise
from ces_identify.typesetting import join_names, minus, three_figures
from ces_identify.validation.cost_interval import CostInterval, cost_interval, pooled_cost
from ces_identify.validation.cycle_noise import CycleNoise, cycle_noise
from ces_identify.validation.envelope_use import UNITS
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation
from ces_identify.validation.missing_figures import explain_missing
from ces_observer.model import Model

ROLES = (VALIDATION, IDENTIFICATION)
MAX_WARNED = 3  # recordings outside the envelope that have a warning each


def select_role(evaluations: Sequence[Evaluation], role: str) -> list[Evaluation]:
    """Return the evaluations of `role`."""
    return [e for e in evaluations if e.role == role]


def describe_recordings(evaluations: Sequence[Evaluation]) -> str:
    """Return the recordings of the report in a phrase, such as `road (validation); noise, sweep (identification)`."""
    named = ((role, join_names([e.name for e in select_role(evaluations, role)])) for role in ROLES)
    return "; ".join(f"{names} ({role})" for role, names in named if names)


def headline(evaluations: Sequence[Evaluation]) -> str:
    """Return one sentence about the costs."""
    held_out = select_role(evaluations, VALIDATION)
    if held_out:
        return f"Validation: {_format_range(held_out)}."
    if not evaluations:
        return "Not validated, and not run on any recording."
    return f"Not validated: fit and selection used all recordings below. On these: {_format_range(evaluations)}."


def warnings(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return warnings about runs that diverged and inputs outside the envelope, with the signals' ranges.

    Of more than MAX_WARNED recordings outside, `outside_rows` has the ranges.
    """
    diverged = [
        f"{e.name} ({e.role}) at {e.series.time_s[e.run.diverged]:.2f} s" for e in evaluations if e.run.diverged >= 0
    ]
    texts = [f"Diverged: the simulated force left the force envelope on {', '.join(diverged)}."] if diverged else []
    outside = [e for e in evaluations if e.outside]
    if len(outside) <= MAX_WARNED:
        return texts + [minus(f"{e.outside_text} ({e.role}).") for e in outside]
    most = max(e.clamped_share for e in outside)
    many = f"{len(outside)} of {len(evaluations)} recordings are outside the model's envelope"
    return [*texts, f"{many}, for up to {100.0 * most:.1f} % of the time: see the table after the costs."]


def outside_rows(evaluations: Sequence[Evaluation]) -> list[tuple[str, ...]]:
    """Return recording, signal, ranges used and known, and share of the time, if there are too many for warnings."""
    if sum(bool(e.outside) for e in evaluations) <= MAX_WARNED:
        return []
    return [
        (e.name, f"{use.signal} [{UNITS[use.signal]}]", *map(minus, use.as_texts()), f"{100.0 * use.outside_share:.1f}")
        for e in evaluations
        for use in e.outside
    ]


def cost_rows(evaluations: Sequence[Evaluation], weighting: Weighting = EQUAL) -> list[dict[str, Any]]:
    """Return the rows of the cost table with texts that are ready to show.

    `bar` is the length of the row's bar [%], `whisker` the start and length of the interval on the same scale.
    """
    intervals = [cost_interval([e]) for e in evaluations]
    highest = [i.high for i in intervals if i is not None]
    longest = max([e.cost for e in evaluations if math.isfinite(e.cost)] + highest + [1e-9])
    return [_row(i, e, longest, intervals[i], weighting) for i, e in enumerate(evaluations)]


def missing_figures(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return why figures of the cost table are missing, a sentence for each reason."""
    intervals, floors = [cost_interval([e]) for e in evaluations], [cycle_noise(e.series) for e in evaluations]
    return [f"{line[0].upper()}{line[1:]}." for line in explain_missing(evaluations, intervals, floors)]


def pooled_row(held_out: Sequence[Evaluation]) -> dict[str, Any] | None:
    """Return the row of all validation recordings together; None for fewer than two, or if one diverged."""
    if len(held_out) < 2 or not all(math.isfinite(e.cost) for e in held_out):
        return None
    seconds = sum(float(e.series.scored.sum()) / e.series.rate_Hz for e in held_out)
    return {
        "number": len(held_out),
        "duration": f"{seconds:.1f}",
        "cost": three_figures(pooled_cost(held_out)),
        "interval": _format_interval(cost_interval(held_out)),
    }


def structure_rows(model: Model) -> list[tuple[str, str, str]]:
    """Return name, cost on the selection data [%] and kind of fit for each structure that was compared, best first."""
    selection = model.provenance.get("selection", {})
    kinds = {selection.get("structure"): "this model"}
    return [(n, three_figures(cost), kinds.get(n, "short fit")) for n, cost in selection.get("structures", {}).items()]


def structure_advice(model: Model) -> str:
    """Return a sentence on a structure that is clearly better than the model's, or nothing."""
    selection = model.provenance.get("selection", {})
    return advise(selection["structures"], selection["structure"]) if selection.get("structures") else ""


def _row(
    number: int, e: Evaluation, longest: float, interval: CostInterval | None, weighting: Weighting
) -> dict[str, Any]:
    finite, floor = math.isfinite(e.cost), cycle_noise(e.series)
    gaps = len(e.series.segments) - 1
    reasons = {**{reason: n for reason, n in e.series.dropped.items() if n}, **({"gaps": gaps} if gaps else {})}
    return {
        "number": number,
        "name": e.name,
        "role": e.role,
        "span": f"{e.series.time_s[0]:.1f}\N{EN DASH}{e.series.time_s[-1]:.1f}",
        "duration": f"{e.series.scored.sum() / e.series.rate_Hz:.1f}",
        "cost": three_figures(e.cost),
        "bar": 100.0 * e.cost / longest if finite else 100.0,
        "diverged": not finite or e.run.diverged >= 0,
        "rms": three_figures(e.rms_N),
        "outside": three_figures(100.0 * e.clamped_share) if e.clamped_share else "0",
        "coverage": "" if e.coverage is None else three_figures(100.0 * e.coverage),
        "dropped": f"{sum(e.series.dropped.values())} / {gaps}",
        "reasons": ", ".join(f"{reason}: {n}" for reason, n in reasons.items()),
        "interval": _format_interval(interval),
        "whisker": (100.0 * interval.low / longest, 100.0 * (interval.high - interval.low) / longest)
        if interval
        else None,
        "floor": three_figures(floor.floor) if isinstance(floor, CycleNoise) else "",
        "weighted": _format_weighted_cost(e, weighting) if weighting else "",
    }


def _format_interval(interval: CostInterval | None) -> str:
    if interval is None:
        return "\N{EN DASH}"
    return f"{three_figures(interval.low)} to {three_figures(interval.high)}"


def _format_weighted_cost(e: Evaluation, weighting: Weighting) -> str:
    scored = e.series.scored
    weights = weighting.tick_weights(e.series)[scored]
    return three_figures(weighted_cost(e.series.force[scored], e.run.force[scored], weights))


def _format_range(evaluations: Sequence[Evaluation]) -> str:
    finite = sorted((e for e in evaluations if math.isfinite(e.cost)), key=lambda e: e.cost)
    lost = len(evaluations) - len(finite)
    if not finite:
        return f"the free run diverged on every recording ({lost})"
    best, worst = (f"{three_figures(e.cost)} % ({e.name})" for e in (finite[0], finite[-1]))
    costs = f"cost J = {best}" if len(finite) == 1 else f"cost J from {best} to {worst}, {len(finite)} recordings"
    return costs + (f"; the free run diverged on {lost} more" if lost else "")
