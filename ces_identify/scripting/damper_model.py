"""A damper model with the interface of scikit-learn's estimators, so that its searches, scores and pipelines apply.

scikit-learn is not needed: without it, this is a class with `fit`, `predict` and `score`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ces_data.arrays import F
from ces_data.logs.frame import is_frame
from ces_data.reading import SIGNALS, as_recordings
from ces_data.recording import Recording as Logged
from ces_identify.options import IdentifyRequest
from ces_identify.scripting.model import Model
from ces_identify.scripting.recording import Recording
from ces_identify.simulations.simulate import sample_run
from ces_observer.errors import CesError

try:
    from sklearn.base import BaseEstimator, RegressorMixin
    from sklearn.exceptions import NotFittedError
except ImportError:
    NotFittedError = ValueError

    class RegressorMixin:  # type: ignore[no-redef]
        """Nothing."""

    class BaseEstimator:  # type: ignore[no-redef]
        """Nothing."""


class NotIdentifiedError(CesError, NotFittedError):  # type: ignore[misc]
    """A model that was not identified yet."""


class DataError(CesError, ValueError):
    """What is given in place of recordings is none; a ValueError as scikit-learn expects it."""


COLUMNS = ("time_s", "position_m", "current_A")


class DamperModel(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """Identifies a model: `fit`, then `predict` its forces, `score` them.

    Options are those of `ces identify`. X is a list of recordings, which hold the measured force, or, with forces y
    (n,) [N], a DataFrame or an array (n, 3) of times [s], positions [m] and currents [A]. After a fit, `model_` is the
    `Model`.

        cross_val_score(DamperModel(terms=12), recordings, cv=3)
    """

    def __init__(self, structure: str = "auto", **options: Any) -> None:
        self.structure = structure
        self.options = options

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the structure and the options that were given."""
        return {"structure": self.structure, **self.options}

    def set_params(self, **params: Any) -> Self:
        """Change the structure, or options, which `fit` checks."""
        self.structure = params.pop("structure", self.structure)
        self.options = {**self.options, **params}
        return self

    def fit(self, X: Any, y: ArrayLike | None = None) -> Self:
        """Identify the model on all of the recordings. Raises CesError if they hold too little, or what is wrong."""
        request = IdentifyRequest.of({"split": 1.0, "structure": self.structure, **self.options})
        self.model_ = Model.identify(request, _as_recordings(X, y), ())
        self.n_features_in_ = len(COLUMNS)
        return self

    def predict(self, X: Any) -> F | list[F]:
        """Return the simulated force [N] (n,), or those of each recording, also in the warm-up, where it is a guess."""
        self._fitted()
        forces = [self._force(recording) for recording in _as_recordings(X, needs_force=False)]
        return forces if _is_list(X) else forces[0]

    def score(self, X: Any, y: ArrayLike | None = None) -> float:
        """Return 1 - (J / 100)^2 over all recordings, the share of the force's variance that the model explains."""
        costs = [e.cost for e in self._fitted().validate(_as_recordings(X, y))]
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


def _is_list(X: Any) -> bool:
    """Return whether X is a list of recordings, or one of them, and no array of rows."""
    return isinstance(X, Logged | str) or (
        isinstance(X, Sequence) and len(X) > 0 and not np.isscalar(X[0]) and np.ndim(X[0]) != 1
    )


def _as_recordings(X: Any, y: ArrayLike | None = None, needs_force: bool = True) -> Sequence[Logged]:
    """Return the recordings in X, or the one in its rows with the forces y. Raises CesError."""
    if _is_list(X):
        return as_recordings(X, need=SIGNALS if needs_force else SIGNALS[:2])
    if is_frame(X):
        return as_recordings(X if y is None else X.assign(force_N=y), need=SIGNALS if needs_force else SIGNALS[:2])
    if hasattr(X, "toarray"):
        raise DataError("X is sparse; expected an array (n, 3), or a list of recordings")
    rows, forces = np.asarray(X, dtype=np.float64), None if y is None else np.asarray(y, dtype=np.float64)
    if needs_force and forces is None:
        raise DataError("y is missing (y=None); expected the measured forces [N], (n,)")
    if not np.isfinite(rows).all() or (forces is not None and not np.isfinite(forces).all()):
        raise DataError("X or y holds NaN or infinity; expected numbers")
    if rows.ndim != 2 or rows.shape[1] != len(COLUMNS):
        raise DataError(f"X has shape {rows.shape}; expected (n, 3): {', '.join(COLUMNS)}; or a list of recordings")
    if forces is not None and forces.shape != rows.shape[:1]:
        raise DataError(f"y has shape {forces.shape}; expected {rows.shape[:1]}, a force for each row of X")
    return [Recording.from_arrays(rows[:, 0], rows[:, 1], rows[:, 2], forces)]
