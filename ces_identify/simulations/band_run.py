"""The band over whole series: the vehicle's own tick, compiled, for one band or for several at once.

The bands of a call differ in what they weigh, not in their time constants, so they share one state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics.core import compiled, core_kernel
from ces_identify.prepare.series import Series
from ces_observer import flat
from ces_observer.band import PARTS, STATE, Band
from ces_observer.tick import band as tick
from ces_observer.tick.model import BAND_STARTED, K_STRUCTURE, N_STRUCTURE, P_STRUCTURE, S_STRUCTURE

BAND_TICK, HALF_WIDTH = compiled(tick.band_tick), compiled(tick.band_half_width)
NOWHERE = tuple((0.0,) * length for length in range(len(STATE), 0, -1))  # the whitening of a band that does not grow


def band_half_width(band: Band, series: Series, force: F) -> F:
    """Return the half-width [N] of `band` around the free run `force` (ticks,) of `series`, NaN where that is NaN."""
    return np.asarray(run_bands([band], series, force)[0][0])


def band_state(band: Band, series: Series) -> F:
    """Return the state (5, ticks) of `ces_observer.band.STATE`."""
    return run_bands([band], series, np.zeros(len(series)))[1]


def parts_and_growth(band: Band, known: Band, series: Series, force: F) -> tuple[F, F]:
    """Return what the weights of a band multiply (parts, ticks), and the growth (ticks,) of another band, `known`."""
    units = np.eye(len(PARTS))
    flat_bands = [replace(band, parts=tuple(row), whitening=NOWHERE, constant_share=1.0) for row in units]
    width, _ = run_bands([*flat_bands, replace(known, parts=tuple(units[0] + units[1]))], series, force)
    return width[:-1], width[-1]


def run_bands(bands: Sequence[Band], series: Series, force: F) -> tuple[F, F]:
    """Return half-widths (bands, ticks) [N] around a free run `force` (ticks,) [N], and the state (5, ticks)."""
    layouts = [flat.ArrayLayout(P_STRUCTURE, N_STRUCTURE, S_STRUCTURE, K_STRUCTURE) for _ in bands]
    for band, layout in zip(bands, layouts, strict=True):
        band.fill(layout, series.rate_Hz)
    inputs = np.stack([series.position, series.speed, series.current, force])
    width, state = np.empty((len(bands), len(series))), np.empty((len(STATE), len(series)))
    p = np.array([layout.p for layout in layouts])
    _run_bands(p, np.zeros(S_STRUCTURE), np.zeros(K_STRUCTURE, np.int64), inputs, series.segments, width, state)
    return width, state


@core_kernel
def _run_bands(p: F, s: F, k: I, inputs: F, segments: I, width: F, state: F) -> None:
    for segment in range(len(segments)):
        k[BAND_STARTED] = 0
        for i in range(segments[segment, 0], segments[segment, 1]):
            BAND_TICK(p[0], s, k, inputs[0, i], inputs[1, i], inputs[2, i], inputs[3, i])
            for row in range(len(p)):
                width[row, i] = HALF_WIDTH(p[row], s)
            state[0, i] = inputs[0, i]
            state[1, i] = inputs[1, i]
            state[2, i] = inputs[2, i]
            state[3, i] = inputs[1, i] - s[tick.BAND_MEAN_SPEED]
            state[4, i] = inputs[2, i] - s[tick.BAND_MEAN_CURRENT]
