"""The result of a diagnosis: the record from which files and reports are written, and its verdict as one sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ces_gap.baseline.learner import LearnedCorrection
from ces_gap.baseline.surrogate import Surrogate
from ces_gap.experiment.next_experiment import NextExperiment
from ces_gap.grid import is_constant
from ces_gap.inference.fit import Estimate, Interval
from ces_gap.inference.held_out import CLEARLY_LESS, Explanation, Gap, HeldOutSeries
from ces_gap.inference.verdict import (
    AMBIGUOUS,
    CALIBRATION,
    NAMED,
    NO_GAP,
    POSSIBLE,
    TIMING,
    UNKNOWN,
    WITHIN_BASELINE,
    WITHIN_NOISE,
    WITHIN_TOLERANCE,
    VerdictFigures,
)
from ces_gap.refit import ModelRefits
from ces_gap.regions.axes import GapMap, GapRegion, Where
from ces_gap.trace import usable_inputs, usable_values
from ces_report.typesetting import join_with

__all__ = [
    "AMBIGUOUS", "NAMED", "NO_GAP", "UNKNOWN", "Diagnosis", "Estimate", "Explanation", "Gap", "GapMap", "GapRegion",
    "HeldOutSeries", "Interval", "NextExperiment", "VerdictFigures", "Where",
]  # fmt: skip


@dataclass(frozen=True)
class Diagnosis:
    """The complete result of a diagnosis."""

    verdict: str
    sentence: str
    simulation: str  # as on the command line
    gap: Gap
    where: Where
    causes: tuple[Explanation, ...]  # each effect alone in its best form, ranked
    composition: Explanation
    indistinguishable: tuple[tuple[str, ...], ...]
    not_separable: tuple[str, ...]  # effects that a recalibration could absorb (without references)
    invisible: tuple[tuple[str, str], ...]  # effect, reason why these recordings cannot show it
    ceiling_after_N: float
    wrong: Explanation | None  # control: the best effect outside the composition
    no_gap_reason: str  # of the verdict "no_gap": WITHIN_... of `inference/verdict.py`, "" otherwise
    tolerance_N: float  # a gap up to this RMS counts as none
    visible_from_N: float  # RMS below which an effect would hide behind noise and the simulation's own error
    probability_none: float
    probability_unknown: float
    rest: Where | None  # location of the unexplained rest, for "unknown"
    next_experiment: NextExperiment | None
    surrogate_cost_J: float | None  # of the surrogate of recorded predictions, None if the simulation was run
    held_out: tuple[HeldOutSeries, ...]
    by_region: tuple[tuple[GapRegion, float], ...] = ()  # gap after [N] in each region of `where`
    notes: tuple[str, ...] = ()
    seen_notes: tuple[str, ...] = ()  # those on recordings from which the simulation was identified
    correction: LearnedCorrection | None = None  # of the baseline error
    surrogate: Surrogate | None = None  # of recorded predictions
    surrogate_error: float | None = None  # its `difference_error`
    baselines: Mapping[str, str] = field(default_factory=dict)  # effects that simpler selection rules name
    figures: VerdictFigures | None = None  # the basis of the verdict
    refits: ModelRefits | None = None  # of a physical model's parameters, None for other simulations
    refit_finding: str = ""  # what they say of the composition

    def __repr__(self) -> str:
        return f"<{self.verdict}: {self.sentence}>"


SPEED_SHARES = np.array([0.0, 0.05, 0.35, 0.65, 0.95, 1.0])  # quantiles that bound the cells of speed
CURRENT_SHARES = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
MIN_TICKS = 10


@dataclass(frozen=True)
class CalibrationCell:
    """The mean force [N] that the map adds within ranges of speed [m/s] and current [A]."""

    speed_m_s: tuple[float, float]
    current_A: tuple[float, float]
    force_N: float


def calibration_cells(diagnosis: Diagnosis) -> tuple[CalibrationCell, ...]:
    """Return the cells of the composition's calibration on the held-out recordings; none if it has none."""
    setting = next((s for s in diagnosis.composition.composition.settings if s.name == CALIBRATION), None)
    traces = [s.trace for s in diagnosis.held_out]
    if setting is None or not traces:
        return ()
    maps = [setting.effect.respond(t, t.inputs, np.zeros(len(t)), setting.values) for t in traces]
    added, speed, current = (usable_values(traces, maps), *(usable_inputs(traces, n) for n in ("speed", "current")))
    speeds = np.quantile(speed, SPEED_SHARES)
    ends = np.array([current.min(), current.max()])
    currents = ends if is_constant(current) else np.quantile(current, CURRENT_SHARES)
    rows = [(low, high, (speed >= low) & (speed <= high)) for low, high in pairwise(speeds)]
    columns = [(low, high, (current >= low) & (current <= high)) for low, high in pairwise(currents)]
    return tuple(
        CalibrationCell((float(a), float(b)), (float(c), float(d)), float(added[row & column].mean()))
        for a, b, row in rows
        for c, d, column in columns
        if (row & column).sum() >= MIN_TICKS
    )


def format_verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    if diagnosis.verdict == NO_GAP:
        return _describe_no_gap(diagnosis)
    gap, after_N, effects = diagnosis.gap, diagnosis.composition.gap_after_N, _causes(diagnosis)
    if diagnosis.verdict == UNKNOWN:
        closest = ""
        if effects:  # the composition, or an effect alone that is less probable, whichever leaves less
            alone = min(diagnosis.causes, key=lambda c: c.gap_after_N if np.isfinite(c.gap_after_N) else np.inf)
            if alone.gap_after_N < after_N:
                effects, after_N = [alone.effects[0]], alone.gap_after_N
            closest = f"; the closest, {_join(effects, 'and')}, leaves {after_N:.0f} N"
        return f"None of the known effects explains the gap of {gap.rms_N:.0f} N RMS{closest}."
    shrink = f"the gap shrinks from {gap.rms_N:.0f} N to {after_N:.0f} N RMS"
    if after_N >= gap.rms_N:
        shrink = f"the gap does not shrink ({gap.rms_N:.0f} N RMS before, {after_N:.0f} N after)"
    if diagnosis.verdict == AMBIGUOUS:
        ambiguity = _describe_ambiguity(diagnosis)
        return f"{ambiguity[:1].upper()}{ambiguity[1:]}; with {_join(effects, 'and')}, {shrink}."
    if tuple(effects) == (CALIBRATION,):
        cell = max(calibration_cells(diagnosis), key=lambda c: abs(c.force_N))
        speed, current = "{:.2g} to {:.2g} m/s".format(*cell.speed_m_s), f"{np.mean(cell.current_A):.2g} A"
        size = f"most at {speed} and about {current} ({cell.force_N:+.0f} N)"
        return f"The simulation's force map is off, {size}: recalibrated, {shrink} on held-out recordings."
    named = f"The gap is caused by {_join(effects, 'and')}: with this effect added, {shrink} on held-out recordings"
    imitated = [e for e in effects if e in diagnosis.not_separable]
    return f"{named}; a recalibration of the simulation would explain it, too." if imitated else f"{named}."


def _describe_no_gap(diagnosis: Diagnosis) -> str:
    gap, reason = diagnosis.gap, diagnosis.no_gap_reason
    left_N = min(gap.corrected_N, gap.rms_N)
    if reason == WITHIN_TOLERANCE:
        limit = f"the tolerance of {diagnosis.tolerance_N:.1f} N"
        return f"No gap above {limit}: {left_N:.1f} N RMS between simulation and measurement."
    if reason == WITHIN_BASELINE:
        explained = f"the references explain all but {left_N:.0f} N of the {gap.rms_N:.0f} N RMS"
        hidden = f"effects below about {diagnosis.visible_from_N:.0f} N RMS cannot be seen"
        return f"No gap beyond the simulation's own error: {explained}; {hidden} behind this simulation's error."
    if reason == WITHIN_NOISE:
        noise = f"the measurement noise of {gap.noise_floor_N:.1f} N RMS (from {gap.noise_source})"
        return f"No gap: {left_N:.1f} N RMS remain, within {noise}."
    return f"No gap beyond the simulation's timing of at most a sample: {left_N:.1f} N RMS before it is corrected."


def _causes(diagnosis: Diagnosis) -> list[str]:
    """Return the effects of the composition, the one that closes most alone first, without the simulation's timing."""
    alone = {c.effects[0]: c.gap_after_N for c in diagnosis.causes}
    effects = [e for e in diagnosis.composition.effects if e != TIMING]
    return sorted(effects, key=lambda e: alone.get(e, np.inf))


def _describe_ambiguity(diagnosis: Diagnosis) -> str:
    """Return what these recordings leave open: effects indistinguishable from a cause, or further possible causes."""
    after = {c.effects[0]: c.gap_after_N for c in diagnosis.causes}
    effects = diagnosis.composition.effects
    group = next((g for g in diagnosis.indistinguishable if set(g) & set(effects)), ())
    if group:
        ordered = sorted(group, key=lambda e: after.get(e, np.inf))
        return f"These recordings cannot distinguish between {_join(ordered, 'and')}"
    outside = [c for c in diagnosis.causes if c.effects[0] not in (*effects, CALIBRATION)]
    limit = CLEARLY_LESS * diagnosis.composition.gap_after_N
    others = [c.effects[0] for c in outside if c.probability >= POSSIBLE or c.gap_after_N < limit]
    if others:
        return f"These recordings do not rule out {_join(others, 'or')}"
    imitated = [e for e in _causes(diagnosis) if e in diagnosis.not_separable]
    if imitated and len(effects) > 1:
        return f"{_join(imitated, 'and')} may be an error of the simulation itself"
    if diagnosis.refit_finding:
        return diagnosis.refit_finding
    if diagnosis.composition.shrink_ci95[0] <= 0.0:
        return "The held-out recordings do not confirm the best explanation"
    return "The best explanation is not certain enough to be named"


def _join(effects: Sequence[str], last: str) -> str:
    """Return `a, b and c`."""
    names = ["the simulation's force map" if e == CALIBRATION else e.replace("_", " ") for e in effects]
    return join_with(names, last)
