"""Signs: position and force are positive in compression, so that the force of a damper goes with the speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ces_identify.proposal.choice import Choice
from ces_identify.proposal.motion import MotionTable
from ces_identify.proposal.words import OUTWARD, find_word

MIN_CORRELATION = 0.3
ASYMMETRY = 1.3  # ratio of the larger to the smaller peak of a force; rebound is damped more than compression
FLIP = "sign turned: "
UNCHECKED = "the sign could not be checked"


def find_signs(found: dict[str, Choice], table: MotionTable) -> dict[str, Choice]:
    """Return the choices with negative scales where the sign is clearly the other one, each with its reason.

    A force that goes against the speed means that position or force is positive in rebound. The position's name
    decides, or else the larger peak of the force, which is that in rebound; without either, the force is turned.
    """
    position, force = found.get("position"), found.get("force")
    if position is None or force is None:
        return found
    correlation, _ = table.correlate(position.candidate, force.candidate)
    outward = find_word(position.candidate.names, OUTWARD)
    if not abs(correlation) >= MIN_CORRELATION:
        text = f"{UNCHECKED}: force and speed hardly correlate ({correlation:+.2f})"
        return {**found, "force": replace(force, checks=(*force.checks, text))}
    if outward:
        found = {**found, "position": _turn(position, f"named '{outward}', so positive in rebound")}
    against = (correlation < 0.0) != bool(outward)
    if not against:
        text = f"sign as logged: force goes with the speed ({abs(correlation):+.2f})"
        return {**found, "force": replace(force, reasons=(*force.reasons, text))}
    reason = f"force goes against the speed ({correlation:+.2f}), so one of the two is positive in rebound"
    if not outward and _rebound_is_negative(force):
        more = "the force's larger peak, that in rebound, is negative as it should be"
        return {**found, "position": _turn(position, f"{reason}; {more}")}
    more = "turn the position instead if the force is positive in compression"
    return {**found, "force": _turn(force, reason if outward else f"{reason}; {more}")}


def _turn(choice: Choice, reason: str) -> Choice:
    return replace(choice, scale=-choice.scale, offset=-choice.offset, reasons=(*choice.reasons, f"{FLIP}{reason}"))


def _rebound_is_negative(force: Choice) -> bool:
    """Return whether the negative peak of the force is clearly larger than the positive one."""
    low, high = np.percentile(force.candidate.finite, (1.0, 99.0))
    return bool(low < 0.0 < high and -low > ASYMMETRY * high)
