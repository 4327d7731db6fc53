"""The run of one model: ticks in; a force held in its range, its band, and whether it has warmed up, out.

A force that is not finite restarts the run. The force at a sample lies on the line through the last two ticks.
"""

from math import cos, exp, floor, inf, isfinite, log, nan, pow, sin, sqrt, tanh

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.band import band_half_width, band_tick, check_band
from ces_observer.tick.mixture import check_structure, structure_reset, structure_tick
from ces_observer.tick.model import (
    BAND_STARTED, FORCE_HIGH, FORCE_LOW, HAS_BAND, K_STRUCTURE, N_STRUCTURE, NEWEST_FORCE, P_STRUCTURE, PREVIOUS_FORCE,
    RATE, S_STRUCTURE, WAIT, WARM_UP, clamp,
)  # fmt: skip


def run_restart(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Forget the past, and warm up."""
    structure_reset(p, n, s, k)
    k[BAND_STARTED] = 0
    k[WAIT] = n[WARM_UP]
    s[PREVIOUS_FORCE] = 0.0
    s[NEWEST_FORCE] = 0.0


def run_advance(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> bool:
    """Run a tick; return False if its force was not finite: then the run has restarted."""
    k[WAIT] -= 1
    force = structure_tick(p, n, s, k, position, speed, current)
    if force == inf:
        run_restart(p, n, s, k)
        return False
    s[PREVIOUS_FORCE] = s[NEWEST_FORCE]
    s[NEWEST_FORCE] = force
    if n[HAS_BAND] != 0:
        band_tick(p, s, k, position, speed, current, force)
    return True


def run_force(p: Floats, s: Floats, ahead: float) -> float:
    """Return the force [N] `ahead` ticks after the last one, within the range of forces."""
    newest = s[NEWEST_FORCE]
    return clamp(newest + (newest - s[PREVIOUS_FORCE]) * ahead, p[FORCE_LOW], p[FORCE_HIGH])


def run_half_width(p: Floats, n: Ints, s: Floats) -> float:
    """Return the half-width [N] of the band at the last tick; no number without a band, or if it is not finite."""
    width = band_half_width(p, s) if n[HAS_BAND] != 0 else nan
    return width if isfinite(width) else nan


def check_run(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether a run stays within arrays p, n, s and k of these sizes."""
    if numbers < P_STRUCTURE or counts < N_STRUCTURE or states < S_STRUCTURE or flags < K_STRUCTURE:
        return False
    if not (p[RATE] > 0.0 and p[FORCE_LOW] <= p[FORCE_HIGH] and n[WARM_UP] >= 0):
        return False
    if n[HAS_BAND] != 0 and not check_band(p):
        return False
    return check_structure(p, n, numbers, counts, states, flags)


def rounding_sample(seed: int) -> float:
    """Return a number that pseudo-random products, sums and functions make from a seed from 0 to 2^31 - 1.

    The compiled core must give it bit for bit, before it is used: a compiler may fuse a product and a sum into one
    rounding, and libraries differ in the last digits of `exp` and its like.
    """
    state = seed
    total = 0.0
    for i in range(32):
        state = (state * 1103515245 + 12345) % 2147483648
        x = float(state) / 2147483648.0
        state = (state * 1103515245 + 12345) % 2147483648
        y = float(state) / 2147483648.0 + 0.5
        total = total * x - (x * y - sqrt(y)) * float(i)
        total = total + exp(x) * tanh(total) / y
        total = total + log(y) * sin(total) - cos(y * total)
        total = total + pow(y, x) * (total * y + x * x) / (1.0 + abs(total))
        total = total - float(floor(total))
    return total if isfinite(total) else 0.0
