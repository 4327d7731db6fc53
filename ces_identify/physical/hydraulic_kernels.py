"""Compiled run of a hydraulic network, with derivatives of the force by all parameters.

The steps are those of `ces_observer.tick.hydraulic`, which solves U(P) + T L(P) - a w(P) = kept u(k-1) for the
pressures P, with U the stored volumes, L the flows and a = (r, -1); so by the implicit function theorem, with A the
derivative of the left side, dP = A^-1 (kept du(k-1) - d(U + T L - a w) by the parameters), and du = dU/dP dP + dU.
Volumes and ways are here those of a tick [m].
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F, I
from ces_identify.numerics.core import compile_tick, core_kernel
from ces_identify.physical import valve_kernels as valves
from ces_observer.structures.hydraulic import SPREAD
from ces_observer.tick import hydraulic as tick
from ces_observer.tick import valve as tick_valve
from ces_observer.tick.edges import EDGE_DROPS, EDGE_FLOWS, EDGE_NODES, EDGE_PIECE, EDGE_ROW, EDGE_SHARE, LAST_ROW
from ces_observer.tick.edges import OPENING as OPENINGS
from ces_observer.tick.hydraulic import ACCELERATION, DRIVE, DRIVE_RATE, GAS_NODES, GAS_POSITIONS
from ces_observer.tick.hydraulic import VISCOUS as DRAG
from ces_observer.tick.mount import FRICTION as RUBBED
from ces_observer.tick.mount import MOUNT_GIVE, PULL, SPRING_NUMBERS, SPRING_STATES, SPRINGS, WAY
from ces_observer.tick.pressures import (
    BYPASS_LOGARITHMS, BYPASS_NODES, BYPASS_POSITIONS, COMPLIANCE_C, COMPLIANCE_R, FRICTION_GROWTH, KEPT_VOLUME,
    LAMINAR, NARROW, OIL_C, OIL_R, OIL_SLOPES, OIL_VALUES, PRESSURE_C, PRESSURE_R, SPRING, STILL_N, STORED_C,
    STORED_R, THICKNESS,
)  # fmt: skip
from ces_observer.tick.pressures import RATIO as RATIOS
from ces_observer.tick.valve import KEEP, PLAY, PLAYS, SETTING, VALVE_DELAY, VALVE_NODES

hydraulic_reset, hydraulic_tick = compile_tick(tick.hydraulic_reset), compile_tick(tick.hydraulic_tick)
valve_start = compile_tick(tick_valve.valve_start)

# places in `at` of the first column of each group of parameters; those of the valve come first
LEAD, VISCOUS, MASS, GAS, RATIO, COMPRESSION, REBOUND, MOUNT, CREEP, OIL, PISTON, BASE, EXTERNAL = range(13)
BYPASS, BYPASS_NARROW, STIFFNESS, YIELD, MOVED, GROWTH, LAGS = range(13, 20)
OILS = 2  # absolute pressure of the reservoir [N], and air
ROWS = 64  # of derivatives, before their products are added up
SHARES = np.array([1.0 / SPREAD[0] ** 2, *(1.0 / (a * b) for a, b in pairwise(SPREAD)), 0.0])
AT_REST = np.array([1.0 - 1.0 / t - s * (t - 1.0) for t, s in zip((SPREAD[0], *SPREAD), SHARES, strict=True)])


class Score(NamedTuple):
    """Measured force [N], weights of its error and numbers of its blocks (ticks,); every `stride`-th tick counts."""

    measured: F
    weights: F
    blocks: I
    stride: int


@njit(cache=True)
def add(out: F, scale: float, other: F) -> None:
    """Add `scale` times another array."""
    for q in range(len(out)):
        out[q] += scale * other[q]


@njit(cache=True)
def add_past(by_c: F, by_r: F, by_way: F, by_pull: F, by_0: F, by_1: F, by_2: F, ratio: float, shares: F) -> None:
    """Add what way, position behind the mount and openings of the past change in both balances.

    `shares` (5,): of the way, of the pull, and of the openings of the three edges.
    """
    way, wider, kept_0, kept_1, kept_2 = shares
    for q in range(len(by_c)):
        by_way[q] *= way
        across = wider * by_pull[q] - kept_0 * by_0[q]
        by_c[q] += ratio * by_way[q] + across - kept_1 * by_1[q]
        by_r[q] += -by_way[q] - across - kept_2 * by_2[q]


@njit(cache=True)
def add_limit(by_rub: F, at: I, m: int, setting: float, sign: float, moved: float, by_setting: F) -> None:
    """Add the derivatives of the limit of friction element `m`, times `sign`; `moved` is that by the setting."""
    by_rub[at[YIELD] + m] += sign
    by_rub[at[MOVED] + m] += sign * setting
    for q in range(len(by_setting)):
        by_rub[q] += moved * by_setting[q]


@core_kernel
def differentiate_oil(p: F, piece: int, pressure: float, oil: F, out: F) -> None:
    """Fill `out` (4,) with phi at a pressure [N], its slope, and its derivatives by `oil`: reservoir [N] and air."""
    out[0], out[1] = p[OIL_VALUES + piece] + p[OIL_SLOPES + piece] * pressure, p[OIL_SLOPES + piece]
    out[2], out[3] = oil[1] * AT_REST[piece], oil[0] * AT_REST[piece] + SHARES[piece] * pressure


@core_kernel
def differentiate_edge(p: F, n: I, k: I, m: int, at: int, setting: float, drop: float, opening: float, out: F) -> int:
    """Fill `out` (7,) for edge m at a drop [N] with its steady flow and slope, the share of its piece's right node,
    flow and slope with the lag, the share of the row above, and the drop [N] that is gained with the setting.

    `at` is the column of the edge's first node; returns that of the left node of its piece in the row below. The last
    row is reached from below, so that there always is a row above one that the current moves.
    """
    nodes, last, j = n[EDGE_NODES + m], n[LAST_ROW + m], k[EDGE_PIECE + m]
    row = max(min(k[EDGE_ROW + m], last - 1), 0)
    blend = setting * last - row
    first = row * nodes + j
    below = n[EDGE_DROPS + m] + first
    above = below + nodes if last > 0 else below
    left = p[below] + blend * (p[above] - p[below])
    rise = p[below + 1] + blend * (p[above + 1] - p[below + 1]) - left
    flow = p[n[EDGE_FLOWS + m] + j]
    slope, share, part = (p[n[EDGE_FLOWS + m] + j + 1] - flow) / rise, (drop - left) / rise, p[EDGE_SHARE + m]
    size = abs(drop) + p[LAMINAR]
    root, kept = np.sqrt(size), (1.0 - part) * opening
    out[0], out[1], out[2] = flow + slope * (drop - left), slope, share
    out[3] = part * out[0] + kept * drop / root
    out[4] = part * slope + kept * (0.5 * abs(drop) + p[LAMINAR]) / (size * root)
    out[5] = blend
    out[6] = last * ((1.0 - share) * (p[above] - p[below]) + share * (p[above + 1] - p[below + 1]))
    return int(at + first)


@njit(cache=True)
def add_nodes(by: F, column: int, nodes: int, out: F, weight: float) -> None:
    """Add the derivatives of a flow by the drops at the nodes of its piece, times `weight`; `out` of the edge."""
    valves.add_share(by, column, out[2], weight * (1.0 - out[5]))
    if nodes > 0:
        valves.add_share(by, column + nodes, out[2], weight * out[5])


@core_kernel
def run_network(
    p: F, n: I, s: F, k: I, at: I, oil: F, inputs: F, segments: I, score: Score, force: F, matrix: F, gradients: F
) -> tuple[float, float]:
    """Fill `force` (ticks,) [N] with the free run; return the weighted squared error and the largest pressure [N].

    `inputs` (3, ticks) are position [m], speed [m/s] and current [A], in `segments` (s, 2); `at` are the columns of the
    groups named above, `oil` the reservoir's pressure [N] and air. Adds up the Gauss-Newton matrix (parameters,
    parameters) and, for each block, the gradient of half the squared error in `gradients` (blocks, parameters).
    """
    size, springs = matrix.shape[0], n[SPRINGS]
    interval, ratio, growth, small = 1.0 / p[DRIVE_RATE], p[RATIOS], p[FRICTION_GROWTH], p[LAMINAR]
    spring, mount = p[SPRING], interval * p[MOUNT_GIVE]
    forces, limits, keep, stays = n[SPRING_STATES], n[SPRING_STATES] + springs, p[KEEP], p[KEPT_VOLUME]
    valve, whole = valves.SETTINGS + n[VALVE_NODES], n[VALVE_DELAY]
    plays, by_setting, valve_before = np.zeros((2, PLAYS)), np.zeros(valve), np.zeros(1 + PLAYS)
    by_c, by_r = np.zeros(size), np.zeros(size)
    rows, used_rows = np.zeros((ROWS, size)), 0
    rub, slips = np.zeros(springs), np.zeros(springs, np.int64)
    by_rub, by_pull, by_way = np.zeros((springs, size)), np.zeros(size), np.zeros(size)
    values, drops, columns, above = np.zeros((3, 7)), np.zeros(3), np.zeros(3, np.int64), np.zeros(3, np.int64)
    opened, shares, by_shares, past = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(5)
    by_opened, by_oil, stored = np.zeros((3, size)), np.zeros((2, OILS)), np.zeros((2, 2 + OILS))
    by_0, by_1, by_2 = by_opened[0], by_opened[1], by_opened[2]
    for m in range(3):
        shares[m] = p[EDGE_SHARE + m]
        by_shares[m] = -shares[m] * shares[m] / interval
        above[m] = n[EDGE_NODES + m] if n[LAST_ROW + m] > 0 else 0
    over, by_drop, wanted, kept = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    total, most = 0.0, 0.0
    for segment in range(segments.shape[0]):
        first, stop = segments[segment]
        if stop <= first:
            continue
        hydraulic_reset(p, n, s, k)
        valve_start(p, n, s, k, inputs[2, first])
        valves.restart_valve(p, n, inputs[2, first], plays, by_setting)
        by_c[:], by_r[:], by_pull[:], by_rub[:], by_opened[:] = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(first, stop):
            x, pulled, valve_before[0] = inputs[0, i], s[PULL], s[SETTING]
            for m in range(PLAYS):
                valve_before[1 + m] = s[PLAY + m]
            for m in range(3):
                opened[m] = s[OPENINGS + m]
            for m in range(springs):
                rub[m] = keep * s[forces + m]
            force[i] = hydraulic_tick(p, n, s, k, x, inputs[1, i], inputs[2, i])
            newer, older = inputs[2, max(first, i - whole)], inputs[2, max(first, i - whole - 1)]
            valves.differentiate_valve(p, n, s, newer, older, valve_before, interval, plays, by_setting)
            p_c, p_r, setting, drive, change = s[PRESSURE_C], s[PRESSURE_R], s[SETTING], s[DRIVE], s[ACCELERATION]
            pull, rubbed, way, warmed_s = s[PULL], s[RUBBED], interval * s[WAY], interval / s[THICKNESS]
            most = max(most, abs(p_c), abs(p_r))
            drops[0], drops[1], drops[2] = p_c - p_r, p_c, p_r
            cell_c, cell_r = interval * s[STORED_C], interval * s[STORED_R]
            growth_c, growth_r = s[STORED_C] / p[COMPLIANCE_C], s[STORED_R] / p[COMPLIANCE_R]
            differentiate_oil(p, k[OIL_C], p_c, oil, stored[0])
            differentiate_oil(p, k[OIL_R], p_r, oil, stored[1])
            for m in range(3):
                columns[m] = differentiate_edge(p, n, k, m, at[PISTON + m], setting, drops[m], opened[m], values[m])
            scored = score.weights[i] > 0.0 and i % score.stride == 0
            if scored:
                total += (score.weights[i] * (force[i] - score.measured[i])) ** 2

            # what the step begins with, at pressures that stay: by_c and by_r become those of both balances
            held = 0.0
            for q in range(size):
                by_way[q] = spring * by_pull[q]
                by_c[q] *= stays
                by_r[q] *= stays
            for m in range(springs):
                limit, moved = s[limits + m], p[n[SPRING_NUMBERS] + 2 * springs + m]
                step = p[n[SPRING_NUMBERS] + m]
                for q in range(size):
                    by_rub[m, q] *= keep
                if abs(rub[m]) > limit:
                    sign = 1.0 if rub[m] > 0.0 else -1.0
                    rub[m] = sign * limit
                    by_rub[m] = 0.0
                    add_limit(by_rub[m], at, m, setting, sign, sign * moved, by_setting)
                if abs(rub[m] + step * s[WAY]) > limit:
                    slips[m] = 1 if rub[m] + step * s[WAY] > 0.0 else -1
                    by_rub[m] = 0.0
                    add_limit(by_rub[m], at, m, setting, float(slips[m]), slips[m] * moved, by_setting)
                else:
                    slips[m] = 0
                    held += step / interval
                    by_rub[m, at[STIFFNESS] + m] += way
                add(by_way, -mount, by_rub[m])
            by_way[at[RATIO]] -= mount * p_c
            by_way[at[MOUNT]] -= pull - pulled
            by_way[at[CREEP]] -= interval * pull
            by_way[at[LEAD]] += interval * change
            past[:] = 0.0
            past[0] = 1.0 / (1.0 + mount * held)
            by_c[at[RATIO]] += way
            if n[BYPASS_NODES] > 0:
                nodes, openings = n[BYPASS_POSITIONS], n[BYPASS_LOGARITHMS]
                j, along = valves.find_share(p, nodes, n[BYPASS_NODES], x - spring * pulled)
                inside, along = 0.0 <= along <= 1.0, min(max(along, 0.0), 1.0)
                wider = p[openings + j + 1] - p[openings + j]
                bypass = np.exp(p[openings + j] + along * wider)
                narrow, root = np.sqrt(p[NARROW]), np.sqrt(p[NARROW] + 4.0 * abs(drops[0]))
                passed = 2.0 * warmed_s * drops[0] / (root + narrow)
                less = -0.5 * bypass * passed / (root * narrow)
                wider *= bypass * passed / (p[nodes + j + 1] - p[nodes + j]) if inside else 0.0
                values[0, 3] += bypass * passed / warmed_s
                values[0, 4] += bypass / root
                by_c[at[MOUNT]] += wider * pulled
                by_r[at[MOUNT]] -= wider * pulled
                past[1] = wider * spring
                by_c[at[BYPASS_NARROW]] -= less
                by_r[at[BYPASS_NARROW]] += less
                for q in range(2):
                    more = bypass * np.exp(-p[openings + j + q]) * (along if q else 1.0 - along) * passed
                    by_c[at[BYPASS] + j + q] -= more
                    by_r[at[BYPASS] + j + q] += more
            by_c[at[COMPRESSION]] -= growth_c * stored[0, 0]
            by_r[at[REBOUND]] -= growth_r * stored[1, 0]
            by_c[at[COMPRESSION] + 1] -= x * cell_c * stored[0, 0]
            by_r[at[REBOUND] + 1] -= x * cell_r * stored[1, 0]
            for m in range(OILS):
                by_oil[0, m], by_oil[1, m] = cell_c * stored[0, 2 + m], cell_r * stored[1, 2 + m]
                by_c[at[OIL] + m] -= by_oil[0, m]
                by_r[at[OIL] + m] -= by_oil[1, m]
            for m in range(3):
                eases = warmed_s * shares[m] * values[m, 1]
                rooted = drops[m] / np.sqrt(abs(drops[m]) + small)
                by_lag = warmed_s * by_shares[m] * (values[m, 0] - opened[m] * rooted)
                past[2 + m] = warmed_s * (1.0 - shares[m]) * rooted
                steeper = eases * values[m, 6]
                if m < 2:
                    by_c[at[LAGS] + m] -= by_lag
                    add_nodes(by_c, columns[m], above[m], values[m], eases)
                if m != 1:
                    sign = -1.0 if m == 0 else 1.0
                    by_r[at[LAGS] + m] -= sign * by_lag
                    add_nodes(by_r, columns[m], above[m], values[m], sign * eases)
                if above[m] > 0:
                    for q in range(valve):
                        if m < 2:
                            by_c[q] += steeper * by_setting[q]
                        if m != 1:
                            by_r[q] += (-steeper if m == 0 else steeper) * by_setting[q]
            add_past(by_c, by_r, by_way, by_pull, by_0, by_1, by_2, ratio, past)

            # the pressures follow from the balances, and all else from them
            wide_c, wide_r = cell_c * stored[0, 1], cell_r * stored[1, 1]
            own_c, own_r = wide_c + warmed_s * values[1, 4], wide_r + warmed_s * values[2, 4]
            joint = warmed_s * values[0, 4]
            eased = mount / (1.0 + mount * held)
            a_c, a_r, both = own_c + joint + ratio * ratio * eased, own_r + joint + eased, joint + ratio * eased
            determinant = own_c * (own_r + joint + eased) + own_r * (joint + ratio * ratio * eased)
            determinant += joint * eased * (ratio - 1.0) ** 2
            i_cc, i_cr, i_rr = a_r / determinant, both / determinant, a_c / determinant
            for m in range(3):
                if abs(drops[m]) >= STILL_N:
                    over[m] = np.sqrt(abs(drops[m]) + small)
                    wanted[m] = values[m, 0] * over[m] / drops[m]
                    by_drop[m] = values[m, 1] * over[m] / drops[m] - wanted[m] / drops[m]
                    by_drop[m] = shares[m] * (by_drop[m] + 0.5 * values[m, 0] / (over[m] * abs(drops[m])))
                    over[m], kept[m] = over[m] / drops[m], 1.0 - shares[m]
                else:
                    wanted[m], by_drop[m], over[m], kept[m] = opened[m], 0.0, 0.0, 1.0
            by_p_r = growth * rubbed if p_r > 0.0 else 0.0
            row = rows[used_rows]
            for q in range(size):
                d_c, d_r = i_cc * by_c[q] + i_cr * by_r[q], i_cr * by_c[q] + i_rr * by_r[q]
                by_c[q], by_r[q] = wide_c * d_c, wide_r * d_r
                by_pull[q] = ratio * d_c - d_r
                row[q] = by_pull[q] + d_r * by_p_r
                by_way[q] -= eased * by_pull[q]
                by_0[q] = kept[0] * by_0[q] + by_drop[0] * (d_c - d_r)
                by_1[q] = kept[1] * by_1[q] + by_drop[1] * d_c
                by_2[q] = kept[2] * by_2[q] + by_drop[2] * d_r
            for m in range(3):
                by_flow = shares[m] * over[m] * values[m, 1]
                by_opened[m, at[LAGS] + m] += by_shares[m] * (wanted[m] - opened[m])
                add_nodes(by_opened[m], columns[m], above[m], values[m], -by_flow)
                if above[m] > 0:
                    for q in range(valve):
                        by_opened[m, q] -= by_flow * values[m, 6] * by_setting[q]
            by_pull[at[RATIO]] += p_c
            row[at[RATIO]] += p_c
            pressed = 1.0 + growth * max(p_r, 0.0)
            for m in range(springs):
                if slips[m] == 0:
                    add(by_rub[m], p[n[SPRING_NUMBERS] + m] / interval, by_way)
                add(by_pull, 1.0, by_rub[m])
                if scored:
                    add(row, pressed, by_rub[m])
            by_c[at[COMPRESSION]] += growth_c * stored[0, 0]
            by_r[at[REBOUND]] += growth_r * stored[1, 0]
            by_c[at[COMPRESSION] + 1] += x * cell_c * stored[0, 0]
            by_r[at[REBOUND] + 1] += x * cell_r * stored[1, 0]
            for m in range(OILS):
                by_c[at[OIL] + m] += by_oil[0, m]
                by_r[at[OIL] + m] += by_oil[1, m]
            if scored:
                row[at[GROWTH]] += rubbed * max(p_r, 0.0)
                j, along = valves.find_share(p, n[GAS_POSITIONS], n[GAS_NODES], x)
                valves.add_share(row, at[GAS] + j, along, 1.0)
                row[at[VISCOUS]] += drive
                row[at[MASS]] += change
                row[at[LEAD]] += p[DRAG] * change
                weight, error = score.weights[i], force[i] - score.measured[i]
                gradient = gradients[score.blocks[i]]
                for q in range(size):
                    row[q] *= weight
                    gradient[q] += row[q] * weight * error
                used_rows += 1
                if used_rows == ROWS:
                    matrix += np.dot(rows.T, rows)
                    used_rows = 0
    if used_rows > 0:
        last_rows = rows[:used_rows]
        matrix += np.dot(last_rows.T, last_rows)
    return total, most
