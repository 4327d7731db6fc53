"""Compiled drive and valve path of `ces_observer.structures.physical`, each with its derivatives by the parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F, I
from ces_observer.structures.physical import PLAYS

HALVES = np.array(PLAYS)
RISE, FALL, HYSTERESIS, DELAY = 0, 1, 2, 3  # places of the valve's single numbers, before its characteristic
SETTING = 4  # place of the first node of the characteristic


class RunData(NamedTuple):
    """Inputs (ticks,) of a run, limited as the estimator limits them, and its segments (s, 2)."""

    position: F
    speed: F
    current: F
    segments: I


class Score(NamedTuple):
    """Measured force [N], weights of its error and numbers of its blocks (ticks,); every `stride`-th tick counts."""

    measured: F
    weights: F
    blocks: I
    stride: int


@njit(cache=True)
def find_piece(nodes: F, x: float) -> int:
    """Return the index of the piece between `nodes` that holds `x`."""
    j = 0
    while j < len(nodes) - 2 and x > nodes[j + 1]:
        j += 1
    return j


@njit(cache=True)
def add_share(row: F, place: int, share: float, weight: float) -> None:
    """Add the derivative of a value at `share` between two neighbouring nodes, times `weight`."""
    row[place] += weight * (1.0 - share)
    row[place + 1] += weight * share


@njit(cache=True)
def restart_valve(k: F, nodes: F, current: float, plays: F, by: F) -> float:
    """Return the setting at a constant current; `plays` (3, plays) and `by` (valve parameters,) are its memory."""
    plays[0] = current
    plays[1:] = 0.0
    by[:] = 0.0
    j = find_piece(nodes, current)
    share = (current - nodes[j]) / (nodes[j + 1] - nodes[j])
    if share < 0.0 or share > 1.0:
        share = min(max(share, 0.0), 1.0)
    if len(by) > 0:
        add_share(by, SETTING + j, share, 1.0)
    return float(k[SETTING + j] + share * (k[SETTING + j + 1] - k[SETTING + j]))


@njit(cache=True)
def advance_valve(
    k: F, nodes: F, current: F, first: int, n: int, interval: float, setting: float, plays: F, by: F
) -> float:
    """Return the setting after tick `n` of a segment that begins at `first`; `k` are the parameters.

    `plays` are the positions of the plays and their derivatives by half width and delay; `by` the setting's, empty if
    not wanted.
    """
    whole = int(k[DELAY])
    part = k[DELAY] - whole
    newer, older = current[max(first, n - whole)], current[max(first, n - whole - 1)]
    delayed, by_delay = newer + part * (older - newer), older - newer
    if k[HYSTERESIS] > 0.0:
        remanent, by_width, by_delayed = 0.0, 0.0, 0.0
        for m in range(len(HALVES)):
            half = k[HYSTERESIS] * HALVES[m]
            if plays[0, m] < delayed - half:
                plays[0, m], plays[1, m], plays[2, m] = delayed - half, -HALVES[m], by_delay
            elif plays[0, m] > delayed + half:
                plays[0, m], plays[1, m], plays[2, m] = delayed + half, HALVES[m], by_delay
            remanent += plays[0, m]
            by_width += plays[1, m]
            by_delayed += plays[2, m]
        remanent, by_width, by_delay = remanent / len(HALVES), by_width / len(HALVES), by_delayed / len(HALVES)
    else:
        remanent, by_width = delayed, 0.0
    j = find_piece(nodes, remanent)
    share = (remanent - nodes[j]) / (nodes[j + 1] - nodes[j])
    slope = (k[SETTING + j + 1] - k[SETTING + j]) / (nodes[j + 1] - nodes[j])
    if share < 0.0 or share > 1.0:
        share, slope = min(max(share, 0.0), 1.0), 0.0
    target = k[SETTING + j] + share * (k[SETTING + j + 1] - k[SETTING + j])
    lag = RISE if target > setting else FALL
    gain = interval / (k[lag] + interval)
    if len(by) == 0:
        return float(setting + gain * (target - setting))
    for m in range(len(by)):
        by[m] *= 1.0 - gain
    add_share(by, SETTING + j, share, gain)
    by[HYSTERESIS] += gain * slope * by_width
    by[DELAY] += gain * slope * by_delay
    by[lag] -= gain / (k[lag] + interval) * (target - setting)
    return float(setting + gain * (target - setting))


@njit(cache=True)
def acceleration(speed: F, first: int, n: int, interval: float, limit: float) -> float:
    """Return the limited acceleration [m/s^2] at tick `n` of a segment that begins at `first`."""
    change = (speed[n] - speed[n - 1]) / interval if n > first else 0.0
    return min(max(change, -limit), limit)
