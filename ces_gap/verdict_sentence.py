"""The verdict in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_gap.calibration_map import calibration_cells, largest_cell
from ces_gap.diagnosis import AMBIGUOUS, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.inference.gap_size import WITHIN_BASELINE, WITHIN_NOISE, WITHIN_TOLERANCE
from ces_gap.inference.review import CLEARLY_LESS
from ces_gap.inference.verdict import CALIBRATION, POSSIBLE, TIMING


def format_verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    if diagnosis.verdict == NO_GAP:
        return _describe_no_gap(diagnosis)
    gap, after_N, effects = diagnosis.gap, diagnosis.composition.gap_after_N, _causes(diagnosis)
    if diagnosis.verdict == UNKNOWN:
        return f"None of the known effects explains the gap of {gap.rms_N:.0f} N RMS{_describe_closest(diagnosis)}."
    shrink = _describe_shrink(gap.rms_N, after_N)
    if diagnosis.verdict == AMBIGUOUS:
        return f"{_describe_doubt(diagnosis)}; with {_join(effects, 'and')}, {shrink}."
    if tuple(effects) == (CALIBRATION,):
        size = _describe_map(diagnosis)
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
        hidden = (
            f"effects below about {diagnosis.visible_from_N:.0f} N RMS cannot be seen behind this simulation's error"
        )
        return f"No gap beyond the simulation's own error: {explained}; {hidden}."
    if reason == WITHIN_NOISE:
        noise = f"the measurement noise of {gap.noise_floor_N:.1f} N RMS (from {gap.noise_source})"
        return f"No gap: {left_N:.1f} N RMS remain, within {noise}."
    return f"No gap beyond the simulation's timing of at most a sample: {left_N:.1f} N RMS before it is corrected."


def _causes(diagnosis: Diagnosis) -> list[str]:
    """Return the effects of the composition, the one that closes most alone first, without the simulation's timing."""
    alone = {c.effects[0]: c.gap_after_N for c in diagnosis.causes}
    effects = [e for e in diagnosis.composition.effects if e != TIMING]
    return sorted(effects, key=lambda e: alone.get(e, np.inf))


def _describe_closest(diagnosis: Diagnosis) -> str:
    """Return what leaves the least of the gap: the composition, or an effect alone that is less probable."""
    effects, left = _causes(diagnosis), diagnosis.composition.gap_after_N
    if not effects:
        return ""
    alone = min(diagnosis.causes, key=lambda c: c.gap_after_N if np.isfinite(c.gap_after_N) else np.inf)
    if alone.gap_after_N < left:
        effects, left = [alone.effects[0]], alone.gap_after_N
    return f"; the closest, {_join(effects, 'and')}, leaves {left:.0f} N"


def _describe_doubt(diagnosis: Diagnosis) -> str:
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
        return f"{_capitalize(_join(imitated, 'and'))} may be an error of the simulation itself"
    if diagnosis.witness_says:
        return _capitalize(diagnosis.witness_says)
    if diagnosis.composition.shrink_ci95[0] <= 0.0:
        return "The held-out recordings do not confirm the best explanation"
    return "The best explanation is not certain enough to be named"


def _capitalize(text: str) -> str:
    return text[:1].upper() + text[1:]


def _describe_map(diagnosis: Diagnosis) -> str:
    """Return where the map of a calibration is largest, and how large it is there."""
    cell = largest_cell(calibration_cells(diagnosis))
    low, high = cell.speed_m_s
    current = f"{np.mean(cell.current_A):.2g} A"
    return f"most at {low:.2g} to {high:.2g} m/s and about {current} ({cell.force_N:+.0f} N)"


def _join(effects: Sequence[str], last: str) -> str:
    """Return `a, b and c`."""
    names = ["the simulation's force map" if e == CALIBRATION else e.replace("_", " ") for e in effects]
    return f" {last} ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


def _describe_shrink(before_N: float, after_N: float) -> str:
    if after_N < before_N:
        return f"the gap shrinks from {before_N:.0f} N to {after_N:.0f} N RMS"
    return f"the gap does not shrink ({before_N:.0f} N RMS before, {after_N:.0f} N after)"
