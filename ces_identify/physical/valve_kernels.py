"""Compiled derivatives of the setting of `ces_observer.tick.valve` by the parameters of the valve."""

from __future__ import annotations

import numpy as np
from numba import njit

from ces_data.arrays import F, I
from ces_identify.numerics.core import core_kernel
from ces_observer.structures.hydraulic import PLAYS
from ces_observer.tick.valve import (
    KEEP, PLAY, PLAY_HALF, VALVE_CURRENTS, VALVE_FALL, VALVE_NODES, VALVE_PART, VALVE_RISE, VALVE_SETTINGS,
)  # fmt: skip

HALVES = np.array(PLAYS)
RISE, FALL, HYSTERESIS, DELAY = 0, 1, 2, 3  # places of the valve's single parameters, before its characteristic
SETTINGS = 4  # place of the first node of the characteristic


@njit(cache=True)
def find_share(p: F, at: int, nodes: int, x: float) -> tuple[int, float]:
    """Return the piece between the nodes of a table of p that holds `x`, and the share of its right node, there."""
    j = 0
    while j < nodes - 2 and x > p[at + j + 1]:
        j += 1
    return j, (x - p[at + j]) / (p[at + j + 1] - p[at + j])


@njit(cache=True)
def add_share(row: F, place: int, share: float, weight: float) -> None:
    """Add the derivative of a value at `share` between two neighbouring nodes, times `weight`."""
    row[place] += weight * (1.0 - share)
    row[place + 1] += weight * share


@core_kernel
def restart_valve(p: F, n: I, current: float, plays: F, by: F) -> None:
    """Begin at a constant current: `plays` (2, plays) and `by` (valve parameters,) are the derivatives' memory."""
    plays[:] = 0.0
    by[:] = 0.0
    j, share = find_share(p, n[VALVE_CURRENTS], n[VALVE_NODES], current)
    add_share(by, SETTINGS + j, min(max(share, 0.0), 1.0), 1.0)


@core_kernel
def differentiate_valve(
    p: F, n: I, s: F, newer: float, older: float, before: F, interval: float, plays: F, by: F
) -> None:
    """Bring `by`, the derivatives of the setting, past a tick; `before` (1 + plays,) are setting and plays before it.

    `newer` and `older` are the currents between which the delay lies. `plays` are the derivatives of the plays by half
    width and delay.
    """
    delayed = newer + p[VALVE_PART] * (older - newer)
    remanent, by_width, by_delay = delayed, 0.0, older - newer
    if p[PLAY_HALF] > 0.0:
        remanent, by_delayed = 0.0, 0.0
        for m in range(len(HALVES)):
            moved = s[PLAY + m] - (delayed + p[KEEP] * (before[1 + m] - delayed))
            if moved != 0.0:
                plays[0, m], plays[1, m] = -HALVES[m] if moved > 0.0 else HALVES[m], older - newer
            else:
                plays[0, m] *= p[KEEP]
                plays[1, m] += (1.0 - p[KEEP]) * (older - newer - plays[1, m])
            remanent += s[PLAY + m]
            by_width += plays[0, m]
            by_delayed += plays[1, m]
        remanent, by_width, by_delay = remanent / len(HALVES), by_width / len(HALVES), by_delayed / len(HALVES)
    nodes, settings = n[VALVE_CURRENTS], n[VALVE_SETTINGS]
    j, share = find_share(p, nodes, n[VALVE_NODES], remanent)
    rise = p[settings + j + 1] - p[settings + j]
    slope = rise / (p[nodes + j + 1] - p[nodes + j]) if 0.0 <= share <= 1.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    change = p[settings + j] + share * rise - before[0]
    lag, gain = (RISE, p[VALVE_RISE]) if change > 0.0 else (FALL, p[VALVE_FALL])
    for m in range(len(by)):
        by[m] *= 1.0 - gain
    add_share(by, SETTINGS + j, share, gain)
    by[HYSTERESIS] += gain * slope * by_width
    by[DELAY] += gain * slope * by_delay
    by[lag] -= gain * gain / interval * change
