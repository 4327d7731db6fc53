"""Lagged, scaled regressors of networks and fuzzy rules: inputs of each tick in, a vector of numbers out.

phi_j = (u(k - lag_j) - mean_j) / spread_j, with u the position, speed, current or the model's own past force. Before
the first tick, forces are zero and inputs equal the first ones. An affine layer y = W x + b takes them; its sums have
one order everywhere: that of the columns, then the bias.
"""

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.model import (
    CLAMPED, CURRENT_HIGH, CURRENT_LOW, HELD, K_STRUCTURE, LARGEST, N_STRUCTURE, POSITION_HIGH, POSITION_LOW, SMALLEST,
    SPEED_HIGH, SPEED_LOW, STARTED, are_between, are_indices, clamp, hold_force, is_clamped, lies_within,
)  # fmt: skip


def apply_layer(p: Floats, s: Floats, table: int, rows: int, width: int, x: int, y: int) -> None:
    """Set `rows` numbers from s[y] on; p[table] begins W, whose rows of `width` numbers each end with their bias.

    Four rows at a time share the reading of x, and no addition waits for the one before it.
    """
    row_size = width + 1
    end = x + width
    last = y + rows
    first = table - x
    while y + 4 <= last:
        second = first + row_size
        third = second + row_size
        fourth = third + row_size
        a = 0.0
        b = 0.0
        c = 0.0
        d = 0.0
        for j in range(x, end):
            value = s[j]
            a += p[first + j] * value
            b += p[second + j] * value
            c += p[third + j] * value
            d += p[fourth + j] * value
        s[y] = a + p[first + end]
        s[y + 1] = b + p[second + end]
        s[y + 2] = c + p[third + end]
        s[y + 3] = d + p[fourth + end]
        first = fourth + row_size
        y += 4
    while y < last:
        a = 0.0
        for j in range(x, end):
            a += p[first + j] * s[j]
        s[y] = a + p[first + end]
        first += row_size
        y += 1


# n: ticks that are kept; the regressors, and where they begin in s; where these begin: in s four rings of the past
# (position, speed, current, force), in n pairs (ring in s, lag), in p pairs (mean, spread), one for each regressor
(
    LAGGED_DEPTH, LAGGED_COUNT, LAGGED_PHI, LAGGED_RINGS, LAGGED_SOURCES, LAGGED_SCALES, N_LAGGED,
) = range(N_STRUCTURE, N_STRUCTURE + 7)  # fmt: skip

# k: the place of the newest tick in the rings
LAGGED_NEWEST, K_LAGGED = range(K_STRUCTURE, K_STRUCTURE + 2)


def lagged_reset(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Forget the past."""
    k[CLAMPED] = 0
    k[HELD] = 0
    k[STARTED] = 0
    k[LAGGED_NEWEST] = 0
    forces = n[LAGGED_RINGS] + 3 * n[LAGGED_DEPTH]
    for i in range(n[LAGGED_DEPTH]):
        s[forces + i] = 0.0


def lagged_inputs(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> None:
    """Store the inputs [m, m/s, A] of a new tick, clamped to their ranges, and fill in the regressors."""
    k[CLAMPED] = 1 if is_clamped(p, position, speed, current) else 0
    position = clamp(position, p[POSITION_LOW], p[POSITION_HIGH])
    speed = clamp(speed, p[SPEED_LOW], p[SPEED_HIGH])
    current = clamp(current, p[CURRENT_LOW], p[CURRENT_HIGH])
    depth = n[LAGGED_DEPTH]
    newest = k[LAGGED_NEWEST] + 1
    if newest == depth:
        newest = 0
    k[LAGGED_NEWEST] = newest
    positions = n[LAGGED_RINGS]
    speeds = positions + depth
    currents = speeds + depth
    s[positions + newest] = position
    s[speeds + newest] = speed
    s[currents + newest] = current
    if k[STARTED] == 0:
        k[STARTED] = 1
        for i in range(depth):
            s[positions + i] = position
            s[speeds + i] = speed
            s[currents + i] = current
    phi = n[LAGGED_PHI]
    source = n[LAGGED_SOURCES]
    scale = n[LAGGED_SCALES]
    for j in range(phi, phi + n[LAGGED_COUNT]):
        at = newest - n[source + 1]
        if at < 0:
            at += depth
        s[j] = (s[n[source] + at] - p[scale]) / p[scale + 1]
        source += 2
        scale += 2


def lagged_force(p: Floats, n: Ints, s: Floats, k: Ints, force: float) -> float:
    """Hold this tick's force [N] in its range, store it and return it."""
    held = hold_force(p, k, force)
    s[n[LAGGED_RINGS] + 3 * n[LAGGED_DEPTH] + k[LAGGED_NEWEST]] = held
    return held


def check_lagged(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether the regressors stay within arrays p, n, s and k of these sizes."""
    if counts < N_LAGGED or flags < K_LAGGED:
        return False
    depth = n[LAGGED_DEPTH]
    count = n[LAGGED_COUNT]
    source = n[LAGGED_SOURCES]
    scale = n[LAGGED_SCALES]
    fits = 1 <= depth <= states and 1 <= count <= counts and lies_within(n[LAGGED_RINGS], 4 * depth, 0, states)
    fits = fits and lies_within(n[LAGGED_PHI], count, 0, states) and lies_within(source, 2 * count, 0, counts)
    fits = fits and are_indices(n, source, count, 2, 0, states - depth + 1)
    fits = fits and are_indices(n, source + 1, count, 2, 0, depth) and lies_within(scale, 2 * count, 0, numbers)
    return fits and are_between(p, scale + 1, count, 2, SMALLEST, LARGEST)
