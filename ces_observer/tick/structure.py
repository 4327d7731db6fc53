"""The free run of any structure but a mixture, whose members these are: its number chooses the tick.

A new structure is added here, with its tick in a file of its own.
"""

from math import inf

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.experts import check_experts, experts_tick
from ces_observer.tick.fuzzy import check_fuzzy, fuzzy_tick
from ces_observer.tick.hydraulic import check_hydraulic, hydraulic_reset, hydraulic_tick
from ces_observer.tick.lagged import lagged_reset
from ces_observer.tick.model import KIND
from ces_observer.tick.polynomial import check_polynomial, polynomial_reset, polynomial_tick
from ces_observer.tick.recurrent import check_recurrent, recurrent_reset, recurrent_tick
from ces_observer.tick.sigmoid import check_sigmoid, sigmoid_tick

POLYNOMIAL, SIGMOID, FUZZY, RECURRENT, HYDRAULIC, EXPERTS, MIXTURE = range(7)


def member_reset(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Forget the past: earlier inputs equal the first ones to come."""
    kind = n[KIND]
    if kind == POLYNOMIAL:
        polynomial_reset(p, n, s, k)
    elif kind == SIGMOID or kind == FUZZY or kind == EXPERTS:
        lagged_reset(p, n, s, k)
    elif kind == RECURRENT:
        recurrent_reset(p, n, s, k)
    elif kind == HYDRAULIC:
        hydraulic_reset(p, n, s, k)


def member_tick(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> float:
    """Return the force [N] at this tick's inputs [m, m/s, A], held in its range; infinite if it is not finite."""
    kind = n[KIND]
    force = inf
    if kind == POLYNOMIAL:
        force = polynomial_tick(p, n, s, k, position, speed, current)
    elif kind == SIGMOID:
        force = sigmoid_tick(p, n, s, k, position, speed, current)
    elif kind == FUZZY:
        force = fuzzy_tick(p, n, s, k, position, speed, current)
    elif kind == RECURRENT:
        force = recurrent_tick(p, n, s, k, position, speed, current)
    elif kind == HYDRAULIC:
        force = hydraulic_tick(p, n, s, k, position, speed, current)
    elif kind == EXPERTS:
        force = experts_tick(p, n, s, k, position, speed, current)
    return force


def check_member(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether the tick stays within arrays p, n, s and k of these sizes."""
    kind = n[KIND]
    fits = False
    if kind == POLYNOMIAL:
        fits = check_polynomial(p, n, numbers, counts, states, flags)
    elif kind == SIGMOID:
        fits = check_sigmoid(p, n, numbers, counts, states, flags)
    elif kind == FUZZY:
        fits = check_fuzzy(p, n, numbers, counts, states, flags)
    elif kind == RECURRENT:
        fits = check_recurrent(p, n, numbers, counts, states, flags)
    elif kind == HYDRAULIC:
        fits = check_hydraulic(p, n, numbers, counts, states, flags)
    elif kind == EXPERTS:
        fits = check_experts(p, n, numbers, counts, states, flags)
    return fits
