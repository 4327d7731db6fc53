"""The peers, each as "recordings in, free run on another out", with the inputs that their users must prepare.

SysIdentPy (FROLS, MetaMSS) and fastcan (NARX) know whole powers only, and SysIdentPy no lag 0: its inputs are given
one tick ahead. Boosted trees get lags instead of past forces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

F = NDArray[np.float64]
Simulate = Callable[["Columns"], F]

TERMS = 12
TREES = 600  # at most, each of 31 leaves
TREE_LAGS = ((0, 1, 2, 4, 8, 16, 32), (0, 2, 5, 10, 20, 40, 80, 160, 320))  # ticks
STEPS = 20  # maximum for fastcan's least squares on the free run
SEARCH = {"maxiter": 10, "n_agents": 6, "p_ones": 0.3, "p_zeros": 0.7, "random_state": 3}  # of MetaMSS


@dataclass(frozen=True)
class Columns:
    """Inputs (ticks, k), one column each, and the measured force (ticks,) [N]."""

    inputs: F
    force: F


@dataclass(frozen=True)
class PeerModel:
    """A peer's model: how to run it freely, and the number of its terms (or parameters)."""

    simulate: Simulate
    terms: int


def frols(
    estimation: Columns, selection: Columns, terms: int = TERMS, degree: int = 3, past_force: bool = True
) -> PeerModel:
    """SysIdentPy's forward regression by error reduction ratio; it does not use `selection`."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    del selection
    model = FROLS(
        order_selection=False,
        n_terms=terms,
        ylag=1,
        xlag=[[1]] * estimation.inputs.shape[1],
        basis_function=Polynomial(degree=degree),
        estimator=LeastSquares(),
        model_type="NARMAX" if past_force else "NFIR",
    )
    model.fit(X=_ahead(estimation.inputs), y=estimation.force[:, None])
    return PeerModel(_simulate_with(model), len(model.final_model))


def metamss(estimation: Columns, selection: Columns, degree: int = 3) -> PeerModel:
    """SysIdentPy's search by free run: fits on `estimation`, evaluates on `selection`."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import MetaMSS
    from sysidentpy.parameter_estimation import LeastSquares

    _mend_numpy()
    model = MetaMSS(
        ylag=1,
        xlag=[[1]] * estimation.inputs.shape[1],
        basis_function=Polynomial(degree=degree),
        estimator=LeastSquares(),
        test_size=0.5,
        **SEARCH,
    )
    model.fit(
        X=np.concatenate([_ahead(estimation.inputs), _ahead(selection.inputs)]),
        y=np.concatenate([estimation.force, selection.force])[:, None],
    )
    return PeerModel(_simulate_with(model), len(model.final_model))


def fastcan_model(estimation: Columns, terms: int = TERMS, degree: int = 3) -> Any:
    """Return fastcan's NARX, selected on the one-step errors and not yet fitted."""
    from fastcan.narx import make_narx

    return make_narx(
        estimation.inputs, estimation.force, terms, max_delay=1, poly_degree=degree, verbose=0, refine_verbose=0
    )


def fastcan_one_step(estimation: Columns, selection: Columns, terms: int = TERMS, degree: int = 3) -> PeerModel:
    """fastcan's selection, then least squares on measured past forces."""
    del selection
    return _wrap_fastcan(fastcan_model(estimation, terms, degree).fit(estimation.inputs, estimation.force), terms)


def fastcan_free_run(estimation: Columns, selection: Columns, terms: int = TERMS, degree: int = 3) -> PeerModel:
    """fastcan's selection, then least squares on the free run."""
    del selection
    model = fastcan_model(estimation, terms, degree)
    model.fit(estimation.inputs, estimation.force, coef_init="one_step_ahead", max_nfev=STEPS)
    return _wrap_fastcan(model, terms)


def boosted_trees(estimation: Columns, selection: Columns, lags: Sequence[int] = TREE_LAGS[0]) -> PeerModel:
    """scikit-learn's boosted trees on inputs now and late, without past forces; it stops by the selection data."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    def rows(data: Columns) -> F:
        ticks = np.arange(len(data.force))
        return np.concatenate([data.inputs[np.maximum(ticks - lag, 0)] for lag in lags], axis=1)

    model = HistGradientBoostingRegressor(max_iter=TREES, learning_rate=0.05, early_stopping=True, random_state=1)
    model.fit(rows(estimation), estimation.force, X_val=rows(selection), y_val=selection.force)
    leaves = sum(tree.get_n_leaf_nodes() for trees in model._predictors for tree in trees)
    return PeerModel(lambda data: np.asarray(model.predict(rows(data))), leaves)


def _simulate_with(model: Any) -> Simulate:
    return lambda data: np.ravel(model.predict(X=_ahead(data.inputs), y=data.force[:, None]))


def _wrap_fastcan(model: Any, terms: int) -> PeerModel:
    return PeerModel(
        lambda data: np.asarray(model.predict(data.inputs, y_init=data.force[: model.max_delay_])), terms + 1
    )


def _ahead(inputs: F) -> F:
    """Return the inputs one tick ahead, so that lag 1 is now."""
    return np.concatenate([inputs[1:], inputs[-1:]])


def _mend_numpy() -> None:
    """Provide the function that MetaMSS of SysIdentPy 0.9 calls by a name removed in NumPy 2.4."""
    if not hasattr(np, "in1d"):
        np.in1d = np.isin  # type: ignore[attr-defined, unused-ignore]  # noqa: NPY201
