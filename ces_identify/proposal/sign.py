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
    decides, or else the larger peak of the force, which is that in rebound; without either, the force is turned, and
    that is to be checked.
    """
    position, force = found.get("position"), found.get("force")
    if position is None or force is None:
        return found
    correlation, _ = table.correlate(position.candidate, force.candidate)
    outward = find_word(position.candidate.names, OUTWARD)
    if np.isnan(correlation):
        text = f"{UNCHECKED}: too few samples to compare force and speed"
        return {**found, "force": replace(force, checks=(*force.checks, text))}
    if abs(correlation) < MIN_CORRELATION:
        text = f"{UNCHECKED}: force and speed hardly correlate ({correlation:+.2f})"
        return {**found, "force": replace(force, checks=(*force.checks, text))}
    if outward:
        found = {**found, "position": _turn(position, f"named '{outward}', so positive in rebound")}
    against = (correlation < 0.0) != bool(outward)
    if not against:
        text = f"sign as logged: force goes with the speed ({abs(correlation):+.2f})"
        return {**found, "force": replace(force, reasons=(*force.reasons, text))}
    reason = f"force goes against the speed ({correlation:+.2f}), so one of the two is positive in rebound"
    return {**found, **_turn_one(found["position"], force, reason, bool(outward))}


def _turn_one(position: Choice, force: Choice, reason: str, outward: bool) -> dict[str, Choice]:
    """Return the one that is positive in rebound, turned; the force, to be checked, if that cannot be known."""
    rebound = 1 if outward else _find_rebound(force)
    if rebound < 0:
        more = "the force's larger peak, that in rebound, is negative as it should be"
        return {"position": _turn(position, f"{reason}; {more}")}
    if rebound > 0:
        more = "" if outward else "; the force's larger peak, that in rebound, is positive"
        return {"force": _turn(force, f"{reason}{more}")}
    turned = _turn(force, reason)
    text = (
        "which of the two is positive in rebound cannot be known from the numbers; turn the position instead if it is"
    )
    return {"force": replace(turned, checks=(*turned.checks, text))}


def _turn(choice: Choice, reason: str) -> Choice:
    return replace(choice, scale=-choice.scale, offset=-choice.offset, reasons=(*choice.reasons, f"{FLIP}{reason}"))


def _find_rebound(force: Choice) -> int:
    """Return the sign of the force's clearly larger peak, 0 if neither is."""
    low, high = np.percentile(force.candidate.finite, (1.0, 99.0))
    if not low < 0.0 < high:
        return 0
    return -1 if -low > ASYMMETRY * high else int(high > -ASYMMETRY * low)
