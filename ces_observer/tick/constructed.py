"""Constructed inputs: signals computed at each tick from position [m], speed [m/s] and current [A].

`stop` and `play` are the two halves of a signal with hysteresis (Brokate & Sprekels, Hysteresis and Phase Transitions,
1996, ch. 2; a weighted sum of stops is a Prandtl-Ishlinskii model). `lag` is a first-order lag. `frequency` estimates
the frequency of the motion. `hat` is a triangular membership. `ces_observer.structures.constructed_inputs` holds
their definitions and ranges.

A table in n has a row for each input: its kind, the place in s of its signal, and that of its numbers in p. Each input
follows those from which it is computed. In s stand position, speed and current, the inputs, and then their states.
"""

from math import pi, sqrt

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.model import lies_within

KIND_STOP, KIND_PLAY, KIND_LAG, KIND_FREQUENCY, KIND_HAT = range(5)
CONSTRUCTED_ROW = 3
CONSTRUCTED_NUMBERS = 4  # in p, of each input
CONSTRUCTED_STATES = 4
TWO_PI = 2.0 * pi
MAX_SIGNAL = 1e30  # [m, m/s, A, Hz] of a model that is loaded: no power of a signal overflows


def update_stop(s: Floats, state: int, started: bool, value: float, half: float) -> float:
    """h(k) = clip(h(k-1) + s(k) - s(k-1), -half, half), from 0: the stroke since the last reversal."""
    stop = 0.0
    if started:
        moved = s[state] + (value - s[state + 1])
        stop = half if moved > half else -half if moved < -half else moved
    s[state] = stop
    s[state + 1] = value
    return stop


def update_play(s: Floats, state: int, started: bool, value: float, half: float) -> float:
    """y(k) = clip(y(k-1), s(k) - half, s(k) + half), from the first s: the rest of the signal."""
    play = value
    if started:
        low = value - half
        high = value + half
        before = s[state]
        play = low if before < low else high if before > high else before
    s[state] = play
    return play


def update_lag(s: Floats, state: int, started: bool, value: float, gain: float) -> float:
    """y(k) = y(k-1) + gain (s(k) - y(k-1)), from the first s; gain = 1 - exp(-T / time constant), T the tick."""
    lagged = value
    if started:
        lagged = s[state] + gain * (value - s[state])
    s[state] = lagged
    return lagged


def update_frequency(p: Floats, s: Floats, numbers: int, state: int, started: bool, x: float, v: float) -> float:
    """Return f = sqrt(<v^2> / (<x^2> + floor^2)) / (2 pi) [Hz], clamped to its range.

    <> is an exponential window. x and v are taken relative to their means in such a window: both are filtered alike, so
    that their ratio stays the same.
    """
    gain = p[numbers]
    mean_x = x
    mean_v = v
    xx = 0.0
    vv = 0.0
    if started:
        mean_x = s[state] + gain * (x - s[state])
        mean_v = s[state + 1] + gain * (v - s[state + 1])
        xx = s[state + 2]
        vv = s[state + 3]
    xx += gain * ((x - mean_x) * (x - mean_x) - xx)
    vv += gain * ((v - mean_v) * (v - mean_v) - vv)
    s[state] = mean_x
    s[state + 1] = mean_v
    s[state + 2] = xx
    s[state + 3] = vv
    frequency = sqrt(vv / (xx + p[numbers + 1])) / TWO_PI
    low = p[numbers + 2]
    high = p[numbers + 3]
    return low if frequency < low else high if frequency > high else frequency


def membership(value: float, low: float, peak: float, high: float) -> float:
    """Return 1 at the peak, falling to 0 at `low` and at `high`; 1 on a side whose end is the peak."""
    end = low if value < peak else high
    if end == peak:
        return 1.0
    share = 1.0 - (value - peak) / (end - peak)
    return share if share > 0.0 else 0.0


def constructed_update(p: Floats, n: Ints, s: Floats, rows: int, count: int, values: int, started: bool) -> None:
    """Compute `count` inputs of the table at n[rows] behind position, speed and current, which are at s[values].

    They begin anew if not `started`.
    """
    row = rows
    state = values + 3 + count
    for place in range(values + 3, values + 3 + count):
        kind = n[row]
        source = n[row + 1]
        numbers = n[row + 2]
        if kind == KIND_HAT:
            s[place] = membership(s[source], p[numbers], p[numbers + 1], p[numbers + 2])
        elif kind == KIND_LAG:
            s[place] = update_lag(s, state, started, s[source], p[numbers])
        elif kind == KIND_STOP:
            s[place] = update_stop(s, state, started, s[source], p[numbers])
        elif kind == KIND_PLAY:
            s[place] = update_play(s, state, started, s[source], p[numbers])
        else:
            s[place] = update_frequency(p, s, numbers, state, started, s[values], s[values + 1])
        row += CONSTRUCTED_ROW
        state += CONSTRUCTED_STATES


def check_numbers(p: Floats, kind: int, at: int) -> bool:
    """Return whether the numbers of an input at p[at], ... allow its arithmetic."""
    if kind == KIND_HAT:
        return p[at] <= p[at + 1] <= p[at + 2]
    if kind == KIND_FREQUENCY:
        return 0.0 <= p[at] <= 1.0 and p[at + 1] > 0.0 and 0.0 <= p[at + 2] <= p[at + 3] <= MAX_SIGNAL
    if kind == KIND_LAG:
        return 0.0 <= p[at] <= 1.0
    return 0.0 <= p[at] <= MAX_SIGNAL


def check_constructed(
    p: Floats, n: Ints, numbers: int, counts: int, states: int, rows: int, count: int, values: int
) -> bool:
    """Return whether a table of inputs stays within p, n and s, and each is computed from a signal or one before it."""
    fits = lies_within(rows, CONSTRUCTED_ROW * count, 0, counts)
    if not (fits and lies_within(values + 3, count * (1 + CONSTRUCTED_STATES), 0, states)):
        return False
    row = rows
    for place in range(values + 3, values + 3 + count):
        fits = KIND_STOP <= n[row] <= KIND_HAT and values <= n[row + 1] < place
        fits = fits and lies_within(n[row + 2], CONSTRUCTED_NUMBERS, 0, numbers)
        if not (fits and check_numbers(p, n[row], n[row + 2])):
            return False
        row += CONSTRUCTED_ROW
    return True
