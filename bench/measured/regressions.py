"""Regressions as peers, each "series in, free run on another out", on the columns that their users must prepare.

SysIdentPy (FROLS) and fastcan (NARX) know whole powers only, and SysIdentPy no lag 0: its inputs are given
one tick ahead. Boosted trees and Gaussian process get lagged inputs instead of past forces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from bench.measured.ticks import Feed, Simulate
from ces_data.arrays import F
from ces_identify.prepare.series import Series

PLAIN = ("speed", "current", "position")
PREPARED = ("speed", "root", "current", "late current", "position")
WITHOUT_POSITION = PREPARED[:-1]
LAGS_S = (0.0, 1e-3, 2e-3, 4e-3, 6e-3, 9e-3, 13e-3, 18e-3, 25e-3, 35e-3, 50e-3, 70e-3, 0.1, 0.15, 0.25, 0.4)
TREES = 600  # at most, each of 31 leaves
POINTS, TUNED, CLIMBS = 2000, 500, 30  # ticks of a Gaussian process and for its length scales, steps for these
STEPS = 20  # maximum for fastcan's least squares on the free run


@dataclass(frozen=True)
class PeerModel:
    """A peer's model: its free run, and the fit to more data of what it chose, if that is not the same fit again."""

    simulate: Simulate
    refit: Callable[[Sequence[Series]], PeerModel] | None = None


def lag_ticks(reach_s: float, rate_Hz: float) -> list[int]:
    """Return the lags [ticks] up to `reach_s`."""
    return sorted({round(lag * rate_Hz) for lag in LAGS_S if lag <= reach_s})


def lagged_rows(inputs: F, lags: Sequence[int]) -> F:
    """Return the inputs (ticks, k) at all lags, (ticks, k lags)."""
    ticks = np.arange(len(inputs))
    return np.concatenate([inputs[np.maximum(ticks - lag, 0)] for lag in lags], axis=1)


def boosted_trees(
    estimation: Sequence[Series],
    selection: Sequence[Series],
    reach_s: float,
    signals: Sequence[str],
    trees: int = TREES,
) -> PeerModel:
    """scikit-learn's boosted trees, as many as are best for the selection data if there are any."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    feed, lags = Feed.of(signals, estimation), lag_ticks(reach_s, estimation[0].rate_Hz)
    model = HistGradientBoostingRegressor(
        max_iter=trees, learning_rate=0.05, early_stopping=bool(selection), random_state=1
    )
    held_out = dict(zip(("X_val", "y_val"), lagged_data(feed, selection, lags), strict=True)) if selection else {}
    model.fit(*lagged_data(feed, estimation, lags), **held_out)

    def simulate(series: Series) -> F:
        return np.asarray(feed.force_N * model.predict(lagged_rows(feed.columns([series]).inputs, lags)))

    return PeerModel(simulate, lambda data: boosted_trees(data, [], reach_s, signals, model.n_iter_))


def gaussian_process(
    estimation: Sequence[Series], selection: Sequence[Series], reach_s: float, signals: Sequence[str]
) -> PeerModel:
    """scikit-learn's Gaussian process of POINTS ticks at random, with a length scale for each column."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    feed, lags = Feed.of(signals, estimation), lag_ticks(reach_s, estimation[0].rate_Hz)
    x, y = lagged_data(feed, estimation, lags)
    moving = np.ptp(x, axis=0) > 0.0
    chosen = np.random.default_rng(1).permutation(len(y))[:POINTS]
    x, y = x[chosen][:, moving], y[chosen]
    scales = np.full(x.shape[1], np.sqrt(x.shape[1]))
    kernel = ConstantKernel(1.0) * RBF(scales, (0.1, 1e4)) + WhiteKernel(1e-2, (1e-6, 1.0))
    tuned = GaussianProcessRegressor(kernel, optimizer=climb).fit(x[:TUNED], y[:TUNED]).kernel_
    model = GaussianProcessRegressor(tuned, optimizer=None).fit(x, y)

    def simulate(series: Series) -> F:
        rows = lagged_rows(feed.columns([series]).inputs, lags)[:, moving]
        pieces = np.array_split(rows, 1 + len(rows) // 5000)
        return np.asarray(feed.force_N * np.concatenate([model.predict(piece) for piece in pieces]))

    return PeerModel(simulate)


def climb(loss: Any, first: F, bounds: F) -> tuple[F, float]:
    """Return the parameters of a kernel after CLIMBS steps, and their loss."""
    found = minimize(loss, first, jac=True, bounds=bounds, method="L-BFGS-B", options={"maxiter": CLIMBS})
    return found.x, found.fun


def lagged_data(feed: Feed, series: Sequence[Series], lags: Sequence[int]) -> tuple[F, F]:
    """Return lagged inputs and force of the ticks with a force."""
    columns = [feed.columns([one]) for one in series]
    x = np.concatenate([lagged_rows(one.inputs, lags) for one in columns])
    y = np.concatenate([one.force for one in columns])
    return x[np.isfinite(y)], y[np.isfinite(y)]


def frols(
    estimation: Sequence[Series],
    selection: Sequence[Series],
    terms: int,
    signals: Sequence[str] = PREPARED,
    degree: int = 3,
    lags: int = 1,
    past_force: bool = True,
) -> PeerModel:
    """SysIdentPy's forward regression by error reduction ratio."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    feed = Feed.of(signals, estimation)
    model = FROLS(
        order_selection=False,
        n_terms=terms,
        ylag=lags,
        xlag=[list(range(1, 1 + lags))] * len(signals),
        basis_function=Polynomial(degree=degree),
        estimator=LeastSquares(),
        model_type="NARMAX" if past_force else "NFIR",
    )
    columns = feed.columns(estimation)
    model.fit(X=_ahead(columns.inputs), y=_known(columns.force)[:, None])

    def simulate(series: Series) -> F:
        one = feed.columns([series])
        run = np.ravel(model.predict(X=_ahead(one.inputs), y=_known(one.force)[:, None]))
        return np.asarray(feed.force_N * run[: len(series)])

    return PeerModel(simulate)


def fastcan(
    estimation: Sequence[Series],
    selection: Sequence[Series],
    terms: int,
    signals: Sequence[str] = PREPARED,
    degree: int = 3,
    lags: int = 1,
    free_run: bool = False,
) -> PeerModel:
    """fastcan's NARX: terms by one-step errors, then least squares on these or on the free run."""
    from fastcan.narx import make_narx

    feed = Feed.of(signals, estimation)
    columns = feed.columns(estimation)
    x, y = columns.inputs, _known(columns.force)
    quiet = {"verbose": 0, "refine_verbose": 0}
    model = make_narx(x, y, terms, max_delay=lags, poly_degree=degree, **quiet)
    model.fit(x, y, **({"coef_init": "one_step_ahead", "max_nfev": STEPS} if free_run else {}))

    def simulate(series: Series) -> F:
        one = feed.columns([series])
        run = model.predict(one.inputs, y_init=_known(one.force[: model.max_delay_]))
        return np.asarray(feed.force_N * np.ravel(run))

    return PeerModel(simulate)


def _ahead(inputs: F) -> F:
    """Return the inputs one tick ahead, so that lag 1 is now."""
    return np.concatenate([inputs[1:], inputs[-1:]])


def _known(force: F) -> F:
    """Return the force with 0 where none was measured."""
    return np.nan_to_num(force)
