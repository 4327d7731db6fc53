"""Compiled free run of relaxation models, with derivatives of the force by all parameters.

The equations are those of `ces_observer.structures.relaxation`; the derivatives follow from the implicit function
theorem: with F(q, y(k-1), parameters) = 0 the step, dq = -(dF/dy(k-1) dy(k-1) + dF/dparameters) / (dF/dq).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F, I
from ces_identify.physical import valve_kernels as valves

MAX_STEPS = 200
CLOSE = 1e-13
LEAD, VISCOUS, MASS, COMPLIANCE, LEAK, GAS, STIFFNESS, YIELD, MAP = 0, 1, 2, 3, 4, 5, 6, 7, 8  # of `places`


class RelaxationArrays(NamedTuple):
    """A relaxation model as arrays: `k` (parameters,) with the valve's first, and the nodes of its curves.

    `places` are the indices in `k` of the groups named above; each group's rows follow each other.
    """

    k: F
    places: I
    currents: F
    speeds: F
    positions: F
    rows: int
    springs: int
    interval_s: float
    max_acceleration: float


@njit(cache=True)
def stretch_from_middle(a: RelaxationArrays, position: float, stretch: F, by_stretch: F) -> float:
    """Fill the springs' forces (springs,) [N] at a start and their derivatives (springs, parameters); return the sum.

    Springs that do not yield within the stroke are stretched from mid-stroke, the others are free.
    """
    stretch[:] = 0.0
    by_stretch[:] = 0.0
    low, high = a.positions[0], a.positions[-1]
    away = position - 0.5 * (low + high)
    for m in range(a.springs):
        least = a.places[YIELD] + m
        for n in range(1, a.rows):
            place = a.places[YIELD] + n * a.springs + m
            if a.k[place] < a.k[least]:
                least = place
        stiffness = a.k[a.places[STIFFNESS] + m]
        if a.k[least] >= stiffness * (high - low):
            if abs(stiffness * away) <= a.k[least]:
                stretch[m] = stiffness * away
                by_stretch[m, a.places[STIFFNESS] + m] = away
            else:
                stretch[m] = a.k[least] if away > 0.0 else -a.k[least]
                by_stretch[m, least] = 1.0 if away > 0.0 else -1.0
    return float(stretch.sum())


@njit(cache=True, nogil=True)
def run_relaxation(
    a: RelaxationArrays, data: valves.RunData, score: valves.Score, force: F, matrix: F, gradients: F
) -> tuple[float, int]:
    """Fill `force` (ticks,) [N]; return the weighted squared error and the number of Newton steps.

    If `matrix` (parameters, parameters) has rows, also add up the Gauss-Newton matrix (its upper triangle) and, for
    each block, the gradient of half the squared error, in `gradients` (blocks, parameters).
    """
    k, at, interval = a.k, a.places, a.interval_s
    size, fitted = len(k), matrix.shape[0] > 0
    compliance, leak = k[at[COMPLIANCE]], k[at[LEAK]]
    held = compliance + interval * leak
    wide, nodes = len(a.speeds), a.speeds
    valve = 4 + len(a.currents)
    plays, by_setting = np.zeros((3, len(valves.HALVES))), np.zeros(valve)
    by_force, by_stretch = np.zeros(size), np.zeros((a.springs, size))
    direct, row = np.zeros(size), np.zeros(size)
    stretch, limits, states = np.zeros(a.springs), np.zeros(a.springs), np.zeros(a.springs, np.int64)
    total, steps = 0.0, 0
    for s in range(data.segments.shape[0]):
        first, stop = data.segments[s]
        if stop <= first:
            continue
        setting = valves.restart_valve(k, a.currents, data.current[first], plays, by_setting)
        passed = 0.0
        oil = stretch_from_middle(a, data.position[first], stretch, by_stretch)
        for p in range(size):
            by_force[p] = by_stretch[:, p].sum()
        for n in range(first, stop):
            setting = valves.advance_valve(k, a.currents, data.current, first, n, interval, setting, plays, by_setting)
            change = valves.acceleration(data.speed, first, n, interval, a.max_acceleration)
            drive = data.speed[n] + k[at[LEAD]] * change
            lower = min(int(setting * (a.rows - 1)), a.rows - 2)
            blend = setting * (a.rows - 1) - lower
            below = at[MAP] + lower * wide
            above = below + wide
            for m in range(a.springs):
                place = at[YIELD] + lower * a.springs + m
                limits[m] = k[place] + blend * (k[place + a.springs] - k[place])
            target = interval * drive + compliance * oil
            low, high = -np.inf, np.inf
            j, slope, piece, value, left, excess = 0, 0.0, 0.0, 0.0, 0.0, 0.0
            for _ in range(MAX_STEPS):
                j = valves.find_piece(nodes, passed)
                left = k[below + j] + blend * (k[above + j] - k[below + j])
                right = k[below + j + 1] + blend * (k[above + j + 1] - k[below + j + 1])
                piece = (right - left) / (nodes[j + 1] - nodes[j])
                value, slope = left + piece * (passed - nodes[j]), piece
                for m in range(a.springs):
                    step = interval * k[at[STIFFNESS] + m]
                    pulled = stretch[m] + step * passed
                    if pulled > limits[m]:
                        states[m] = 1
                        value += limits[m]
                    elif pulled < -limits[m]:
                        states[m] = -1
                        value -= limits[m]
                    else:
                        states[m] = 0
                        value += pulled
                        slope += step
                excess = held * value + interval * passed - target
                move = excess / (held * slope + interval)
                steps += 1
                if abs(move) <= CLOSE * (1.0 + abs(passed)):
                    break
                if excess > 0.0:
                    high = passed
                else:
                    low = passed
                new = passed - move
                passed = new if low < new < high else 0.5 * (low + high)
            else:
                value = np.nan  # no force rather than a wrong one
            i = valves.find_piece(a.positions, data.position[n])
            along = (data.position[n] - a.positions[i]) / (a.positions[i + 1] - a.positions[i])
            gas = k[at[GAS] + i] + along * (k[at[GAS] + i + 1] - k[at[GAS] + i])
            force[n] = value + gas + k[at[VISCOUS]] * drive + k[at[MASS]] * change
            scored = score.weights[n] > 0.0 and n % score.stride == 0
            if scored:
                total += (score.weights[n] * (force[n] - score.measured[n])) ** 2
            if fitted:
                share = (passed - nodes[j]) / (nodes[j + 1] - nodes[j])
                direct[:] = 0.0
                valves.add_share(direct, below + j, share, 1.0 - blend)
                valves.add_share(direct, above + j, share, blend)
                by_blend = (1.0 - share) * (k[above + j] - k[below + j])
                by_blend += share * (k[above + j + 1] - k[below + j + 1])
                for m in range(a.springs):
                    place = at[YIELD] + lower * a.springs + m
                    if states[m] == 0:
                        for p in range(size):
                            direct[p] += by_stretch[m, p]
                        direct[at[STIFFNESS] + m] += interval * passed
                    else:
                        direct[place] += states[m] * (1.0 - blend)
                        direct[place + a.springs] += states[m] * blend
                        by_blend += states[m] * (k[place + a.springs] - k[place])
                for p in range(valve):
                    direct[p] += by_blend * (a.rows - 1) * by_setting[p]
                for p in range(size):
                    row[p] = compliance * by_force[p] - held * direct[p]
                row[at[COMPLIANCE]] += oil - value
                row[at[LEAK]] -= interval * value
                row[at[LEAD]] += interval * change
                for p in range(size):
                    row[p] /= held * slope + interval
                    by_force[p] = direct[p] + slope * row[p]
                for m in range(a.springs):
                    if states[m] == 0:
                        for p in range(size):
                            by_stretch[m, p] += interval * k[at[STIFFNESS] + m] * row[p]
                        by_stretch[m, at[STIFFNESS] + m] += interval * passed
                    else:
                        place = at[YIELD] + lower * a.springs + m
                        by_stretch[m] = 0.0
                        by_stretch[m, place] = states[m] * (1.0 - blend)
                        by_stretch[m, place + a.springs] = states[m] * blend
                        widens = states[m] * (k[place + a.springs] - k[place]) * (a.rows - 1)
                        for p in range(valve):
                            by_stretch[m, p] += widens * by_setting[p]
                if scored:
                    for p in range(size):  # a loop compiles faster than an assignment of arrays
                        row[p] = by_force[p]
                    valves.add_share(row, at[GAS] + i, along, 1.0)
                    row[at[VISCOUS]] += drive
                    row[at[MASS]] += change
                    row[at[LEAD]] += k[at[VISCOUS]] * change
                    error = force[n] - score.measured[n]
                    valves.add_to_normal_equations(row, score.weights[n], error, matrix, gradients[score.blocks[n]])
            for m in range(a.springs):
                pulled = stretch[m] + interval * k[at[STIFFNESS] + m] * passed
                stretch[m] = min(max(pulled, -limits[m]), limits[m])
            oil = value
    return total, steps
