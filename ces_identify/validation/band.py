"""The band around a model's force: its half-width, fitted on recordings, and run over series by the vehicle's tick.

The bands of a run differ in what they weigh, not in their time constants, so they share one state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import nnls

from ces_data.arrays import F, I, Mask
from ces_identify.limits import BandLimits, FoldLimits, TickLimits
from ces_identify.numerics.core import compile_tick, core_kernel
from ces_identify.prepare.series import Series
from ces_identify.simulations.simulate import simulate_series
from ces_observer import flat
from ces_observer.model import PARTS, STATE, Band, Model
from ces_observer.structures.structure import Range
from ces_observer.tick import band as tick
from ces_observer.tick.model import BAND_STARTED, GAP_LOW, K_STRUCTURE, N_STRUCTURE, P_STRUCTURE, S_STRUCTURE

BAND_TICK, HALF_WIDTH = compile_tick(tick.band_tick), compile_tick(tick.band_half_width)
NOWHERE = tuple((0.0,) * length for length in range(len(STATE), 0, -1))  # the whitening of a band that does not grow


def band_half_width(band: Band, series: Series, force: F, gap_A: Range | None = None) -> F:
    """Return the half-width [N] of `band` around the free run `force` (ticks,) of `series`, NaN where that is NaN.

    It is NaN, too, at currents within `gap_A`, where none was recorded.
    """
    return np.asarray(run_bands([band], series, force, gap_A)[0][0])


def band_state(band: Band, series: Series) -> F:
    """Return the state (5, ticks) of `ces_observer.model.STATE`."""
    return run_bands([band], series, np.zeros(len(series)))[1]


def parts_and_growth(band: Band, other: Band, series: Series, force: F) -> tuple[F, F]:
    """Return what the weights of a band multiply (parts, ticks), and the growth (ticks,) of another band, `other`."""
    units = np.eye(len(PARTS))
    flat_bands = [replace(band, parts=tuple(row), whitening=NOWHERE, constant_share=1.0) for row in units]
    width, _ = run_bands([*flat_bands, replace(other, parts=tuple(units[0] + units[1]))], series, force)
    return width[:-1], width[-1]


def run_bands(bands: Sequence[Band], series: Series, force: F, gap_A: Range | None = None) -> tuple[F, F]:
    """Return half-widths (bands, ticks) [N] around a free run `force` (ticks,) [N], and the state (5, ticks)."""
    layouts = [flat.ArrayLayout(P_STRUCTURE, N_STRUCTURE, S_STRUCTURE, K_STRUCTURE) for _ in bands]
    for band, layout in zip(bands, layouts, strict=True):
        band.fill(layout, series.rate_Hz)
        layout.put(GAP_LOW, gap_A or ())
    inputs = np.vstack([series.inputs, force])
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


CHANGE_S = 0.01  # [s] over which speed, current and force change: valve and oil of a damper take about as long
REVERSAL_S = 0.02  # [s] after a reversal, in which friction and pressure build up
MIN_SPREAD = 1e-6  # [m, m/s, A]: a state that changes less counts as constant
MIN_SIZE = 1e-3  # of an error's prediction, relative to the mean error
MAX_TICKS = 200_000  # whose errors are kept, evenly spaced, in each way of leaving data out
MAX_FITTED_TICKS = 20_000  # of these, in the least squares fit
ROUNDS = 6  # of reweighted least squares
MAX_STEPS = 1000  # of each
RIDGE = 1e-4  # of the state's correlation matrix: directions that the recordings hardly have
FIGURES = 6

PLAIN = Band(  # whose weights and state are not known yet
    BandLimits.LEVEL, CHANGE_S, REVERSAL_S, 1.0, (0.0, 1.0), (0.0,) * len(PARTS),
    (0.0,) * len(STATE), NOWHERE, BandLimits.MAX_DISTANCE, 1.0,
)  # fmt: skip

Refit = Callable[[F], Model | None]
"""Fits the model's parameters again with a weight of 0 or 1 for each tick (stacked series); None if that fails."""


@dataclass(frozen=True)
class _Errors:
    """Sizes [N] (n,) of errors, over the growth predicted there, and the parts of the band (parts, n)."""

    size: F
    parts: F


def fit_band(
    model: Model,
    series: Sequence[Series],
    refit: Refit | None = None,
    leave_out_recordings: bool = True,
    threads: int = 1,
) -> Band | None:
    """Return the band of `model`, which was identified on `series`; None if these hold too little.

    Without `leave_out_recordings`, the structure has physics inside: only stretches are left out, and the band hardly
    grows with the distance from the recordings.
    """
    scored = [s.scored for s in series]
    if sum(int(mask.sum()) for mask in scored) < TickLimits.MIN_ERRORS:
        return None
    share = BandLimits.CONSTANT_SHARE if leave_out_recordings else BandLimits.PHYSICAL_SHARE
    band = _describe_state(series, scored, share)
    ways: list[_Errors] = []
    if refit is not None:
        errors_without = partial(_errors_without, refit, series, band)
        held_out = [masks_by_stretch(series)]
        if leave_out_recordings and len(series) > 1:
            held_out.insert(0, masks_by_recording(series, BandLimits.MAX_PARTS))
        for parts in held_out:
            with ThreadPoolExecutor(max(1, threads)) as pool:
                results = list(pool.map(errors_without, parts))
            ways.append(_join([errors for errors in results if errors is not None]))
    ways = [errors for errors in ways if len(errors.size) >= TickLimits.MIN_ERRORS]
    ways = ways or [_errors_on(model, series, scored, band, band)]
    return _fit_parts(band, ways) if len(ways[0].size) >= TickLimits.MIN_ERRORS else None


def masks_by_recording(series: Sequence[Series], most: int) -> list[list[Mask]]:
    """Return at most so many parts of the ticks, each as a mask for each series: groups of whole recordings."""
    groups = min(len(series), most)
    return [[np.full(len(s), i % groups == group) for i, s in enumerate(series)] for group in range(groups)]


def masks_by_stretch(series: Sequence[Series]) -> list[list[Mask]]:
    """Return parts of the ticks, each as a mask for each series: a stretch of every recording."""
    count = FoldLimits.STRETCHES
    return [[count * np.arange(len(s)) // len(s) == k for s in series] for k in range(count)]


def _errors_without(refit: Refit, series: Sequence[Series], band: Band, out: Sequence[Mask]) -> _Errors | None:
    """Return the errors on the ticks left `out` of a model fitted to the others; None if that fails."""
    kept = [s.scored & ~mask for s, mask in zip(series, out, strict=True)]
    if sum(int(mask.sum()) for mask in kept) < TickLimits.MIN_ERRORS:
        return None
    model = refit(np.where(np.concatenate(out), 0.0, 1.0))
    if model is None:
        return None
    scored = [s.scored & mask for s, mask in zip(series, out, strict=True)]
    return _errors_on(model, series, scored, band, _describe_state(series, kept, band.constant_share))


def _errors_on(model: Model, series: Sequence[Series], ticks: Sequence[Mask], band: Band, data: Band) -> _Errors:
    """Return the errors of a model on some ticks, with their distance from the data that `data` describes.

    Ticks after a divergence have no error and are left out.
    """
    rows, step = [], -(-sum(map(len, series)) // MAX_TICKS)
    for recorded, mask in zip(series, ticks, strict=True):
        force = simulate_series(model, recorded).force if mask.any() else np.full(len(recorded), np.nan)
        usable = mask & np.isfinite(force) & (np.arange(len(recorded)) % step == 0)
        parts, growth = parts_and_growth(band, data, recorded, force)
        rows.append(_Errors((np.abs(recorded.force - force) / growth)[usable], parts[:, usable]))
    return _join(rows)


def _join(rows: Sequence[_Errors]) -> _Errors:
    sizes = np.concatenate([np.empty(0), *(row.size for row in rows)])
    return _Errors(sizes, np.concatenate([np.empty((len(PARTS), 0)), *(row.parts for row in rows)], axis=1))


def _describe_state(series: Sequence[Series], ticks: Sequence[Mask], constant_share: float) -> Band:
    """Return a band with the mean and spread of the states on some ticks, all weights zero."""
    states = [band_state(PLAIN, s)[:, mask] for s, mask in zip(series, ticks, strict=True)]
    state = np.concatenate(states, axis=1)
    mean, speed, current = state.mean(axis=1), state[STATE.index("speed")], state[STATE.index("current")]
    return replace(
        PLAIN,
        speed_m_s=max(_round(np.sqrt(np.mean(speed**2))), MIN_SPREAD),
        current_A=(_round(current.min()), _round(current.max())),
        mean=_round_all(mean),
        whitening=tuple(_round_all(row[i:]) for i, row in enumerate(_whitening(state - mean[:, None]))),
        constant_share=constant_share,
    )


def _whitening(deviations: F) -> F:
    """Return the upper triangular matrix that gives `deviations` (5, ticks) a root mean square length of 1."""
    spread = deviations.std(axis=1)
    constant = spread <= MIN_SPREAD
    scaled = deviations / np.where(constant, MIN_SPREAD, spread)[:, None]
    correlation = scaled @ scaled.T / scaled.shape[1] + RIDGE * np.eye(len(scaled))
    correlation[np.diag_indices_from(correlation)] += constant
    upper = np.linalg.cholesky(np.linalg.inv(correlation)).T
    return np.asarray(upper / np.where(constant, MIN_SPREAD, spread) / np.sqrt(len(scaled)))


def _fit_parts(band: Band, ways: Sequence[_Errors]) -> Band:
    """Return the band with weights fitted to all errors, scaled so that it holds LEVEL of those of each way."""
    errors = _join(ways)
    some = slice(None, None, -(-len(errors.size) // MAX_FITTED_TICKS))
    weights = _fit_sizes(errors.parts[:, some], errors.size[some])
    scores = [way.size / np.maximum(weights @ way.parts, 1e-9) for way in ways]
    scale = max(float(np.quantile(score, band.level)) for score in scores)
    return replace(band, parts=_round_all(scale * weights))


def _fit_sizes(parts: F, sizes: F) -> F:
    """Return non-negative weights (parts,) whose sums predict `sizes` (n,), each error relative to its prediction."""
    scale = np.maximum(parts.mean(axis=1), 1e-12)
    least = MIN_SIZE * float(sizes.mean()) + 1e-12
    predicted = np.full(len(sizes), float(sizes.mean()) + least)
    weights = np.zeros(len(parts))
    for _ in range(ROUNDS):
        weights = nnls((parts / scale[:, None] / predicted).T, sizes / predicted, maxiter=MAX_STEPS)[0] / scale
        predicted = np.maximum(weights @ parts, least)
    return np.asarray(weights)


def _round_all(numbers: F) -> tuple[float, ...]:
    return tuple(map(_round, numbers))


def _round(number: float) -> float:
    """Return the number with FIGURES significant figures, so that the model file stays readable."""
    return float(f"{number:.{FIGURES}g}")
