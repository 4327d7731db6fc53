"""Compiled free run of models with two chambers, with derivatives of the force by all parameters.

The equations are those of `ces_observer.structures.chambers`. A step solves S (P - P(k-1)) + T L(P) = T a drive for the
pressures P; the state that is passed on is u = S P, so by the implicit function theorem, with A = S + T dL/dP,
dP = A^-1 (du(k-1) - (dS P + T dL - T d(a drive)) by the parameters), and du = S dP + dS P.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F, I
from ces_identify.physical import valve_kernels as valves

QUICK_STEPS, MAX_STEPS = 6, 300
CLOSE = 1e-12
LEAD, VISCOUS, MASS, GAS, RATIO, COMPRESSION, REBOUND, MOUNT, CHECK, REFILL, MAP = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10
FRICTION, YIELD, GROWTH = 11, 12, 13  # of `places`, too


class ChamberArrays(NamedTuple):
    """A model with chambers as arrays: `k` (parameters,) with the valve's first, and the nodes of its curves.

    `places` are the indices in `k` of the groups named above; each group's rows follow each other.
    """

    k: F
    places: I
    currents: F
    flows: F
    drops: F
    suctions: F
    positions: F
    rows: int
    friction: int
    interval_s: float
    max_acceleration: float


@njit(cache=True)
def pick_blend(k: F, below: int, above: int, count: int, blend: float, pressure: float) -> int:
    """Return the index of the piece of the blended valve curve that holds a pressure [N]."""
    j = 0
    while j < count - 2 and pressure > k[below + j + 1] + blend * (k[above + j + 1] - k[below + j + 1]):
        j += 1
    return j


@njit(cache=True)
def solve_pieces(
    a: ChamberArrays, drive: float, below: int, blend: float, o_c: float, o_r: float, p_c: float, p_r: float, out: F,
    pieces: I,
) -> tuple[float, float]:  # fmt: skip
    """Return both pressures [N] after a step from (o_c, o_r), on the pieces of the curves that hold (p_c, p_r).

    Fills `pieces` (3,) and `out` (5,): the symmetric matrix of the step (3) [m/N], the valve's slope, and the share of
    its piece. The sums are those of `ces_observer.structures.chambers`, none of which cancels.
    """
    k, at, interval = a.k, a.places, a.interval_s
    above = below + len(a.flows)
    i, j = valves.find_piece(a.drops, p_c - p_r), valves.find_piece(a.suctions, -p_c)
    m = pick_blend(k, below, above, len(a.flows), blend, p_r)
    check, refill = at[CHECK] + i, at[REFILL] + j
    c1 = (k[check + 1] - k[check]) / (a.drops[i + 1] - a.drops[i])
    r1 = (k[refill + 1] - k[refill]) / (a.suctions[j + 1] - a.suctions[j])
    left = k[below + m] + blend * (k[above + m] - k[below + m])
    right = k[below + m + 1] + blend * (k[above + m + 1] - k[below + m + 1])
    v1 = (a.flows[m + 1] - a.flows[m]) / (right - left)
    across = k[check] + c1 * (o_c - o_r - a.drops[i])
    refilled = k[refill] + r1 * (-o_c - a.suctions[j])
    valve = a.flows[m] + v1 * (o_r - left)
    more, r = k[at[RATIO]], 1.0 + k[at[RATIO]]
    c_c, c_r, mount = k[at[COMPRESSION]] / interval + r1, k[at[REBOUND]] / interval + v1, k[at[MOUNT]] / interval
    x, y = mount * (more * across + refilled - r * valve), c1 * (more * drive + refilled - valve)
    determinant = c_c * (c_r + mount + c1) + (r * r * mount + c1) * c_r + mount * c1 * more * more
    out[0] = interval * (c_c + r * r * mount + c1)
    out[1] = -interval * (r * mount + c1)
    out[2] = interval * (c_r + mount + c1)
    out[3], out[4] = v1, (p_r - left) / (right - left)
    pieces[0], pieces[1], pieces[2] = i, j, m
    return (
        o_c + (c_r * (r * drive - across + refilled) + x + y) / determinant,
        o_r + (c_c * (across - drive - valve) + r * x + y) / determinant,
    )


@njit(cache=True)
def balance(a: ChamberArrays, drive: float, o_c: float, o_r: float, p_r: float) -> float:
    """Return the p_c [N] at which the flows into the compression chamber balance, for a given p_r [N]."""
    k, at = a.k, a.places
    r, mount = 1.0 + k[at[RATIO]], k[at[MOUNT]] / a.interval_s
    stored, pushed = k[at[COMPRESSION]] / a.interval_s + r * r * mount, r * mount * (p_r - o_r) + r * drive
    low, high, p_c = -np.inf, np.inf, o_c
    for _ in range(MAX_STEPS):
        i, j = valves.find_piece(a.drops, p_c - p_r), valves.find_piece(a.suctions, -p_c)
        check, refill = at[CHECK] + i, at[REFILL] + j
        c1 = (k[check + 1] - k[check]) / (a.drops[i + 1] - a.drops[i])
        r1 = (k[refill + 1] - k[refill]) / (a.suctions[j + 1] - a.suctions[j])
        missing = stored * (p_c - o_c) - pushed
        missing += k[check] + c1 * (p_c - p_r - a.drops[i]) - k[refill] - r1 * (-p_c - a.suctions[j])
        new = p_c - missing / (stored + c1 + r1)
        if abs(new - p_c) <= CLOSE * (1.0 + abs(new)):
            return float(new)
        if new > p_c:
            low = p_c
        else:
            high = p_c
        p_c = new if low < new < high else 0.5 * (low + high)
    return float(p_c)


@njit(cache=True)
def solve_step(
    a: ChamberArrays, drive: float, below: int, blend: float, o_c: float, o_r: float, out: F, pieces: I
) -> tuple[float, float, int]:
    """Return both pressures [N] after a step from (o_c, o_r), and the number of solutions on given pieces.

    Follows the solutions from pieces to pieces and, if that does not end, searches p_r in a bracket.
    """
    p_c, p_r, last = o_c, o_r, (-1, -1, -1)
    for step in range(QUICK_STEPS):
        new_c, new_r = solve_pieces(a, drive, below, blend, o_c, o_r, p_c, p_r, out, pieces)
        if (pieces[0], pieces[1], pieces[2]) == last:
            return p_c, p_r, step + 1
        p_c, p_r, last = new_c, new_r, (pieces[0], pieces[1], pieces[2])
    low, high, p_r = -np.inf, np.inf, o_r
    for step in range(MAX_STEPS):
        p_c = balance(a, drive, o_c, o_r, p_r)
        new_c, new_r = solve_pieces(a, drive, below, blend, o_c, o_r, p_c, p_r, out, pieces)
        if abs(new_r - p_r) <= CLOSE * (1.0 + abs(new_r)):
            return new_c, new_r, QUICK_STEPS + step + 1
        if new_r > p_r:
            low = p_r
        else:
            high = p_r
        p_r = new_r if low < new_r < high else 0.5 * (low + high)
    return np.nan, np.nan, QUICK_STEPS + MAX_STEPS  # no force rather than a wrong one


@njit(cache=True, nogil=True)
def run_chambers(
    a: ChamberArrays, data: valves.RunData, score: valves.Score, force: F, matrix: F, gradients: F
) -> tuple[float, int]:
    """Fill `force` (ticks,) [N]; return the weighted squared error and the number of Newton steps.

    If `matrix` (parameters, parameters) has rows, also add up the Gauss-Newton matrix (its upper triangle) and, for
    each block, the gradient of half the squared error, in `gradients` (blocks, parameters).
    """
    k, at, interval = a.k, a.places, a.interval_s
    size, fitted, wide = len(k), matrix.shape[0] > 0, len(a.flows)
    ratio, mount, growth = 1.0 + k[at[RATIO]], k[at[MOUNT]], k[at[GROWTH]]
    stored = np.array([k[at[COMPRESSION]] + ratio * ratio * mount, -ratio * mount, k[at[REBOUND]] + mount])
    valve = 4 + len(a.currents)
    plays, by_setting = np.zeros((3, len(valves.HALVES))), np.zeros(valve)
    by_c, by_r, e_c, e_r, row = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
    rub, rub_by = np.zeros(a.friction), np.zeros((3, a.friction))  # by stiffness, yield force and lead
    out, pieces = np.zeros(5), np.zeros(3, np.int64)
    total, steps = 0.0, 0
    for s in range(data.segments.shape[0]):
        first, stop = data.segments[s]
        if stop <= first:
            continue
        setting = valves.restart_valve(k, a.currents, data.current[first], plays, by_setting)
        p_c, p_r = 0.0, 0.0
        by_c[:] = 0.0
        by_r[:] = 0.0
        rub[:] = 0.0
        rub_by[:] = 0.0
        for n in range(first, stop):
            setting = valves.advance_valve(k, a.currents, data.current, first, n, interval, setting, plays, by_setting)
            change = valves.acceleration(data.speed, first, n, interval, a.max_acceleration)
            drive = data.speed[n] + k[at[LEAD]] * change
            lower = min(int(setting * (a.rows - 1)), a.rows - 2)
            blend = setting * (a.rows - 1) - lower
            below = at[MAP] + lower * wide
            above = below + wide
            p_c, p_r, used = solve_step(a, drive, below, blend, p_c, p_r, out, pieces)
            steps += used
            rubbed = 0.0
            for m in range(a.friction):
                pulled = rub[m] + k[at[FRICTION] + m] * interval * drive
                limit = k[at[YIELD] + m]
                if abs(pulled) > limit:
                    rub[m] = limit if pulled > 0.0 else -limit
                    rub_by[0, m], rub_by[1, m], rub_by[2, m] = 0.0, 1.0 if pulled > 0.0 else -1.0, 0.0
                else:
                    rub[m] = pulled
                    rub_by[0, m] += interval * drive
                    rub_by[2, m] += k[at[FRICTION] + m] * interval * change
                rubbed += rub[m]
            pressed = 1.0 + growth * max(p_r, 0.0)
            i = valves.find_piece(a.positions, data.position[n])
            along = (data.position[n] - a.positions[i]) / (a.positions[i + 1] - a.positions[i])
            gas = k[at[GAS] + i] + along * (k[at[GAS] + i + 1] - k[at[GAS] + i])
            oil = ratio * p_c - p_r
            force[n] = oil + rubbed * pressed + gas + k[at[VISCOUS]] * drive + k[at[MASS]] * change
            scored = score.weights[n] > 0.0 and n % score.stride == 0
            if scored:
                total += (score.weights[n] * (force[n] - score.measured[n])) ** 2
            if not fitted:
                continue
            for p in range(len(by_c)):  # a loop compiles faster than an assignment of arrays
                e_c[p], e_r[p] = by_c[p], by_r[p]
            s_c, s_r = mount * (oil + ratio * p_c), -mount * p_c  # dS P by the area ratio
            e_c[at[RATIO]] += interval * drive - s_c
            e_r[at[RATIO]] -= s_r
            e_c[at[LEAD]] += interval * ratio * change
            e_r[at[LEAD]] -= interval * change
            e_c[at[COMPRESSION]] -= p_c
            e_r[at[REBOUND]] -= p_r
            e_c[at[MOUNT]] -= ratio * oil
            e_r[at[MOUNT]] += oil
            share = (p_c - p_r - a.drops[pieces[0]]) / (a.drops[pieces[0] + 1] - a.drops[pieces[0]])
            valves.add_share(e_c, at[CHECK] + pieces[0], share, -interval)
            valves.add_share(e_r, at[CHECK] + pieces[0], share, interval)
            share = (-p_c - a.suctions[pieces[1]]) / (a.suctions[pieces[1] + 1] - a.suctions[pieces[1]])
            valves.add_share(e_c, at[REFILL] + pieces[1], share, interval)
            m, share, eases = pieces[2], out[4], interval * out[3]
            valves.add_share(e_r, below + m, share, eases * (1.0 - blend))
            valves.add_share(e_r, above + m, share, eases * blend)
            by_blend = (1.0 - share) * (k[above + m] - k[below + m]) + share * (k[above + m + 1] - k[below + m + 1])
            for p in range(valve):
                e_r[p] += eases * by_blend * (a.rows - 1) * by_setting[p]
            determinant = out[0] * out[2] - out[1] * out[1]
            i_cc, i_cr, i_rr = out[2] / determinant, -out[1] / determinant, out[0] / determinant
            rubs = growth * rubbed if p_r > 0.0 else 0.0
            for p in range(size):
                d_c, d_r = i_cc * e_c[p] + i_cr * e_r[p], i_cr * e_c[p] + i_rr * e_r[p]
                by_c[p] = stored[0] * d_c + stored[1] * d_r
                by_r[p] = stored[1] * d_c + stored[2] * d_r
                row[p] = ratio * d_c - d_r * (1.0 - rubs)
            by_c[at[RATIO]] += s_c
            by_r[at[RATIO]] += s_r
            by_c[at[COMPRESSION]] += p_c
            by_r[at[REBOUND]] += p_r
            by_c[at[MOUNT]] += ratio * oil
            by_r[at[MOUNT]] -= oil
            if scored:
                row[at[RATIO]] += p_c
                for m in range(a.friction):
                    row[at[FRICTION] + m] += rub_by[0, m] * pressed
                    row[at[YIELD] + m] += rub_by[1, m] * pressed
                    row[at[LEAD]] += rub_by[2, m] * pressed
                row[at[GROWTH]] += rubbed * max(p_r, 0.0)
                valves.add_share(row, at[GAS] + i, along, 1.0)
                row[at[VISCOUS]] += drive
                row[at[MASS]] += change
                row[at[LEAD]] += k[at[VISCOUS]] * change
                error = force[n] - score.measured[n]
                valves.add_to_normal_equations(row, score.weights[n], error, matrix, gradients[score.blocks[n]])
    return total, steps
