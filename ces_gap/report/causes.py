"""The ranked causes as rows of a table: probability, parameters, gap left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ces_gap.diagnosis import Diagnosis, Estimate, Explanation
from ces_gap.effects.effect import Setting
from ces_gap.inference.verdict import CALIBRATION
from ces_gap.report.formatting import EFFECTS, effect_name, parameter_text, percent, percents
from ces_identify.typesetting import three_figures

MAX_ROWS = 6  # effects with a row of their own
ALWAYS = 3  # as many effects always have a row
MIN_PROBABILITY = 0.005  # of a further effect with a row


@dataclass(frozen=True)
class ParameterText:
    """A parameter as text: description, and a warning if its value is not reliable."""

    name: str
    value: str
    unit: str
    interval: str
    what: str
    warning: str


@dataclass(frozen=True)
class CauseRow:
    """One effect alone; `bar` is its probability [%], `named` if the verdict names it or one indistinguishable."""

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
    """Return the rows of the probable causes, most probable first."""
    causes = [c for i, c in enumerate(d.causes[:MAX_ROWS]) if i < ALWAYS or c.probability >= MIN_PROBABILITY]
    named = _named_effects(d)
    return [_row(c, c.effects[0] in named) for c in causes]


def effects_without_row(d: Diagnosis, rows: Sequence[CauseRow]) -> list[str]:
    """Return the names of the effects that have no row."""
    shown = {row.effect for row in rows}
    return [n for n in (effect_name(c.effects[0]) for c in d.causes) if n not in shown]


def composition_rows(d: Diagnosis) -> list[tuple[str, str, tuple[ParameterText, ...]]]:
    """Return effect, form and jointly fitted parameters of a composition of several effects."""
    c = d.composition
    if len(c.effects) < 2:
        return []
    parts = zip(c.effects, c.forms, c.estimates, c.composition.settings, strict=True)
    return [(effect_name(e), effect_name(f), _parameters(estimates, s)) for e, f, estimates, s in parts]


def _named_effects(d: Diagnosis) -> set[str]:
    """Return the effects of the composition and those indistinguishable from them."""
    effects = set(d.composition.effects)
    return effects.union(*(group for group in d.indistinguishable if effects & set(group)))


def _row(cause: Explanation, named: bool) -> CauseRow:
    return CauseRow(
        effect=effect_name(cause.effects[0]),
        what=EFFECTS.get(cause.effects[0], ""),
        form=effect_name(cause.forms[0]),
        named=named,
        bar=100.0 * cause.probability,
        probability=percent(cause.probability),
        parameters=_parameters(cause.estimates[0], cause.composition.settings[0]),
        gap_after=three_figures(cause.gap_after_N),
        shrink=percent(cause.shrink),
        interval=percents(cause.shrink_ci95),
    )


def _parameters(estimates: Sequence[Estimate], setting: Setting) -> tuple[ParameterText, ...]:
    """Return the parameters as text; those of a calibration are shown as a table of its map instead."""
    if setting.name == CALIBRATION:
        return ()
    what = {p.name: p.what for p in setting.effect.parameters}
    return tuple(ParameterText(*parameter_text(e), what.get(e.name, ""), _warning(e)) for e in estimates)


def _warning(estimate: Estimate) -> str:
    return ", ".join(["at its bound"] * estimate.at_bound + ["differs between folds"] * estimate.drifts)
