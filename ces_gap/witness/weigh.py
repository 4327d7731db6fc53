"""What the witness means for the verdict: agreement is said, disagreement makes it ambiguous."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_gap.inference.verdict import AMBIGUOUS, NAMED
from ces_gap.witness.witness import GroupRefit, Witness

MIN_MOVED = 3.0  # standard errors
MIN_ENERGY = 0.1  # of the held-out gap, for a refit that counts
CLEAR_Z = 2.0  # standard errors by which a refit closes more than another
CLEAR_ENERGY = 0.1  # of the gap, too


def weigh_witness(verdict: str, composition: Sequence[str], witness: Witness | None) -> tuple[str, str]:
    """Return the verdict after hearing the witness, and what it says of the effects in the composition.

    A refit agrees if its group belongs to one of the effects, moved, and closes part of the held-out gap. Another group
    that moved and closes clearly more disagrees. A baseline without a group for any of the effects says nothing, nor
    does a witness without a control, as the model's own error moves its parameters, too. Where no effect is named, it
    says which group moved.
    """
    heard = [] if witness is None else [refit for refit in witness.refits if refit.control_z is not None]
    if verdict not in (NAMED, AMBIGUOUS):
        first = next((refit for refit in heard if has_moved(refit)), None)
        return verdict, "" if first is None else f"the model's {first.group} moved: {describe_refit(first)}"
    own = [refit for refit in heard if set(refit.effects) & set(composition)]
    best = max(own, key=lambda refit: refit.energy, default=None)
    rivals = [refit for refit in heard if refit not in own and has_moved(refit) and closes_more(refit, best)]
    if rivals and witness is not None and _has_own_group(composition, witness):
        return AMBIGUOUS, _describe_rival(max(rivals, key=lambda refit: refit.energy), best)
    return verdict, "" if best is None or not has_moved(best) else _describe_agreement(best)


def has_moved(refit: GroupRefit) -> bool:
    """True if the group moved, more than on the references, and closes part of the held-out gap by it."""
    clear = refit.energy > CLEAR_Z * refit.energy_error and refit.energy >= MIN_ENERGY
    return clear and refit.moved_z >= max(MIN_MOVED, abs(refit.control_z or 0.0))


def closes_more(refit: GroupRefit, other: GroupRefit | None) -> bool:
    """True if a refit closes more of the held-out gap than another one, beyond the error of the difference."""
    if other is None:
        return True
    difference = np.array(refit.block_energy) - np.array(other.block_energy)
    error = float(np.sqrt(len(difference)) * difference.std())
    return float(difference.sum()) > max(CLEAR_ENERGY, CLEAR_Z * error)


def _has_own_group(composition: Sequence[str], witness: Witness) -> bool:
    return any(set(effects) & set(composition) for effects in witness.heard)


def _describe_agreement(refit: GroupRefit) -> str:
    return f"the refit of the model's {refit.group} agrees: {describe_refit(refit)}"


def _describe_rival(rival: GroupRefit, own: GroupRefit | None) -> str:
    text = f"a refit of the model's {rival.group} explains more: {describe_refit(rival)}"
    return text if own is None else f"{text}, that of its {own.group} {own.closes:.0%}"


def describe_refit(refit: GroupRefit) -> str:
    """Return how a group moved, by how many standard errors, and what it closes."""
    changes = [f"{_short(c.name)} {c.before:.3g} to {c.after:.3g}{_unit(c.name)}" for c in refit.changes]
    control = "" if refit.control_z is None else f" ({refit.control_z:.0f} on the references)"
    moved = f"{refit.moved_z:.0f} standard errors{control}"
    return ", ".join([*changes, moved, f"closes {refit.closes:.0%} of the held-out gap"])


def _short(name: str) -> str:
    text = name.partition(" [")[0]
    return text[0].lower() + text[1:]


def _unit(name: str) -> str:
    unit = name.partition(" [")[2].rstrip("]")
    return f" {unit}" if unit else ""
