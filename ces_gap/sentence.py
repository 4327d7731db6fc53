"""The verdict in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

from ces_gap.diagnosis import AMBIGUOUS, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.inference.verdict import POSSIBLE


def format_verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict of the diagnosis in one sentence."""
    gap = diagnosis.gap
    if diagnosis.verdict == NO_GAP:
        if gap.rms_N > 1.5 * gap.corrected_N and gap.corrected_N < gap.rms_N:
            return (
                f"No gap beyond the simulation's baseline error: of {gap.rms_N:.0f} N RMS the references explain "
                f"all but {gap.corrected_N:.0f} N."
            )
        return f"No gap: the remaining {gap.corrected_N:.0f} N RMS cannot be distinguished from noise and calibration."
    closure = _describe_closure(gap.rms_N, diagnosis.composition.gap_after_N)
    words = _join(diagnosis.composition.effects, "and")
    if diagnosis.verdict == UNKNOWN:
        nearest = f"; the closest, {words}, leaves {diagnosis.composition.gap_after_N:.0f} N" if words else ""
        return f"None of the known effects explains the gap of {gap.rms_N:.0f} N RMS{nearest}."
    if diagnosis.verdict == AMBIGUOUS:
        return f"{_describe_doubt(diagnosis)}; with {words}, {closure}."
    return f"The gap is caused by {words}: once added, {closure} on recordings that no fit has used."


def _describe_doubt(diagnosis: Diagnosis) -> str:
    """Return the open question: effects indistinguishable from a cause, or other possible causes."""
    inside = diagnosis.composition.effects
    group = next((g for g in diagnosis.indistinguishable if set(g) & set(inside)), ())
    if group:
        return f"These recordings cannot distinguish between {_join(group, 'and')}"
    others = [c.effects[0] for c in diagnosis.causes if c.probability >= POSSIBLE and c.effects[0] not in inside]
    return f"These recordings do not rule out {_join(others, 'or')}"


def _join(names: Sequence[str], last: str) -> str:
    return f" {last} ".join(n.replace("_", " ") for n in names)


def _describe_closure(before_N: float, after_N: float) -> str:
    if after_N < before_N:
        return f"the gap shrinks from {before_N:.0f} N to {after_N:.0f} N RMS"
    return f"the gap does not shrink ({before_N:.0f} N before, {after_N:.0f} N RMS after)"
