"""A damper model with the interface of scikit-learn's estimators, so that its searches, scores and pipelines apply.

scikit-learn is not needed: without it, this is a class with `fit`, `predict` and `score`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import wraps
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ces_data.arrays import F
from ces_data.logs.frame import is_frame
from ces_data.reading import SIGNALS, as_recordings, is_table
from ces_data.recording import Recording as Logged
from ces_identify.options import IdentifyRequest
from ces_identify.prepare.series import prepare
from ces_identify.scripting.model import Model, identify_model
from ces_identify.scripting.recording import Recording
from ces_identify.simulations.simulate import sample_run
from ces_identify.validation.evaluate import VALIDATION, evaluate
from ces_observer.errors import CesError, suggest

try:
    from sklearn.base import BaseEstimator, RegressorMixin
    from sklearn.exceptions import NotFittedError
except ImportError:
    NotFittedError = ValueError

    class RegressorMixin:  # type: ignore[no-redef]
        """Nothing."""

    class BaseEstimator:  # type: ignore[no-redef]
        """What a user of scikit-learn expects of every estimator."""

        def get_params(self, deep: bool = True) -> dict[str, Any]:
            """Return the parameters by name."""
            return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

        def __repr__(self) -> str:
            given = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
            changed = [f for f in fields(self) if given[f.name] != f.default]  # type: ignore[arg-type]
            return f"{type(self).__name__}({', '.join(f'{f.name}={given[f.name]!r}' for f in changed)})"


class OptionError(CesError, TypeError):
    """An option that there is not; a TypeError as Python expects it."""


class NotIdentifiedError(CesError, NotFittedError):  # type: ignore[misc]
    """A model that was not identified yet."""


class DataError(CesError, ValueError):
    """What is given in place of recordings is none; a ValueError as scikit-learn expects it."""


T = TypeVar("T")
COLUMNS = ("time_s", "position_m", "current_A")


def _require_options(model: T) -> T:
    """Return a dataclass that raises OptionError for an option that it has not."""
    made: Any = model
    make = made.__init__

    @wraps(make)
    def init(self: Any, *args: Any, **options: Any) -> None:
        known = [field.name for field in fields(made)]
        if unknown := next((name for name in options if name not in known), ""):
            raise OptionError(f"{unknown}: is no option of {made.__name__}{suggest(unknown, known)}")
        make(self, *args, **options)

    made.__init__ = init
    return model


@_require_options
@dataclass(eq=False, repr=False)
class DamperModel(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """Identifies a model: `fit`, then `predict` its forces, `score` them.

    Parameters are the options of `ces identify`, which `fit` checks; None is the program's default. X is a list of
    recordings (paths, DataFrames, ...), which hold the measured force, or one of them, or, with forces y (n,) [N], an
    array (n, 3) of times [s], positions [m] and currents [A]. After a fit, `model_` is the `Model`.

        cross_val_score(DamperModel(terms=12), recordings, cv=3)
    """

    structure: str = "auto"
    time: float | None = None
    starts: int | None = None
    seed: int | None = None
    target: float | None = None
    threads: int | None = None
    certificate: bool | None = None
    forget: float | None = None
    band: bool | None = None
    method: str | None = None
    terms: int | None = None
    candidates: Any = None
    blend: Any = None
    units: int | None = None
    lags: int | None = None
    rules: int | None = None
    kind: str | None = None
    curves: int | None = None
    experts: int | None = None
    split: float | None = None
    speed: str | None = None
    weight: Any = None
    rate: float | None = None
    delay: float | None = None
    ignore_findings: bool | None = None

    def fit(self, X: Any, y: ArrayLike | None = None) -> Self:
        """Identify the model on all of the recordings. Raises CesError if they hold too little, or what is wrong."""
        options = {field.name: getattr(self, field.name) for field in fields(self)}
        request = IdentifyRequest.of({**options, "split": 1.0 if self.split is None else self.split})
        self.model_ = identify_model(request, _as_recordings(X, y), ())
        self.n_features_in_ = len(COLUMNS)
        return self

    def predict(self, X: Any) -> F | list[F]:
        """Return the simulated force [N] (n,), or those of each recording, also in the warm-up, where it is a guess."""
        self._fitted()
        forces = [self._force(recording) for recording in _as_recordings(X, needs_force=False)]
        return forces if _is_several(X) or len(forces) > 1 else forces[0]

    def score(self, X: Any, y: ArrayLike | None = None) -> float:
        """Return 1 - mean((J / 100)^2) over all recordings, the share of the force's variance that is explained."""
        model = self._fitted()
        series = [prepare(recording, model.sampling) for recording in _as_recordings(X, y)]
        costs = [evaluation.cost for evaluation in evaluate(model, series, VALIDATION)]
        return 1.0 - float(np.mean(np.square(costs))) * 1e-4

    def _fitted(self) -> Model:
        if not hasattr(self, "model_"):
            raise NotIdentifiedError("this DamperModel is not fitted yet; call fit first")
        model: Model = self.model_
        return model

    def _force(self, recording: Logged) -> F:
        run = sample_run(self._fitted(), recording)
        force = np.where(run.newest >= 0, run.run.force[run.newest], np.nan)
        known = np.flatnonzero(np.isfinite(force))
        return np.interp(np.arange(len(force)), known, force[known])


def _is_one(X: Any) -> bool:
    """Return whether X is a recording, and no array of rows."""
    return isinstance(X, Logged | str | os.PathLike) or is_table(X)


def _is_several(X: Any) -> bool:
    return isinstance(X, list | tuple | np.ndarray) and len(X) > 0 and _is_one(X[0])


def _as_recordings(X: Any, y: ArrayLike | None = None, needs_force: bool = True) -> Sequence[Logged]:
    """Return the recordings in X, or the one in its rows with the forces y. Raises CesError."""
    if hasattr(X, "toarray"):
        raise DataError("X is sparse; expected an array (n, 3), or a list of recordings")
    if is_table(X) and y is not None:
        X = X.assign(force_N=y) if is_frame(X) else {**X, "force_N": y}
    if _is_one(X) or _is_several(X):
        return as_recordings(list(X) if _is_several(X) else X, need=SIGNALS if needs_force else SIGNALS[:2])
    if np.iscomplexobj(X):
        raise DataError("Complex data not supported: X and y are real")
    rows, forces = np.asarray(X, dtype=np.float64), None if y is None else np.asarray(y, dtype=np.float64)
    if needs_force and forces is None:
        raise DataError("a fit requires y to be passed, but the target y is None: the measured forces [N], (n,)")
    if not np.isfinite(rows).all() or (forces is not None and not np.isfinite(forces).all()):
        raise DataError("X or y holds NaN or infinity; expected numbers")
    if rows.ndim != 2 or rows.shape[1] != len(COLUMNS) or not len(rows):
        sizes = "n_samples = {}, n_features = {}".format(*rows.shape) if rows.ndim == 2 else f"shape {rows.shape}"
        raise DataError(f"X has {sizes}; expected (n, 3): {', '.join(COLUMNS)}; or a list of recordings")
    if forces is not None and forces.shape != rows.shape[:1]:
        raise DataError(f"y has shape {forces.shape}; expected {rows.shape[:1]}, a force for each row of X")
    return [Recording.from_arrays(rows[:, 0], rows[:, 1], rows[:, 2], forces)]
