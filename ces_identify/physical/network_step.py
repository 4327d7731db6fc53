"""The step of a hydraulic network, compiled: `ces_observer.structures.hydraulic` has the equations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F, I
from ces_observer.structures.hydraulic import CLOSE, MAX_STEPS, NEAR, PATIENCE, ROUNDING, SPREAD, TURN

LEAD, VISCOUS, MASS, GAS, RATIO, COMPRESSION, REBOUND, MOUNT, CREEP, FADE, OIL, PISTON, BASE, EXTERNAL = range(14)
BYPASS, NARROW, FRICTION, YIELD, MOVED, GROWTH, LAGS = range(14, 21)  # of `places`, too
OILS = 2  # absolute pressure of the reservoir [N], and air
TIMES = np.array(SPREAD)  # absolute pressures over the reservoir's, where the pieces of the oil meet


class NetworkArrays(NamedTuple):
    """A hydraulic network as arrays: `k` (parameters,) with the valve's first, and the nodes of its curves.

    `places` are the indices in `k` of the groups named above; each group's rows follow each other. `rows` are the
    numbers of curves of piston, base and external valve; `small_N` is the drop below which openings are laminar,
    `most_N` the pressure at which both are held.
    """

    k: F
    places: I
    currents: F
    flows: F
    positions: F
    bypassed: F
    rows: I
    friction: int
    small_N: float
    most_N: float
    interval_s: float
    max_acceleration: float


@njit(cache=True)
def look_up(k: F, flows: F, below: int, above: int, blend: float, drop: float, piece: int, out: F, m: int) -> int:
    """Fill row `m` of `out` with flow, slope and share of its piece at a drop [N] of a blended edge; return the piece.

    The search begins at `piece`. (Views of rows cost time.)
    """
    count = len(flows)
    j = piece
    while j < count - 2 and drop > k[below + j + 1] + blend * (k[above + j + 1] - k[below + j + 1]):
        j += 1
    while j > 0 and drop <= k[below + j] + blend * (k[above + j] - k[below + j]):
        j -= 1
    left = k[below + j] + blend * (k[above + j] - k[below + j])
    rise = k[below + j + 1] + blend * (k[above + j + 1] - k[below + j + 1]) - left
    slope = (flows[j + 1] - flows[j]) / rise
    out[m, 0], out[m, 1], out[m, 2] = flows[j] + slope * (drop - left), slope, (drop - left) / rise
    return j


@njit(cache=True)
def store(oil: F, p: float, out: F, m: int) -> int:
    """Fill row `m` of `out` with phi(p) [N], slope, and derivatives by the numbers of `oil`; return the piece."""
    reservoir, air = oil[0], oil[1]
    time = p / reservoir + 1.0
    j = 0
    while j < len(TIMES) and time > TIMES[j]:
        j += 1
    if j == len(TIMES):
        slope, over = 0.0, 1.0 - 1.0 / TIMES[j - 1]
    elif j == 0:
        slope = 1.0 / TIMES[0] ** 2
        over = 1.0 - 1.0 / TIMES[0] + slope * (time - TIMES[0])
    else:
        slope = 1.0 / (TIMES[j - 1] * TIMES[j])
        over = 1.0 - 1.0 / TIMES[j] - slope * (TIMES[j] - time)
    out[m, 0], out[m, 1] = p + reservoir * air * over, 1.0 + air * slope
    out[m, 2], out[m, 3] = air * (over - slope * (time - 1.0)), reservoir * over
    return j


@njit(cache=True)
def slide(left: float, mount: float, stiffness: F, rub: F, limits: F, slips: I) -> tuple[float, float, int]:
    """Return the way [m] of a tick behind the mount, the stiffness [N/m] that friction adds, and a number for `slips`.

    `left` is the way [m] if friction stayed at `rub` (elements,) [N], within `limits`. Sets `slips` to the sign of
    those that yield, or 0: the way only grows as they do, so the loop ends.
    """
    sign = 1 if left > 0.0 else -1
    slips[:] = 0
    again, way, held, which = True, 0.0, 0.0, 0
    while again:
        again, held, which = False, 0.0, 0
        for m in range(len(rub)):
            held += 0.0 if slips[m] else stiffness[m]
            which = 3 * which + slips[m]
        way = left / (1.0 + mount * held)
        for m in range(len(rub)):
            if slips[m] == 0 and sign * (rub[m] + stiffness[m] * way) > limits[m]:
                slips[m] = sign
                left -= mount * (sign * limits[m] - rub[m])
                again = True
    return way, held, which


@njit(cache=True)
def solve_step(
    a: NetworkArrays, warmed_s: float, cells: F, below: I, above: I, blends: F, shares: F, openings: F, start: F,
    pieces: I, values: F, drops: F, oil: F, stored: F, rub: F, limits: F, slips: I,
) -> tuple[float, float, float, float, int]:  # fmt: skip
    """Return both pressures [N] after a step, the way [m] behind the mount, friction's stiffness, and Newton steps.

    `warmed_s` is the tick times the flows' growth by heat, `openings` (4,) those of the edges and of the bypass;
    `cells` holds both compliances, both volumes [m] before, and the way [m] behind the mount without pressures and if
    friction stayed as it is; `start` the pressures to begin with; `rub`, `limits`, `slips` are of `slide`. Leaves the
    pieces (5,) of the edges and of the oil in both chambers, the edges' values (4, 3): flow, slope and share, the last
    row the whole piston's flow and slope, and `stored` (2, 4) of `store`. A step is halved where the slope along it has
    reversed, so that the convex function of the step always falls.
    """
    k, flows, ratio, narrow_N = a.k, a.flows, 1.0 + a.k[a.places[RATIO]], a.k[a.places[NARROW]]
    mount = k[a.places[MOUNT]] + a.interval_s * k[a.places[CREEP]]
    stiffness = k[a.places[FRICTION] : a.places[FRICTION] + a.friction]
    p_c, p_r, d_c, d_r, slope, settled, smooth, which = start[0], start[1], 0.0, 0.0, 0.0, False, False, 0
    for step in range(MAX_STEPS):
        drop = p_c - p_r
        b0, b1, b2, b3, b4 = pieces[0], pieces[1], pieces[2], pieces[3], pieces[4]
        pieces[0] = look_up(k, flows, below[0], above[0], blends[0], drop, pieces[0], values, 0)
        pieces[1] = look_up(k, flows, below[1], above[1], blends[1], p_c, pieces[1], values, 1)
        pieces[2] = look_up(k, flows, below[2], above[2], blends[2], p_r, pieces[2], values, 2)
        pieces[3], pieces[4] = store(oil, p_c, stored, 0), store(oil, p_r, stored, 1)
        drops[0], drops[1], drops[2] = drop, p_c, p_r
        for m in range(3):
            values[m, 3], values[m, 4] = shares[m] * values[m, 0], shares[m] * values[m, 1]
            if openings[m] > 0.0:
                size = abs(drops[m]) + a.small_N
                root = np.sqrt(size)
                values[m, 3] += openings[m] * drops[m] / root
                values[m, 4] += openings[m] * (0.5 * abs(drops[m]) + a.small_N) / (size * root)
                smooth = True
        if openings[3] > 0.0:
            root = np.sqrt(narrow_N + 4.0 * abs(drop))
            values[0, 3] += openings[3] * 2.0 * drop / (root + np.sqrt(narrow_N))
            values[0, 4] += openings[3] / root
            smooth = True
        across, through = values[0, 3], values[0, 4]
        sliding = which
        way, held, which = slide(cells[4] - mount * (ratio * p_c - p_r), mount, stiffness, rub, limits, slips)
        g_c = cells[0] * stored[0, 0] - ratio * way - cells[2] + warmed_s * (across + values[1, 3])
        g_r = cells[1] * stored[1, 0] + way - cells[3] + warmed_s * (values[2, 3] - across)
        same = b0 == pieces[0] and b1 == pieces[1] and b2 == pieces[2] and b3 == pieces[3] and b4 == pieces[4]
        same = same and sliding == which
        near = NEAR if settled and same else CLOSE
        close = abs(d_c) <= near * (1.0 + abs(p_c)) and abs(d_r) <= near * (1.0 + abs(p_r))
        if step > 0 and (close or (settled and same and not smooth)):
            return p_c, p_r, way, held, step
        if step > 0 and g_c * d_c + g_r * d_r > (TURN if step < PATIENCE else ROUNDING) * slope:
            d_c, d_r = 0.5 * d_c, 0.5 * d_r
            p_c, p_r, settled = p_c - d_c, p_r - d_r, False
            continue
        own_c = cells[0] * stored[0, 1] + warmed_s * values[1, 4]
        own_r = cells[1] * stored[1, 1] + warmed_s * values[2, 4]
        joint = warmed_s * through
        eased = mount / (1.0 + mount * held)
        a_c, a_r, both = own_c + joint + ratio * ratio * eased, own_r + joint + eased, joint + ratio * eased
        determinant = own_c * (own_r + joint + eased) + own_r * (joint + ratio * ratio * eased)
        determinant += joint * eased * (ratio - 1.0) ** 2
        d_c = -(a_r * g_c + both * g_r) / determinant
        d_r = -(both * g_c + a_c * g_r) / determinant
        slope = -(g_c * d_c + g_r * d_r)
        p_c, p_r, settled = p_c + d_c, p_r + d_r, True
    return np.nan, np.nan, np.nan, 0.0, MAX_STEPS  # no force rather than a wrong one


@njit(cache=True)
def add_limit(by_rub: F, at: I, m: int, setting: float, sign: float, moved: float, by_setting: F) -> None:
    """Add the derivatives of the limit of friction element `m`, times `sign`; `moved` is that by the setting."""
    by_rub[at[YIELD] + m] += sign
    by_rub[at[MOVED] + m] += sign * setting
    for p in range(len(by_setting)):
        by_rub[p] += moved * by_setting[p]
