"""Compiled free run of a hydraulic network, with derivatives of the force by all parameters.

The equations are those of `ces_observer.structures.hydraulic`. A step solves U(P) + T L(P) - a w(P) = u(k-1) for the
pressures P, with U the stored volumes, L the flows and a = (r, -1); so by the implicit function theorem, with A the
derivative of the left side, dP = A^-1 (du(k-1) - d(U + T L - a w) by the parameters), and du = dU/dP dP + dU.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F, I
from ces_identify.physical import valve_kernels as valves
from ces_observer.structures.hydraulic import CLOSE, MAX_STEPS, NEAR, PATIENCE, ROUNDING, SPREAD, STILL_N, TURN

LEAD, VISCOUS, MASS, GAS, RATIO, COMPRESSION, REBOUND, MOUNT, CREEP, OIL, PISTON, BASE, EXTERNAL, BYPASS = range(14)
FRICTION, YIELD, MOVED, GROWTH, LAGS = 14, 15, 16, 17, 18  # of `places`, too
OILS = 2  # absolute pressure of the reservoir [N], and air
TIMES = np.array(SPREAD)  # absolute pressures over the reservoir's, where the pieces of the oil meet
ROWS = 64  # of derivatives, before their products are added up


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
def look_up(k: F, flows: F, below: int, above: int, blend: float, drop: float, piece: int, out: F) -> int:
    """Fill `out` with flow, slope and share of its piece at a pressure drop [N] of a blended edge; return the piece.

    The search begins at `piece`.
    """
    count = len(flows)
    j = piece
    while j < count - 2 and drop > k[below + j + 1] + blend * (k[above + j + 1] - k[below + j + 1]):
        j += 1
    while j > 0 and drop <= k[below + j] + blend * (k[above + j] - k[below + j]):
        j -= 1
    left = k[below + j] + blend * (k[above + j] - k[below + j])
    rise = k[below + j + 1] + blend * (k[above + j + 1] - k[below + j + 1]) - left
    out[1] = (flows[j + 1] - flows[j]) / rise
    out[2] = (drop - left) / rise
    out[0] = flows[j] + out[1] * (drop - left)
    return j


@njit(cache=True)
def store(oil: F, p: float, out: F) -> int:
    """Fill `out` with phi(p) [N], its slope, and its derivatives by the numbers of `oil`; return the piece."""
    reservoir, air = oil
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
    out[0], out[1] = p + reservoir * air * over, 1.0 + air * slope
    out[2], out[3] = air * (over - slope * (time - 1.0)), reservoir * over
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
    a: NetworkArrays, cells: F, below: I, above: I, blends: F, shares: F, openings: F, start: F, pieces: I,
    values: F, drops: F, oil: F, stored: F, rub: F, limits: F, slips: I,
) -> tuple[float, float, float, float, int]:  # fmt: skip
    """Return both pressures [N] after a step, the way [m] behind the mount, friction's stiffness, and Newton steps.

    `cells` holds both compliances, both volumes [m] before, and the way [m] behind the mount without pressures and
    if friction stayed as it is; `start` the pressures to begin with. `rub`, `limits`, `slips` are those of `slide`. Leaves the
    pieces (5,) of the edges and of the oil in both chambers, the edges' values (4, 3): flow, slope and share, the last
    row the whole piston's flow and slope, and `stored` (2, 4) of `store`. A step is halved where the slope along it has
    reversed, so that the convex function of the step always falls.
    """
    k, flows, interval, ratio = a.k, a.flows, a.interval_s, 1.0 + a.k[a.places[RATIO]]
    mount = k[a.places[MOUNT]] + interval * k[a.places[CREEP]]
    stiffness = k[a.places[FRICTION] : a.places[FRICTION] + a.friction]
    p_c, p_r, d_c, d_r, slope, settled, smooth, which = start[0], start[1], 0.0, 0.0, 0.0, False, False, 0
    for step in range(MAX_STEPS):
        drop = p_c - p_r
        b0, b1, b2, b3, b4 = pieces
        pieces[0] = look_up(k, flows, below[0], above[0], blends[0], drop, pieces[0], values[0])
        pieces[1] = look_up(k, flows, below[1], above[1], blends[1], p_c, pieces[1], values[1])
        pieces[2] = look_up(k, flows, below[2], above[2], blends[2], p_r, pieces[2], values[2])
        pieces[3], pieces[4] = store(oil, p_c, stored[0]), store(oil, p_r, stored[1])
        drops[0], drops[1], drops[2] = drop, p_c, p_r
        for m in range(3):
            values[m, 3], values[m, 4] = shares[m] * values[m, 0], shares[m] * values[m, 1]
            if openings[m] > 0.0:
                size = abs(drops[m]) + a.small_N
                root = np.sqrt(size)
                values[m, 3] += openings[m] * drops[m] / root
                values[m, 4] += openings[m] * (0.5 * abs(drops[m]) + a.small_N) / (size * root)
                smooth = True
        across, through = values[0, 3], values[0, 4]
        sliding = which
        way, held, which = slide(cells[4] - mount * (ratio * p_c - p_r), mount, stiffness, rub, limits, slips)
        g_c = cells[0] * stored[0, 0] - ratio * way - cells[2] + interval * (across + values[1, 3])
        g_r = cells[1] * stored[1, 0] + way - cells[3] + interval * (values[2, 3] - across)
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
        own_c = cells[0] * stored[0, 1] + interval * values[1, 4]
        own_r = cells[1] * stored[1, 1] + interval * values[2, 4]
        joint = interval * through
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


@njit(cache=True, nogil=True)
def run_network(
    a: NetworkArrays, data: valves.RunData, score: valves.Score, force: F, matrix: F, gradients: F
) -> tuple[float, int, float]:
    """Fill `force` (ticks,) [N]; return the weighted squared error, the Newton steps and the largest pressure [N].

    If `matrix` (parameters, parameters) has rows, also add up the Gauss-Newton matrix and, for each block, the gradient
    of half the squared error, in `gradients` (blocks, parameters).
    """
    k, at, interval = a.k, a.places, a.interval_s
    size, fitted, wide = len(k), matrix.shape[0] > 0, len(a.flows)
    ratio, growth, oil = 1.0 + k[at[RATIO]], k[at[GROWTH]], k[at[OIL] : at[OIL] + OILS]
    valve = 4 + len(a.currents)
    plays, by_setting = np.zeros((3, len(valves.HALVES))), np.zeros(valve)
    by_c, by_r = np.zeros(size), np.zeros(size)
    rows, used_rows = np.zeros((ROWS if fitted else 1, size)), 0
    rub, limits, slips = np.zeros(a.friction), np.zeros(a.friction), np.zeros(a.friction, np.int64)
    by_rub, by_pull, by_way = np.zeros((a.friction, size)), np.zeros(size), np.zeros(size)
    cells, start, values, pieces = np.zeros(5), np.zeros(2), np.zeros((3, 5)), np.zeros(5, np.int64)
    openings, opened, shares, drops = np.zeros(3), np.zeros(3), np.ones(3), np.zeros(3)
    by_opened, by_shares = np.zeros((3, size)), np.zeros(3)
    over, by_drop, wanted, kept_open, before = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for m in range(3):
        shares[m] = interval / (k[at[LAGS] + m] + interval)
        by_shares[m] = -shares[m] / (k[at[LAGS] + m] + interval)
    stored, rest, by_oil = np.zeros((2, 2 + OILS)), np.zeros(2 + OILS), np.zeros((2, OILS))
    below, above, blends = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3)
    edges = np.array([at[PISTON], at[BASE], at[EXTERNAL]])
    spring, mount = k[at[MOUNT]], k[at[MOUNT]] + interval * k[at[CREEP]]  # a tick's creep gives way like a spring
    at_rest = store(oil, 0.0, rest)
    total, steps, most, bypasses = 0.0, 0, 0.0, len(a.bypassed) > 0
    along_bypass, j = 0.0, 0
    for s in range(data.segments.shape[0]):
        first, stop = data.segments[s]
        if stop <= first:
            continue
        setting = valves.restart_valve(k, a.currents, data.current[first], plays, by_setting)
        start[:] = 0.0
        by_c[:] = 0.0
        by_r[:] = 0.0
        rub[:] = 0.0
        by_rub[:] = 0.0
        by_pull[:] = 0.0
        pull = 0.0
        pieces[:3] = wide // 2
        pieces[3:] = at_rest
        opened[:] = 0.0
        by_opened[:] = 0.0
        stored[:] = rest
        growth_c = np.exp(k[at[COMPRESSION] + 1] * data.position[first])
        growth_r = np.exp(k[at[REBOUND] + 1] * data.position[first])
        cells[0], cells[1] = k[at[COMPRESSION]] * growth_c, k[at[REBOUND]] * growth_r
        u_c, u_r = cells[0] * rest[0], cells[1] * rest[0]
        if fitted:
            by_c[at[COMPRESSION]], by_r[at[REBOUND]] = growth_c * rest[0], growth_r * rest[0]
            by_c[at[COMPRESSION] + 1], by_r[at[REBOUND] + 1] = data.position[first] * u_c, data.position[first] * u_r
            for m in range(OILS):
                by_c[at[OIL] + m], by_r[at[OIL] + m] = cells[0] * rest[2 + m], cells[1] * rest[2 + m]
        for n in range(first, stop):
            setting = valves.advance_valve(k, a.currents, data.current, first, n, interval, setting, plays, by_setting)
            change = valves.acceleration(data.speed, first, n, interval, a.max_acceleration)
            drive = data.speed[n] + k[at[LEAD]] * change
            for m in range(3):
                top = a.rows[m] - 1
                lower = max(min(int(setting * top), top - 1), 0)
                blends[m] = setting * top - lower
                below[m] = edges[m] + lower * wide
                above[m] = below[m] + wide if top > 0 else below[m]
            for m in range(3):
                openings[m] = (1.0 - shares[m]) * opened[m]
            if bypasses:
                j = valves.find_piece(a.bypassed, data.position[n])
                along_bypass = (data.position[n] - a.bypassed[j]) / (a.bypassed[j + 1] - a.bypassed[j])
                along_bypass = min(max(along_bypass, 0.0), 1.0)
                openings[0] += k[at[BYPASS] + j] + along_bypass * (k[at[BYPASS] + j + 1] - k[at[BYPASS] + j])
            x = data.position[n]
            growth_c, growth_r = np.exp(k[at[COMPRESSION] + 1] * x), np.exp(k[at[REBOUND] + 1] * x)
            cells[0], cells[1] = k[at[COMPRESSION]] * growth_c, k[at[REBOUND]] * growth_r
            rubbed = 0.0
            for m in range(a.friction):
                limits[m] = k[at[YIELD] + m] + setting * k[at[MOVED] + m]
                if abs(rub[m]) > limits[m]:
                    sign = 1.0 if rub[m] > 0.0 else -1.0
                    rub[m] = sign * limits[m]
                    if fitted:
                        by_rub[m] = 0.0
                        add_limit(by_rub[m], at, m, setting, sign, sign * k[at[MOVED] + m], by_setting)
                rubbed += rub[m]
            cells[2], cells[3], cells[4] = u_c, u_r, interval * drive + spring * pull - mount * rubbed
            p_c, p_r, way, held, used = solve_step(
                a, cells, below, above, blends, shares, openings, start, pieces, values, drops, oil, stored, rub,
                limits, slips,
            )  # fmt: skip
            if not (abs(p_c) <= a.most_N and abs(p_r) <= a.most_N):
                p_c, p_r = min(max(p_c, -a.most_N), a.most_N), min(max(p_r, -a.most_N), a.most_N)
                drops[0], drops[1], drops[2] = p_c - p_r, p_c, p_r
                for m in range(3):
                    pieces[m] = look_up(k, a.flows, below[m], above[m], blends[m], drops[m], pieces[m], values[m])
                pieces[3], pieces[4] = store(oil, p_c, stored[0]), store(oil, p_r, stored[1])
                way, held, _ = slide(
                    cells[4] - mount * (ratio * p_c - p_r), mount,
                    k[at[FRICTION] : at[FRICTION] + a.friction], rub, limits, slips,
                )  # fmt: skip
            start[0], start[1] = p_c, p_r
            steps += used
            most = max(most, abs(p_c), abs(p_r))
            pulled_s = ratio * p_c - p_r
            u_c, u_r = cells[0] * stored[0, 0], cells[1] * stored[1, 0]
            pulled, rubbed = pull, 0.0
            if fitted:
                by_way[:] = spring * by_pull
            for m in range(a.friction):
                stiffness = k[at[FRICTION] + m]
                if fitted and slips[m] == 0:
                    by_rub[m, at[FRICTION] + m] += way
                    by_way -= mount * by_rub[m]
                elif fitted:
                    sign = float(slips[m])
                    by_rub[m] = 0.0
                    add_limit(by_rub[m], at, m, setting, sign, sign * k[at[MOVED] + m], by_setting)
                    by_way -= mount * by_rub[m]
                rub[m] = rub[m] + stiffness * way if slips[m] == 0 else slips[m] * limits[m]
                rubbed += rub[m]
            pull = pulled_s + rubbed
            pressed = 1.0 + growth * max(p_r, 0.0)
            i = valves.find_piece(a.positions, data.position[n])
            along = (data.position[n] - a.positions[i]) / (a.positions[i + 1] - a.positions[i])
            gas = k[at[GAS] + i] + along * (k[at[GAS] + i + 1] - k[at[GAS] + i])
            force[n] = ratio * p_c - p_r + rubbed * pressed + gas + k[at[VISCOUS]] * drive + k[at[MASS]] * change
            scored = score.weights[n] > 0.0 and n % score.stride == 0
            if scored:
                total += (score.weights[n] * (force[n] - score.measured[n])) ** 2
            for m in range(3):
                over[m] = np.sqrt(abs(drops[m]) + a.small_N)
                kept_open[m] = 1.0 - shares[m]
                if abs(drops[m]) >= STILL_N:
                    wanted[m] = values[m, 0] * over[m] / drops[m]
                    by_drop[m] = values[m, 1] * over[m] / drops[m] - wanted[m] / drops[m]
                    by_drop[m] += 0.5 * values[m, 0] / (over[m] * abs(drops[m]))
                    over[m] /= drops[m]
                else:
                    wanted[m], by_drop[m], over[m], kept_open[m] = opened[m], 0.0, 0.0, 1.0
                by_drop[m] *= shares[m]
                before[m] = opened[m]
            if not fitted:
                for m in range(3):
                    opened[m] += shares[m] * (wanted[m] - opened[m])
                continue
            by_way[at[RATIO]] -= mount * p_c
            by_way[at[MOUNT]] -= pull - pulled
            by_way[at[CREEP]] -= interval * pull
            by_way[at[LEAD]] += interval * change
            by_way /= 1.0 + mount * held
            for q in range(size):
                by_c[q] += ratio * by_way[q]
                by_r[q] -= by_way[q]
            by_c[at[RATIO]] += way
            by_c[at[COMPRESSION]] -= growth_c * stored[0, 0]
            by_r[at[REBOUND]] -= growth_r * stored[1, 0]
            by_c[at[COMPRESSION] + 1] -= x * cells[0] * stored[0, 0]
            by_r[at[REBOUND] + 1] -= x * cells[1] * stored[1, 0]
            for m in range(OILS):
                by_oil[0, m], by_oil[1, m] = cells[0] * stored[0, 2 + m], cells[1] * stored[1, 2 + m]
                by_c[at[OIL] + m] -= by_oil[0, m]
                by_r[at[OIL] + m] -= by_oil[1, m]
            for m in range(3):
                eases, share, blend, p = interval * shares[m] * values[m, 1], values[m, 2], blends[m], pieces[m]
                root = np.sqrt(abs(drops[m]) + a.small_N)
                rooted = drops[m] / root
                by_lag = interval * by_shares[m] * (values[m, 0] - opened[m] * rooted)
                kept = interval * (1.0 - shares[m]) * rooted
                if m < 2:
                    by_c[at[LAGS] + m] -= by_lag
                    for q in range(size):
                        by_c[q] -= kept * by_opened[m, q]
                if m != 1:
                    sign = -1.0 if m == 0 else 1.0
                    by_r[at[LAGS] + m] -= sign * by_lag
                    for q in range(size):
                        by_r[q] -= sign * kept * by_opened[m, q]
                if m < 2:
                    valves.add_share(by_c, below[m] + p, share, eases * (1.0 - blend))
                    valves.add_share(by_c, above[m] + p, share, eases * blend)
                if m != 1:
                    sign = -eases if m == 0 else eases
                    valves.add_share(by_r, below[m] + p, share, sign * (1.0 - blend))
                    valves.add_share(by_r, above[m] + p, share, sign * blend)
                if a.rows[m] > 1:
                    steeper = (1.0 - share) * (k[above[m] + p] - k[below[m] + p])
                    steeper += share * (k[above[m] + p + 1] - k[below[m] + p + 1])
                    steeper *= eases * (a.rows[m] - 1)
                    for q in range(valve):
                        if m < 2:
                            by_c[q] += steeper * by_setting[q]
                        if m != 1:
                            by_r[q] += (-steeper if m == 0 else steeper) * by_setting[q]
            if bypasses:
                drop = p_c - p_r
                passed = interval * drop / np.sqrt(abs(drop) + a.small_N)
                valves.add_share(by_c, at[BYPASS] + j, along_bypass, -passed)
                valves.add_share(by_r, at[BYPASS] + j, along_bypass, passed)
            wide_c, wide_r = cells[0] * stored[0, 1], cells[1] * stored[1, 1]
            own_c, own_r = wide_c + interval * values[1, 4], wide_r + interval * values[2, 4]
            joint = interval * values[0, 4]
            eased = mount / (1.0 + mount * held)
            a_c, a_r, both = own_c + joint + ratio * ratio * eased, own_r + joint + eased, joint + ratio * eased
            determinant = own_c * (own_r + joint + eased) + own_r * (joint + ratio * ratio * eased)
            determinant += joint * eased * (ratio - 1.0) ** 2
            i_cc, i_cr, i_rr = a_r / determinant, both / determinant, a_c / determinant
            by_p_r = growth * rubbed if p_r > 0.0 else 0.0
            row = rows[used_rows]
            for p in range(size):
                d_c, d_r = i_cc * by_c[p] + i_cr * by_r[p], i_cr * by_c[p] + i_rr * by_r[p]
                by_c[p], by_r[p] = wide_c * d_c, wide_r * d_r
                by_pull[p] = ratio * d_c - d_r
                row[p] = by_pull[p] + d_r * by_p_r
                by_way[p] -= eased * by_pull[p]
                by_opened[0, p] = kept_open[0] * by_opened[0, p] + by_drop[0] * (d_c - d_r)
                by_opened[1, p] = kept_open[1] * by_opened[1, p] + by_drop[1] * d_c
                by_opened[2, p] = kept_open[2] * by_opened[2, p] + by_drop[2] * d_r
            for m in range(3):
                slope, share, blend, p = values[m, 1], values[m, 2], blends[m], pieces[m]
                by_flow = shares[m] * over[m]
                by_opened[m, at[LAGS] + m] += by_shares[m] * (wanted[m] - before[m])
                valves.add_share(by_opened[m], below[m] + p, share, -by_flow * slope * (1.0 - blend))
                valves.add_share(by_opened[m], above[m] + p, share, -by_flow * slope * blend)
                if a.rows[m] > 1:
                    steeper = (1.0 - share) * (k[above[m] + p] - k[below[m] + p])
                    steeper += share * (k[above[m] + p + 1] - k[below[m] + p + 1])
                    steeper *= by_flow * slope * (a.rows[m] - 1)
                    for q in range(valve):
                        by_opened[m, q] -= steeper * by_setting[q]
            by_pull[at[RATIO]] += p_c
            row[at[RATIO]] += p_c
            for m in range(a.friction):
                if slips[m] == 0:
                    by_rub[m] += k[at[FRICTION] + m] * by_way
                by_pull += by_rub[m]
                if scored:
                    row += pressed * by_rub[m]
            by_c[at[COMPRESSION]] += growth_c * stored[0, 0]
            by_r[at[REBOUND]] += growth_r * stored[1, 0]
            by_c[at[COMPRESSION] + 1] += x * cells[0] * stored[0, 0]
            by_r[at[REBOUND] + 1] += x * cells[1] * stored[1, 0]
            for m in range(OILS):
                by_c[at[OIL] + m] += by_oil[0, m]
                by_r[at[OIL] + m] += by_oil[1, m]
            for m in range(3):
                opened[m] += shares[m] * (wanted[m] - opened[m])
            if scored:
                row[at[GROWTH]] += rubbed * max(p_r, 0.0)
                valves.add_share(row, at[GAS] + i, along, 1.0)
                row[at[VISCOUS]] += drive
                row[at[MASS]] += change
                row[at[LEAD]] += k[at[VISCOUS]] * change
                weight, error = score.weights[n], force[n] - score.measured[n]
                gradient = gradients[score.blocks[n]]
                for p in range(size):
                    row[p] *= weight
                    gradient[p] += row[p] * weight * error
                used_rows += 1
                if used_rows == ROWS:
                    matrix += np.dot(rows.T, rows)
                    used_rows = 0
    if fitted and used_rows > 0:
        rest = rows[:used_rows]
        matrix += np.dot(rest.T, rest)
    return total, steps, most
