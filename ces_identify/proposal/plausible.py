"""Units by plausibility: the range of a candidate goes in; the units in which a damper's signal has it come out."""

from __future__ import annotations

from dataclasses import dataclass

from ces_identify.proposal.candidate import Candidate
from ces_identify.recordings.units import QUANTITIES, Unit, find_unit

MIN_STROKE_M, MAX_STROKE_M = 0.001, 0.5
MIN_FORCE_N, MAX_FORCE_N = 20.0, 60_000.0
MIN_TOP_CURRENT_A, MAX_CURRENT_A = 0.05, 6.0
RANGES = {  # of the span (position) or the peak, in SI units, in which a damper on a rig or vehicle works
    "position": (MIN_STROKE_M, MAX_STROKE_M),
    "force": (MIN_FORCE_N, MAX_FORCE_N),
    "current": (MIN_TOP_CURRENT_A, MAX_CURRENT_A),
    "speed": (0.002, 10.0),
    "acceleration": (0.05, 3000.0),
    "temperature": (-60.0, 250.0),
}
USUAL = {  # units to try where none is stated, the likeliest first
    "position": ("m", "mm", "cm", "in"),
    "force": ("N", "kN", "lbf", "kip"),
    "current": ("A", "mA"),
    "speed": ("m/s", "mm/s"),
    "acceleration": ("m/s2", "g"),
    "temperature": ("degC", "K"),
}


@dataclass(frozen=True)
class UnitGuess:
    """The unit of a candidate as a signal: None if no usual unit makes its range plausible.

    `others` are further units that the range allows; `stated` is true if the log or a name states the unit.
    """

    unit: Unit | None
    stated: bool
    others: tuple[str, ...]
    text: str


def guess_unit(candidate: Candidate, signal: str) -> UnitGuess:
    """Return the unit of a candidate if it is this signal: the stated one, or the likeliest by its range."""
    if candidate.unit is not None:
        return UnitGuess(candidate.unit, True, (), f"unit {candidate.unit.text} {candidate.stated}".strip())
    number = candidate.span if signal == "position" else candidate.peak
    what = "span" if signal == "position" else "peak"
    allowed = [name for name in USUAL[signal] if _allows(name, signal, candidate)]
    if candidate.constant and candidate.high == 0.0:
        return UnitGuess(find_unit(USUAL[signal][0]), False, (), f"always 0, so any unit; taken as {USUAL[signal][0]}")
    if not allowed:
        low, high = RANGES[signal]
        text = f"its unit is not known: a {what} of {number:.4g} is implausible in {', '.join(USUAL[signal])}"
        return UnitGuess(None, False, (), f"{text} (expected {low:g} to {high:g} in SI units)")
    chosen, others = allowed[0], tuple(allowed[1:])
    text = f"taken as {chosen}, because its {what} of {number:.4g} is plausible in {chosen}"
    excluded = USUAL[signal][: USUAL[signal].index(chosen)]
    text += f" and not in {', '.join(excluded)}" if excluded else ""
    return UnitGuess(
        find_unit(chosen),
        False,
        others,
        text + (f" (or in {' or '.join(others)}, which would be plausible, too)" if others else ""),
    )


def fits_quantity(candidate: Candidate, signal: str) -> bool:
    """Return False if the stated unit is one of another quantity than the signal."""
    return candidate.unit is None or candidate.unit.quantity in QUANTITIES[signal]


def is_plausible(candidate: Candidate, signal: str) -> bool:
    """Return whether the candidate's range makes sense for this signal in its stated or any usual unit."""
    if candidate.unit is not None:
        return fits_quantity(candidate, signal)
    return any(_allows(name, signal, candidate) for name in USUAL[signal])


def _allows(name: str, signal: str, candidate: Candidate) -> bool:
    unit = find_unit(name)
    low, high = RANGES[signal]
    number = candidate.span if signal == "position" else candidate.peak
    return unit is not None and low <= unit.scale * number + unit.offset <= high
