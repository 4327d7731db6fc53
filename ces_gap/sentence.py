"""The verdict in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

from ces_gap.diagnosis import AMBIGUOUS, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.inference.verdict import POSSIBLE


def format_verdict(diagnosis: Diagnosis) -> str:
    """Return what a person should take away."""
    gap = diagnosis.gap
    if diagnosis.verdict == NO_GAP:
        if gap.rms_N > 1.5 * gap.corrected_N and gap.corrected_N < gap.rms_N:
            return (
                f"No gap beyond the simulation's own error: of {gap.rms_N:.0f} N RMS the references explain "
                f"all but {gap.corrected_N:.0f} N."
            )
        return f"No gap: what is left, {gap.corrected_N:.0f} N RMS, is not told from noise and calibration."
    shrunk = _shrunk(gap.rms_N, diagnosis.composition.gap_after_N)
    words = " and ".join(n.replace("_", " ") for n in diagnosis.composition.effects)
    if diagnosis.verdict == UNKNOWN:
        nearest = f"; the nearest, {words}, leaves {diagnosis.composition.gap_after_N:.0f} N" if words else ""
        return f"None of the known effects explains the gap of {gap.rms_N:.0f} N RMS{nearest}."
    if diagnosis.verdict == AMBIGUOUS:
        return f"{_doubt(diagnosis)}; with {words}, {shrunk}."
    return f"The gap is caused by {words}: once added, {shrunk} on recordings the fit never saw."


def _doubt(found: Diagnosis) -> str:
    """Return what these recordings leave open: twins of a cause that was found, or causes beside it."""
    inside = found.composition.effects
    group = next((g for g in found.indistinguishable if set(g) & set(inside)), ())
    if group:
        return f"These recordings cannot tell {_either(group)} apart"
    beside = [c.effects[0] for c in found.causes if c.probability >= POSSIBLE and c.effects[0] not in inside]
    return f"These recordings do not rule out {_either(beside)}"


def _either(names: Sequence[str]) -> str:
    return " or ".join(n.replace("_", " ") for n in names)


def _shrunk(before_N: float, after_N: float) -> str:
    if after_N < before_N:
        return f"the gap shrinks from {before_N:.0f} N to {after_N:.0f} N RMS"
    return f"the gap does not shrink ({before_N:.0f} N before, {after_N:.0f} N RMS after)"
