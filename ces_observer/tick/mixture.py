"""The mean of several models of one damper, and the free run of any structure: a mixture or a single one.

    force = hold(sum over members of weight * force of the member),   weights above 0, with a sum of 1

Each member runs on parts of the mixture's arrays, as if these were its own: with its own range of forces, and without
warm-up and band. So what is proved for each of them holds for their convex combination.
"""

from ces_observer.tick.arrays import Floats, Ints, part
from ces_observer.tick.model import (
    CLAMPED, FORCE_HIGH, FORCE_LOW, HELD, KIND, K_STRUCTURE, N_STRUCTURE, P_STRUCTURE, SMALLEST, S_STRUCTURE,
    are_between, hold_force, lies_within,
)  # fmt: skip
from ces_observer.tick.structure import MIXTURE, check_member, member_reset, member_tick

# n: members; where these begin: in n the places at which the p, n, s and k of each member begin, in p their weights
MIXTURE_MEMBERS, MIXTURE_PLACES, MIXTURE_WEIGHTS, N_MIXTURE = range(N_STRUCTURE, N_STRUCTURE + 4)
OWN_P, OWN_N, OWN_S, OWN_K = range(4)

MAX_MEMBERS = 12


def mixture_reset(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Forget the past."""
    k[CLAMPED] = 0
    k[HELD] = 0
    own = n[MIXTURE_PLACES]
    for i in range(own, own + 4 * n[MIXTURE_MEMBERS], 4):
        member_reset(part(p, n[i + OWN_P]), part(n, n[i + OWN_N]), part(s, n[i + OWN_S]), part(k, n[i + OWN_K]))


def mixture_tick(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> float:
    """Return the force [N] at this tick's inputs [m, m/s, A], held in its range; infinite if it is not finite.

    CLAMPED is set if any member clamps an input, HELD if the mean is held.
    """
    k[CLAMPED] = 0
    total = 0.0
    own = n[MIXTURE_PLACES]
    weight = n[MIXTURE_WEIGHTS]
    for i in range(own, own + 4 * n[MIXTURE_MEMBERS], 4):
        force = member_tick(
            part(p, n[i + OWN_P]), part(n, n[i + OWN_N]), part(s, n[i + OWN_S]), part(k, n[i + OWN_K]),
            position, speed, current,
        )  # fmt: skip
        total += p[weight] * force
        weight += 1
        if k[n[i + OWN_K] + CLAMPED] != 0:
            k[CLAMPED] = 1
    return hold_force(p, k, total)


def check_own(p: Floats, n: Ints, own: int, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether the member whose places begin at n[own] stays within its arrays, which end at these places."""
    at_p = n[own + OWN_P]
    at_n = n[own + OWN_N]
    at_s = n[own + OWN_S]
    at_k = n[own + OWN_K]
    fits = P_STRUCTURE <= at_p <= numbers - P_STRUCTURE and N_STRUCTURE <= at_n <= counts - N_STRUCTURE
    fits = fits and S_STRUCTURE <= at_s <= states - S_STRUCTURE and K_STRUCTURE <= at_k <= flags - K_STRUCTURE
    if not (fits and p[at_p + FORCE_LOW] <= p[at_p + FORCE_HIGH]):
        return False
    return check_member(part(p, at_p), part(n, at_n), numbers - at_p, counts - at_n, states - at_s, flags - at_k)


def check_mixture(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether each member stays within its own part of arrays p, n, s and k of these sizes."""
    members = n[MIXTURE_MEMBERS] if counts >= N_MIXTURE else 0
    if not 2 <= members <= MAX_MEMBERS:
        return False
    first = n[MIXTURE_PLACES]
    weights = n[MIXTURE_WEIGHTS]
    fits = lies_within(first, 4 * members, N_MIXTURE, counts)
    fits = fits and lies_within(weights, members, P_STRUCTURE, numbers)
    if not (fits and are_between(p, weights, members, 1, SMALLEST, 1.0)):
        return False
    for i in range(first + 4 * (members - 1), first - 1, -4):
        if not check_own(p, n, i, numbers, counts, states, flags):
            return False
        numbers = n[i + OWN_P]  # where the member before it ends
        counts = n[i + OWN_N]
        states = n[i + OWN_S]
        flags = n[i + OWN_K]
    return True


def structure_reset(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Forget the past: earlier inputs equal the first ones to come."""
    if n[KIND] == MIXTURE:
        mixture_reset(p, n, s, k)
    else:
        member_reset(p, n, s, k)


def structure_tick(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> float:
    """Return the force [N] at this tick's inputs [m, m/s, A], held in its range; infinite if it is not finite."""
    force = 0.0
    if n[KIND] == MIXTURE:
        force = mixture_tick(p, n, s, k, position, speed, current)
    else:
        force = member_tick(p, n, s, k, position, speed, current)
    return force


def check_structure(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether the tick stays within arrays p, n, s and k of these sizes."""
    if n[KIND] == MIXTURE:
        return check_mixture(p, n, numbers, counts, states, flags)
    return check_member(p, n, numbers, counts, states, flags)
