"""The half-width of a model's band, tick by tick; `ces_observer.model` says what it means and how it is fitted.

    half-width = growth * sum of weights * (low, high current, slow, fast, |force|, |change of force|, reversal)
    growth^2 = share + (1 - share) * min(|whitening (state - mean)|, max_distance)^2

The state is position, speed, current, and the recent changes of speed and current (Mahalanobis distance). Between
currents where none was recorded, nothing has tested the band: there is none.
"""

from math import nan, sqrt

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.model import BAND_STARTED, GAP_HIGH, GAP_LOW, P_BAND, S_BAND

# p: gain and fade of a tick, the current's lowest value [A] and 1 / range [1/A], the speed [m/s], the weights, the mean
# and the rows of the whitening of the five parts of the state, the squared limit of the distance, the constant share
(
    BAND_GAIN, BAND_FADE, BAND_LOW_A, BAND_PER_A, BAND_SPEED, LOW_CURRENT_WEIGHT, HIGH_CURRENT_WEIGHT, SLOW_WEIGHT,
    FAST_WEIGHT, FORCE_WEIGHT, CHANGE_WEIGHT, REVERSAL_WEIGHT, BAND_MEAN,
) = range(P_BAND, P_BAND + 13)  # fmt: skip
BAND_WHITENING = BAND_MEAN + 5
BAND_LIMIT = BAND_WHITENING + 15
BAND_SHARE = BAND_LIMIT + 1

# s: inputs [m, m/s, A] and force [N] of the last tick, how recent the last reversal is, and low-passed signals
(
    BAND_AT_POSITION, BAND_AT_SPEED, BAND_AT_CURRENT, BAND_AT_FORCE, BAND_REVERSAL, BAND_MEAN_SPEED, BAND_MEAN_CURRENT,
    BAND_MEAN_FORCE, BAND_STATE_END,
) = range(S_BAND, S_BAND + 9)  # fmt: skip


def band_tick(p: Floats, s: Floats, k: Ints, position: float, speed: float, current: float, force: float) -> None:
    """Take a tick's inputs [m, m/s, A] and estimated force [N]."""
    if k[BAND_STARTED] != 0:
        gain = p[BAND_GAIN]
        s[BAND_MEAN_SPEED] += gain * (speed - s[BAND_MEAN_SPEED])
        s[BAND_MEAN_CURRENT] += gain * (current - s[BAND_MEAN_CURRENT])
        s[BAND_MEAN_FORCE] += gain * (force - s[BAND_MEAN_FORCE])
        if speed * s[BAND_AT_SPEED] <= 0.0:
            s[BAND_REVERSAL] = 1.0
        else:
            s[BAND_REVERSAL] *= p[BAND_FADE]
    else:
        k[BAND_STARTED] = 1
        s[BAND_REVERSAL] = 1.0
        s[BAND_MEAN_SPEED] = speed
        s[BAND_MEAN_CURRENT] = current
        s[BAND_MEAN_FORCE] = force
    s[BAND_AT_POSITION] = position
    s[BAND_AT_SPEED] = speed
    s[BAND_AT_CURRENT] = current
    s[BAND_AT_FORCE] = force


def band_half_width(p: Floats, s: Floats) -> float:
    """Return the half-width [N] at the last tick; not finite in the gap of the currents, and beyond any damper's."""
    if p[GAP_LOW] < s[BAND_AT_CURRENT] < p[GAP_HIGH]:
        return nan
    high = (s[BAND_AT_CURRENT] - p[BAND_LOW_A]) * p[BAND_PER_A]
    high = 0.0 if high < 0.0 else 1.0 if high > 1.0 else high
    u = abs(s[BAND_AT_SPEED]) / p[BAND_SPEED]
    force = s[BAND_AT_FORCE]
    width = (
        p[LOW_CURRENT_WEIGHT] * (1.0 - high)
        + p[HIGH_CURRENT_WEIGHT] * high
        + p[SLOW_WEIGHT] / (1.0 + u)
        + p[FAST_WEIGHT] * u
        + p[FORCE_WEIGHT] * abs(force)
        + p[CHANGE_WEIGHT] * abs(force - s[BAND_MEAN_FORCE])
        + p[REVERSAL_WEIGHT] * s[BAND_REVERSAL]
    )
    return width * _growth(p, s)


def _growth(p: Floats, s: Floats) -> float:
    """Return how much wider the band is here than near the mean of the recordings."""
    z0 = s[BAND_AT_POSITION] - p[BAND_MEAN]
    z1 = s[BAND_AT_SPEED] - p[BAND_MEAN + 1]
    z2 = s[BAND_AT_CURRENT] - p[BAND_MEAN + 2]
    z3 = s[BAND_AT_SPEED] - s[BAND_MEAN_SPEED] - p[BAND_MEAN + 3]
    z4 = s[BAND_AT_CURRENT] - s[BAND_MEAN_CURRENT] - p[BAND_MEAN + 4]
    w = BAND_WHITENING  # an upper triangle, row by row
    a = p[w] * z0 + p[w + 1] * z1 + p[w + 2] * z2 + p[w + 3] * z3 + p[w + 4] * z4
    b = p[w + 5] * z1 + p[w + 6] * z2 + p[w + 7] * z3 + p[w + 8] * z4
    c = p[w + 9] * z2 + p[w + 10] * z3 + p[w + 11] * z4
    d = p[w + 12] * z3 + p[w + 13] * z4
    e = p[w + 14] * z4
    square = a * a + b * b + c * c + d * d + e * e
    if p[BAND_LIMIT] < square:
        square = p[BAND_LIMIT]
    share = p[BAND_SHARE]
    return sqrt(share + (1.0 - share) * square)


def check_band(p: Floats) -> bool:
    """Return whether the half-width can be computed: no division by zero, no root of a negative number."""
    return p[BAND_SPEED] > 0.0 and 0.0 <= p[BAND_SHARE] <= 1.0 and p[BAND_LIMIT] >= 0.0
