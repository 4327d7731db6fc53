"""The ranked causes as rows of a table: probability, parameters, what each leaves of the gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ces_gap.diagnosis import Diagnosis, Estimate, Explanation
from ces_gap.effects.effect import Setting
from ces_gap.report.formatting import EFFECTS, effect_name, newtons, parameter_text, percent, percents

MAX_ROWS = 6  # effects with a row of their own
MIN_PROBABILITY = 0.005  # probability of an effect that is told beyond the first three
ALWAYS = 3


@dataclass(frozen=True)
class ParameterText:
    """A parameter as text: what it is, and a warning if its value is not to be trusted."""

    name: str
    value: str
    unit: str
    interval: str
    what: str
    warning: str


@dataclass(frozen=True)
class CauseRow:
    """An effect alone as a row; `bar` is its probability in percent, `named` that it or a twin is to blame."""

    effect: str
    what: str
    form: str
    named: bool
    bar: float
    probability: str
    parameters: tuple[ParameterText, ...]
    gap_after: str
    shrink: str
    interval: str


def cause_rows(d: Diagnosis) -> list[CauseRow]:
    """Return the causes worth a row, most probable first."""
    kept = [c for i, c in enumerate(d.causes[:MAX_ROWS]) if i < ALWAYS or c.probability >= MIN_PROBABILITY]
    blamed = _named_effects(d)
    return [_row(c, c.effects[0] in blamed) for c in kept]


def effects_without_row(d: Diagnosis, rows: Sequence[CauseRow]) -> list[str]:
    """Return the names of the effects that were tried and have no row."""
    shown = {row.effect for row in rows}
    return [n for n in (effect_name(c.effects[0]) for c in d.causes) if n not in shown]


def composition_rows(d: Diagnosis) -> list[tuple[str, str, tuple[ParameterText, ...]]]:
    """Return effect, form and jointly fitted parameters of a composition of several effects; none of a single one."""
    c = d.composition
    if len(c.effects) < 2:
        return []
    parts = zip(c.effects, c.forms, c.estimates, c.composition.settings, strict=True)
    return [(effect_name(e), effect_name(f), _parameters(estimates, s)) for e, f, estimates, s in parts]


def _named_effects(d: Diagnosis) -> set[str]:
    """Return the effects of the composition with their twins."""
    found = set(d.composition.effects)
    return found.union(*(twins for twins in d.indistinguishable if found & set(twins)))


def _row(cause: Explanation, named: bool) -> CauseRow:
    return CauseRow(
        effect=effect_name(cause.effects[0]),
        what=EFFECTS.get(cause.effects[0], ""),
        form=effect_name(cause.forms[0]),
        named=named,
        bar=100.0 * cause.probability,
        probability=percent(cause.probability),
        parameters=_parameters(cause.estimates[0], cause.composition.settings[0]),
        gap_after=newtons(cause.gap_after_N),
        shrink=percent(cause.shrink),
        interval=percents(cause.shrink_ci95),
    )


def _parameters(estimates: Sequence[Estimate], setting: Setting) -> tuple[ParameterText, ...]:
    what = {p.name: p.what for p in setting.effect.parameters}
    return tuple(ParameterText(*parameter_text(e), what.get(e.name, ""), _warning(e)) for e in estimates)


def _warning(estimate: Estimate) -> str:
    said = ["stuck at its bound"] * estimate.at_bound + ["differs between folds"] * estimate.drifts
    return ", ".join(said)
