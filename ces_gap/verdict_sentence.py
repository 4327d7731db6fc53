"""The verdict in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

from ces_gap.diagnosis import AMBIGUOUS, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.inference.verdict import POSSIBLE


def format_verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    gap = diagnosis.gap
    if diagnosis.verdict == NO_GAP:
        if gap.rms_N > 1.5 * gap.corrected_N and gap.corrected_N < gap.rms_N:
            return (
                f"No gap beyond the baseline error: the references explain all but {gap.corrected_N:.0f} N of the "
                f"{gap.rms_N:.0f} N RMS."
            )
        return f"No gap: the remaining {gap.corrected_N:.0f} N RMS cannot be distinguished from noise and calibration."
    after_N = diagnosis.composition.gap_after_N
    effects = _join(diagnosis.composition.effects, "and")
    if diagnosis.verdict == UNKNOWN:
        closest = f"; the closest, {effects}, leaves {after_N:.0f} N" if effects else ""
        return f"None of the known effects explains the gap of {gap.rms_N:.0f} N RMS{closest}."
    shrink = _describe_shrink(gap.rms_N, after_N)
    if diagnosis.verdict == AMBIGUOUS:
        return f"{_describe_doubt(diagnosis)}; with {effects}, {shrink}."
    return f"The gap is caused by {effects}: with this effect added, {shrink} on held-out recordings."


def _describe_doubt(diagnosis: Diagnosis) -> str:
    """Return what these recordings leave open: effects indistinguishable from a cause, or further possible causes."""
    effects = diagnosis.composition.effects
    group = next((g for g in diagnosis.indistinguishable if set(g) & set(effects)), ())
    if group:
        return f"These recordings cannot distinguish between {_join(group, 'and')}"
    others = [c.effects[0] for c in diagnosis.causes if c.probability >= POSSIBLE and c.effects[0] not in effects]
    if not others and diagnosis.witness_says:
        return diagnosis.witness_says[0].upper() + diagnosis.witness_says[1:]
    return f"These recordings do not rule out {_join(others, 'or')}"


def _join(effects: Sequence[str], last: str) -> str:
    """Return `a, b and c`."""
    names = [e.replace("_", " ") for e in effects]
    return f" {last} ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


def _describe_shrink(before_N: float, after_N: float) -> str:
    if after_N < before_N:
        return f"the gap shrinks from {before_N:.0f} N to {after_N:.0f} N RMS"
    return f"the gap does not shrink ({before_N:.0f} N RMS before, {after_N:.0f} N after)"
