"""The result of a diagnosis: the record from which files and reports are written, and its verdict as one sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ces_gap.baseline.learner import LearnedCorrection
from ces_gap.baseline.twin import Twin
from ces_gap.effects.effect import Composition
from ces_gap.experiment.next_experiment import NextExperiment
from ces_gap.grid import is_constant
from ces_gap.inference.fit import Estimate, Interval
from ces_gap.inference.held_out import Explanation, Gap, HeldOutSeries
from ces_gap.inference.judgement import (
    ALTERNATIVES,
    AMBIGUOUS,
    CALIBRATION,
    LEAVES_MORE,
    NAMED,
    NO_GAP,
    NOT_CONFIRMED,
    PARAMETERS,
    REMAINS,
    SIMULATION_ERROR,
    TIMING,
    UNDETERMINED,
    UNKNOWN,
    WITHIN_BASELINE,
    WITHIN_NOISE,
    WITHIN_TOLERANCE,
)
from ces_gap.inference.odds import VerdictFigures
from ces_gap.inference.rare import RareDeviation
from ces_gap.inputs.probe_result import NOT_PROBED, SimulationProbe
from ces_gap.regions.axes import GapMap, GapRegion, Where
from ces_gap.trace import usable_inputs, usable_values
from ces_report.typesetting import format_number, format_range, join_with, minus

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
    no_gap_reason: str  # of the verdict "no_gap": WITHIN_... of `inference/verdict.py`, "" otherwise
    tolerance_N: float  # a gap up to this RMS counts as none
    visible_from_N: float  # RMS below which an effect would hide behind noise and the simulation's own error
    probability_none: float
    probability_unknown: float
    rest: Where | None  # location of the unexplained rest, for "unknown"
    next_experiment: NextExperiment | None
    is_recorded: bool  # whether the simulation is known from recorded predictions only
    held_out: tuple[HeldOutSeries, ...]
    by_region: tuple[tuple[GapRegion, float], ...] = ()  # gap after [N] in each region of `where`
    notes: tuple[str, ...] = ()
    seen_notes: tuple[str, ...] = ()  # those on recordings from which the simulation was identified
    correction: LearnedCorrection | None = None  # of the baseline error
    twin: Twin | None = None  # of the simulation
    figures: VerdictFigures | None = None  # the basis of the verdict
    doubt: str = ""  # what keeps a cause from being named: constants of `inference/verdict.py`
    alternatives: tuple[str, ...] = ()  # effects outside the composition that stay possible
    explained_as_well: tuple[tuple[str, ...], ...] = ()  # by each of these, parameters and effects together
    timed_N: float = float("nan")  # gap after the simulation's timing was fitted
    probe: SimulationProbe = NOT_PROBED  # what the simulation does to its inputs
    rare: RareDeviation | None = None  # the largest local deviation, if it stands out

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
    if setting.effect.edits and diagnosis.twin is not None:
        maps = [diagnosis.twin.change(t, t.inputs, Composition((setting,))) for t in traces]
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


def find_closest(diagnosis: Diagnosis) -> Explanation | None:
    """Return what leaves least of the held-out gap, the composition or an effect alone; None if nothing shrinks it."""
    together = [diagnosis.composition] if diagnosis.composition.effects else []
    known = [e for e in (*together, *diagnosis.causes) if e.gap_after_N < diagnosis.gap.corrected_N]
    return min(known, key=lambda e: e.gap_after_N, default=None)


def describe_correction(diagnosis: Diagnosis) -> str:
    """Return the words that tell the corrected gap from the original one where the correction takes a part of it."""
    gap = diagnosis.gap
    if not gap.corrected_N < gap.rms_N or _newtons(gap.corrected_N) == _newtons(gap.rms_N):
        return ""
    if PARAMETERS in diagnosis.composition.effects:
        return " that the parameters leave"
    return " beyond the timing of its inputs" if diagnosis.correction is None else " beyond the simulation's own error"


def find_best_other(diagnosis: Diagnosis, shown: Explanation) -> Explanation | None:
    """Return the effect that alone closes most beside what is `shown`; None if there is none."""
    others = [c for c in diagnosis.causes if c.effects[0] not in shown.effects and math.isfinite(c.shrink)]
    return max(others, key=lambda c: c.shrink, default=None)


def format_verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    gap, after_N, effects = diagnosis.gap, diagnosis.composition.gap_after_N, _causes(diagnosis, diagnosis.composition)
    if diagnosis.verdict == NO_GAP:
        return _describe_no_gap(diagnosis)
    if diagnosis.verdict == UNKNOWN:
        size = f"{_newtons(gap.corrected_N)} RMS{describe_correction(diagnosis)}"
        return f"None of the known effects explains the gap of {size}{_describe_rest(diagnosis)}."
    shrink = f"the gap{describe_correction(diagnosis)} {_describe_shrink(gap.corrected_N, after_N)}"
    if diagnosis.verdict == AMBIGUOUS:
        ambiguity = _describe_ambiguity(diagnosis)
        fitted = f"with {_join(effects, 'and')}, {shrink}" if effects else "what was fitted enlarges the held-out gap"
        return f"{ambiguity[:1].upper()}{ambiguity[1:]}; {fitted}."
    if tuple(effects) == (CALIBRATION,):
        cell = max(calibration_cells(diagnosis), key=lambda c: abs(c.force_N))
        speed, current = f"{format_range(*cell.speed_m_s)} m/s", f"{format_number(float(np.mean(cell.current_A)))} A"
        size = f"most at {speed} and about {current} ({cell.force_N:+.0f} N)"
        return f"The simulation's force map is off, {size}: recalibrated, {shrink} on held-out recordings."
    added = "this effect" if len(effects) == 1 else "these"
    named = f"The gap is caused by {_join(effects, 'and')}: with {added} added, {shrink} on held-out recordings"
    imitated = [e for e in effects if e in diagnosis.not_separable and CALIBRATION not in effects]
    return f"{named}; a recalibration of the simulation would explain it, too." if imitated else f"{named}."


def _describe_shrink(before_N: float, after_N: float) -> str:
    before, after = _newtons(before_N), _newtons(after_N)
    return f"of {before} RMS hardly shrinks" if before == after else f"shrinks from {before} to {after} RMS"


def _describe_rest(diagnosis: Diagnosis) -> str:
    """Return what the closest explanation and a learner leave of an unknown gap, and whether its noise is known."""
    closest, text = find_closest(diagnosis), ""
    if closest is not None:
        names = _join(_causes(diagnosis, closest) or closest.effects, "and")
        text = f"; the closest, {names}, leaves {_newtons(closest.gap_after_N)}"
        if diagnosis.ceiling_after_N < closest.gap_after_N:
            text += f", a learner without physics {_newtons(diagnosis.ceiling_after_N)}"
    return text if diagnosis.gap.noise_known else f"{text}; noise not known: {diagnosis.gap.noise_source}"


def describe_timing(diagnosis: Diagnosis) -> str:
    """Return a sentence on what the simulation does to its inputs, empty if that was not corrected."""
    gap, probe = diagnosis.gap, diagnosis.probe
    if not probe.corrected:
        return ""
    found = " and ".join(f"{one.about.lower()} {one.found}" for one in probe.findings if one.is_corrected)
    timing = f" The simulation's timing of its inputs ({found}) is"
    if diagnosis.correction is not None or not describe_correction(diagnosis):
        return f"{timing} corrected first."
    cause = "the cause" if diagnosis.verdict == NO_GAP else "a cause, too"
    return f"{timing} {cause}: corrected, {_newtons(gap.corrected_N)} of {_newtons(gap.rms_N)} RMS are left."


def describe_rare(diagnosis: Diagnosis) -> str:
    """Return a sentence on the largest local deviation, with its place; empty if none stands out."""
    rare = diagnosis.rare
    if rare is None:
        return ""
    size = f"{minus(f'{rare.mean_N:+.3g}')} N over {format_number(1e3 * rare.window_s)} ms"
    inputs = f"stroke {format_number(1e3 * rare.stroke_m)} mm, speed {format_number(rare.speed_m_s)} m/s"
    where = f"{rare.time_s:.2f} s of {rare.recording} ({inputs}, current {format_number(rare.current_A)} A)"
    return (
        f" A short deviation stands out, which an RMS hides: {size} at {where}; expected at most {rare.limit_N:.3g} N."
    )


def _describe_no_gap(diagnosis: Diagnosis) -> str:
    gap, reason = diagnosis.gap, diagnosis.no_gap_reason
    left_N = min(gap.corrected_N, gap.rms_N)
    noise = f"the measurement noise of {gap.noise_floor_N:.1f} N RMS (from {gap.noise_source})"
    if reason == WITHIN_TOLERANCE:
        limit = f"the tolerance of {diagnosis.tolerance_N:.1f} N"
        if diagnosis.probe.corrected and gap.rms_N > diagnosis.tolerance_N:
            return f"No gap beyond the timing of the simulation's inputs: {left_N:.1f} N RMS remain, within {limit}."
        return f"No gap above {limit}: {left_N:.1f} N RMS between simulation and measurement."
    known = [float(f"{s.trace.own_error_N:.3g}") for s in diagnosis.held_out]
    if reason == WITHIN_BASELINE and any(known):
        own = f"the model's own error of {format_range(min(known), max(known))} N"
        hidden = f"effects below about {diagnosis.visible_from_N:.0f} N RMS cannot be seen"
        return f"No gap: {left_N:.0f} N RMS between simulation and measurement, within {own}; {hidden} behind it."
    if reason == WITHIN_BASELINE:
        left, whole = f"{left_N:.0f} N", f"{gap.rms_N:.0f} N RMS"
        explained = f"the references explain all but {left} of the {whole}"
        explained = f"{whole} are left, as on references" if f"{left} RMS" == whole else explained
        hidden = f"effects below about {diagnosis.visible_from_N:.0f} N RMS cannot be seen"
        return f"No gap beyond the simulation's own error: {explained}; {hidden} behind this simulation's error."
    if reason == WITHIN_NOISE:
        return f"No gap: {left_N:.1f} N RMS remain, within {noise}."
    timed = f"corrected, {diagnosis.timed_N:.1f} of {left_N:.1f} N RMS remain, within {noise}"
    return f"No gap beyond the simulation's timing of at most a sample: {timed}."


def _causes(diagnosis: Diagnosis, explanation: Explanation) -> list[str]:
    """Return the effects of an explanation, the one that closes most alone first."""
    alone = {c.effects[0]: c.gap_after_N for c in diagnosis.causes}
    return sorted(explanation.effects, key=lambda e: alone.get(e, np.inf))


def _describe_ambiguity(diagnosis: Diagnosis) -> str:
    """Return what keeps a cause from being named."""
    effects, others = _causes(diagnosis, diagnosis.composition), diagnosis.alternatives
    if diagnosis.doubt == ALTERNATIVES:
        after = {c.effects[0]: c.gap_after_N for c in diagnosis.causes}
        group = next((g for g in diagnosis.indistinguishable if set(g) & set(effects) and set(g) & set(others)), ())
        alike = sorted({*group} & {*effects, *others}, key=lambda e: (after.get(e, np.inf), e))
        if alike:
            return f"these recordings cannot distinguish between {_join(alike, 'and')}"
        return f"these recordings do not rule out {_join(others, 'or')}"
    if diagnosis.doubt == SIMULATION_ERROR:
        imitated = [e for e in effects if e in diagnosis.not_separable]
        return f"{_join(imitated or effects, 'and')} may be an error of the simulation itself"
    if diagnosis.doubt == REMAINS:
        rest = f", as a learner without physics leaves {_newtons(diagnosis.ceiling_after_N)}"
        return f"something else remains beside {_join(effects, 'and')}{'' if diagnosis.rare else rest}"
    return {
        NOT_CONFIRMED: "the held-out recordings do not confirm the best explanation",
        UNDETERMINED: "the interval of an effect's size includes no effect",
        LEAVES_MORE: "the best explanation leaves more of the gap's energy than it closes",
    }.get(diagnosis.doubt, "the best explanation is not certain enough to be named")


def _newtons(value: float) -> str:
    return f"{format_number(value)} N"


def _join(effects: Sequence[str], last: str) -> str:
    """Return `a, b and c`."""
    own = {CALIBRATION: "the simulation's force map", TIMING: "the simulation's timing"}
    own[PARAMETERS] = "the simulation's parameters"
    return join_with([own.get(e, e.replace("_", " ")) for e in effects], last)
