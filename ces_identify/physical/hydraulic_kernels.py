"""Compiled free run of a hydraulic network, with derivatives of the force by all parameters.

The equations are those of `ces_observer.structures.hydraulic`. A step solves U(P) + T L(P) - a w(P) = u(k-1) for the
pressures P, with U the stored volumes, L the flows and a = (r, -1); so by the implicit function theorem, with A the
derivative of the left side, dP = A^-1 (du(k-1) - d(U + T L - a w) by the parameters), and du = dU/dP dP + dU.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ces_data.arrays import F
from ces_identify.physical import valve_kernels as valves
from ces_identify.physical.network_step import (
    BASE,
    BYPASS,
    COMPRESSION,
    CREEP,
    EXTERNAL,
    FADE,
    FRICTION,
    GAS,
    GROWTH,
    LAGS,
    LEAD,
    MASS,
    MOUNT,
    MOVED,
    NARROW,
    OIL,
    OILS,
    PISTON,
    RATIO,
    REBOUND,
    VISCOUS,
    YIELD,
    NetworkArrays,
    add_limit,
    look_up,
    slide,
    solve_step,
    store,
)
from ces_observer.structures.hydraulic import STILL_N, WARMEST, WARMING_S

ROWS = 64  # of derivatives, before their products are added up


@njit(cache=True)
def add(out: F, scale: float, other: F) -> None:
    """Add `scale` times another array."""
    for q in range(len(out)):
        out[q] += scale * other[q]


@njit(cache=True)
def add_past(
    by_c: F, by_r: F, by_way: F, by_heat: F, by_pull: F, by_0: F, by_1: F, by_2: F, ratio: float, shares: F
) -> None:
    """Add what way, heat, position behind the mount and openings of the past change in both balances.

    `shares` (7,): of the way, of heat in both, of the pull, and of the openings of the three edges.
    """
    way, hot_c, hot_r, wider, kept_0, kept_1, kept_2 = shares
    for q in range(len(by_c)):
        by_way[q] *= way
        across = wider * by_pull[q] - kept_0 * by_0[q]
        by_c[q] += ratio * by_way[q] - hot_c * by_heat[q] + across - kept_1 * by_1[q]
        by_r[q] += -by_way[q] - hot_r * by_heat[q] - across - kept_2 * by_2[q]


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
    valve = 4 + len(a.currents) if fitted else 0
    plays, by_setting = np.zeros((3, len(valves.HALVES))), np.zeros(valve)
    by_c, by_r = np.zeros(size), np.zeros(size)
    rows, used_rows = np.zeros((ROWS if fitted else 1, size)), 0
    rub, limits, slips = np.zeros(a.friction), np.zeros(a.friction), np.zeros(a.friction, np.int64)
    by_rub, by_pull, by_way = np.zeros((a.friction, size)), np.zeros(size), np.zeros(size)
    by_heat, fade, warming = np.zeros(size), k[at[FADE]], interval / (WARMING_S + interval)
    cells, start, values, pieces = np.zeros(5), np.zeros(2), np.zeros((3, 5)), np.zeros(5, np.int64)
    openings, opened, shares, drops = np.zeros(4), np.zeros(3), np.ones(3), np.zeros(3)
    by_opened, by_shares, past = np.zeros((3, size)), np.zeros(3), np.zeros(7)
    by_0, by_1, by_2 = by_opened[0], by_opened[1], by_opened[2]
    over, by_drop, wanted, kept_open, before = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for m in range(3):
        shares[m] = interval / (k[at[LAGS] + m] + interval)
        by_shares[m] = -shares[m] / (k[at[LAGS] + m] + interval)
    stored, rest, by_oil = np.zeros((2, 2 + OILS)), np.zeros(2 + OILS), np.zeros((2, OILS))
    below, above, blends = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3)
    edges = np.array([at[PISTON], at[BASE], at[EXTERNAL]])
    spring, mount = k[at[MOUNT]], k[at[MOUNT]] + interval * k[at[CREEP]]  # a tick's creep gives way like a spring
    at_rest = store(oil, 0.0, stored, 0)
    rest[:] = stored[0]
    total, steps, most, bypasses = 0.0, 0, 0.0, len(a.bypassed) > 0
    along_bypass, j, inside = 0.0, 0, False
    for s in range(data.segments.shape[0]):
        first, stop = data.segments[s]
        if stop <= first:
            continue
        setting = valves.restart_valve(k, a.currents, data.current[first], plays, by_setting)
        start[:] = 0.0
        last_c, last_r = 0.0, 0.0
        by_c[:] = 0.0
        by_r[:] = 0.0
        rub[:] = 0.0
        by_rub[:] = 0.0
        by_pull[:] = 0.0
        by_heat[:] = 0.0
        pull, heat = 0.0, 0.0
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
                behind = data.position[n] - spring * pull
                j = valves.find_piece(a.bypassed, behind)
                along_bypass = (behind - a.bypassed[j]) / (a.bypassed[j + 1] - a.bypassed[j])
                inside = 0.0 <= along_bypass <= 1.0
                along_bypass = min(max(along_bypass, 0.0), 1.0)
                openings[3] = k[at[BYPASS] + j] ** (1.0 - along_bypass) * k[at[BYPASS] + j + 1] ** along_bypass
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
            warm = fade * heat
            warmed_s = interval * np.exp(min(max(warm, -WARMEST), WARMEST))
            p_c, p_r, way, held, used = solve_step(
                a, warmed_s, cells, below, above, blends, shares, openings, start, pieces, values, drops, oil, stored,
                rub, limits, slips,
            )  # fmt: skip
            if not (abs(p_c) <= a.most_N and abs(p_r) <= a.most_N):
                p_c, p_r = min(max(p_c, -a.most_N), a.most_N), min(max(p_r, -a.most_N), a.most_N)
                drops[0], drops[1], drops[2] = p_c - p_r, p_c, p_r
                for m in range(3):
                    pieces[m] = look_up(k, a.flows, below[m], above[m], blends[m], drops[m], pieces[m], values, m)
                pieces[3], pieces[4] = store(oil, p_c, stored, 0), store(oil, p_r, stored, 1)
                way, held, _ = slide(
                    cells[4] - mount * (ratio * p_c - p_r), mount,
                    k[at[FRICTION] : at[FRICTION] + a.friction], rub, limits, slips,
                )  # fmt: skip
            start[0], start[1] = 2.0 * p_c - last_c, 2.0 * p_r - last_r
            last_c, last_r = p_c, p_r
            steps += used
            most = max(most, abs(p_c), abs(p_r))
            pulled_s = ratio * p_c - p_r
            u_c, u_r = cells[0] * stored[0, 0], cells[1] * stored[1, 0]
            pulled, rubbed = pull, 0.0
            if fitted:
                for q in range(size):
                    by_way[q] = spring * by_pull[q]
            for m in range(a.friction):
                stiffness = k[at[FRICTION] + m]
                if fitted and slips[m] == 0:
                    by_rub[m, at[FRICTION] + m] += way
                    add(by_way, -mount, by_rub[m])
                elif fitted:
                    sign = float(slips[m])
                    by_rub[m] = 0.0
                    add_limit(by_rub[m], at, m, setting, sign, sign * k[at[MOVED] + m], by_setting)
                    add(by_way, -mount, by_rub[m])
                rub[m] = rub[m] + stiffness * way if slips[m] == 0 else slips[m] * limits[m]
                rubbed += rub[m]
            pull = pulled_s + rubbed
            power = pull * drive
            heat += warming * (abs(power) - heat)
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
            past[:] = 0.0
            past[0] = 1.0 / (1.0 + mount * held)
            by_c[at[RATIO]] += way
            if abs(warm) <= WARMEST:
                before_heat = (heat - warming * abs(power)) / (1.0 - warming)
                more_c, more_r = warmed_s * (values[0, 3] + values[1, 3]), warmed_s * (values[2, 3] - values[0, 3])
                by_c[at[FADE]] -= more_c * before_heat
                by_r[at[FADE]] -= more_r * before_heat
                past[1], past[2] = more_c * fade, more_r * fade
            by_c[at[COMPRESSION]] -= growth_c * stored[0, 0]
            by_r[at[REBOUND]] -= growth_r * stored[1, 0]
            by_c[at[COMPRESSION] + 1] -= x * cells[0] * stored[0, 0]
            by_r[at[REBOUND] + 1] -= x * cells[1] * stored[1, 0]
            for m in range(OILS):
                by_oil[0, m], by_oil[1, m] = cells[0] * stored[0, 2 + m], cells[1] * stored[1, 2 + m]
                by_c[at[OIL] + m] -= by_oil[0, m]
                by_r[at[OIL] + m] -= by_oil[1, m]
            for m in range(3):
                eases, share, blend, p = warmed_s * shares[m] * values[m, 1], values[m, 2], blends[m], pieces[m]
                root = np.sqrt(abs(drops[m]) + a.small_N)
                rooted = drops[m] / root
                by_lag = warmed_s * by_shares[m] * (values[m, 0] - opened[m] * rooted)
                past[4 + m] = warmed_s * (1.0 - shares[m]) * rooted
                if m < 2:
                    by_c[at[LAGS] + m] -= by_lag
                if m != 1:
                    by_r[at[LAGS] + m] -= -by_lag if m == 0 else by_lag
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
                narrow = np.sqrt(k[at[NARROW]])
                root = np.sqrt(k[at[NARROW]] + 4.0 * abs(drop))
                passed = 2.0 * warmed_s * drop / (root + narrow)
                less = -0.5 * openings[3] * passed / (root * narrow)
                wider = openings[3] * np.log(k[at[BYPASS] + j + 1] / k[at[BYPASS] + j])
                wider *= passed / (a.bypassed[j + 1] - a.bypassed[j]) if inside else 0.0
                by_c[at[MOUNT]] += wider * pulled
                by_r[at[MOUNT]] -= wider * pulled
                past[3] = wider * spring
                by_c[at[NARROW]] -= less
                by_r[at[NARROW]] += less
                for p in range(2):
                    more = openings[3] / k[at[BYPASS] + j + p] * (along_bypass if p else 1.0 - along_bypass) * passed
                    by_c[at[BYPASS] + j + p] -= more
                    by_r[at[BYPASS] + j + p] += more
            add_past(by_c, by_r, by_way, by_heat, by_pull, by_0, by_1, by_2, ratio, past)
            wide_c, wide_r = cells[0] * stored[0, 1], cells[1] * stored[1, 1]
            own_c, own_r = wide_c + warmed_s * values[1, 4], wide_r + warmed_s * values[2, 4]
            joint = warmed_s * values[0, 4]
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
                by_0[p] = kept_open[0] * by_0[p] + by_drop[0] * (d_c - d_r)
                by_1[p] = kept_open[1] * by_1[p] + by_drop[1] * d_c
                by_2[p] = kept_open[2] * by_2[p] + by_drop[2] * d_r
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
                    add(by_rub[m], k[at[FRICTION] + m], by_way)
                add(by_pull, 1.0, by_rub[m])
                if scored:
                    add(row, pressed, by_rub[m])
            warms = (warming if power > 0.0 else -warming) * drive
            for q in range(size):
                by_heat[q] = (1.0 - warming) * by_heat[q] + warms * by_pull[q]
            by_heat[at[LEAD]] += (warming if power > 0.0 else -warming) * pull * change
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
