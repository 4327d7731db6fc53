"""What every model has: the ranges of its inputs and of its force, and what becomes of a force outside.

p and n hold the model, s and k its state. Each module declares the places it uses; those of a structure begin at
P_STRUCTURE, N_STRUCTURE, S_STRUCTURE and K_STRUCTURE, and tables of any length follow behind, where the model's own n
says (`ces_observer.flat`).
"""

from math import inf, isfinite

from ces_observer.tick.arrays import Floats, Ints

# p: ranges [m, m/s, A, N], the currents between which none was recorded [A], the rate [Hz], and the numbers of the band
(
    POSITION_LOW, POSITION_HIGH, SPEED_LOW, SPEED_HIGH, CURRENT_LOW, CURRENT_HIGH, FORCE_LOW, FORCE_HIGH,
    GAP_LOW, GAP_HIGH, RATE, P_BAND,
) = range(12)  # fmt: skip
P_STRUCTURE = 48

# n: which structure, ticks of warm-up, whether there is a band
KIND, WARM_UP, HAS_BAND, N_STRUCTURE = range(4)

# s: the last two forces [N], and the state of the band
PREVIOUS_FORCE, NEWEST_FORCE, S_BAND = range(3)
S_STRUCTURE = 16

# k: whether the last inputs and the last force lay outside their ranges, ticks of warm-up that are left, and whether
# the band and the structure have begun
CLAMPED, HELD, WAIT, BAND_STARTED, STARTED, K_STRUCTURE = range(6)


def hold_force(p: Floats, k: Ints, force: float) -> float:
    """Return a force [N] held at the ends of its range, and set HELD; infinite if it is not finite.

    The held force is also the past force of later ticks. Holding brings no two forces further apart, so that a
    contraction stays one, and comes back by itself.
    """
    low = p[FORCE_LOW]
    high = p[FORCE_HIGH]
    if low <= force <= high:
        k[HELD] = 0
        return force
    k[HELD] = 1
    if not isfinite(force):
        return inf
    return low if force < low else high


def is_clamped(p: Floats, position: float, speed: float, current: float) -> bool:
    """Return whether an input [m, m/s, A] lies outside its range, or in the gap of the currents, or is no number."""
    return not (
        p[POSITION_LOW] <= position <= p[POSITION_HIGH]
        and p[SPEED_LOW] <= speed <= p[SPEED_HIGH]
        and p[CURRENT_LOW] <= current <= p[CURRENT_HIGH]
        and not p[GAP_LOW] < current < p[GAP_HIGH]
    )


def clamp(value: float, low: float, high: float) -> float:
    """Return a value, or the nearest end of its range; a value that is no number stays one."""
    return low if value < low else high if value > high else value


SMALLEST = 2.2250738585072014e-308  # above 0
LARGEST = 1.7976931348623157e308


def lies_within(place: int, count: int, first: int, size: int) -> bool:
    """Return whether a table of `count` lies behind the named places, which end at `first`, in an array of `size`."""
    return first <= place <= size and 0 <= count <= size - place


def are_indices(n: Ints, at: int, count: int, step: int, low: int, end: int) -> bool:
    """Return whether `count` whole numbers, `step` places apart from n[at] on, are at least `low` and below `end`."""
    for i in range(count):
        if not low <= n[at + i * step] < end:
            return False
    return True


def are_between(p: Floats, at: int, count: int, step: int, low: float, high: float) -> bool:
    """Return whether `count` numbers, `step` places apart from p[at] on, are from `low` to `high`."""
    for i in range(count):
        if not low <= p[at + i * step] <= high:
            return False
    return True
