"""Standard errors of a polynomial's coefficients, which allow for errors of the force that go on for some time.

With g the gradients over blocks of SLOWEST_S and H the Gauss-Newton matrix of the free run, the covariance is
H^-1 (sum g g') H^-1 (Ljung, System Identification, 2nd ed., section 9.4; blocks as in Newey and West, 1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ces_data.arrays import F
from ces_identify.limits import ErrorLimits
from ces_identify.prepare.series import Series
from ces_identify.structures import run_batch
from ces_identify.validation.evaluate import Evaluation
from ces_observer.model import Model
from ces_observer.structures.polynomial import Polynomial

STEP = 1e-4  # of a coefficient, by which its influence on the force is found


def standard_errors(model: Model, body: Polynomial, evaluations: Sequence[Evaluation]) -> F:
    """Return the standard error of each coefficient (terms,) from free runs; NaN without any."""
    terms = len(body.terms)
    if not evaluations:
        return np.full(terms, np.nan)
    matrix, spread = np.zeros((terms, terms)), np.zeros((terms, terms))
    for e in evaluations:
        slopes, error = _slopes(model, body, e.series), e.series.force - e.run.force
        good = e.series.scored & np.isfinite(error) & np.isfinite(slopes).all(axis=0)
        matrix += slopes[:, good] @ slopes[:, good].T
        block = np.arange(len(error)) // round(ErrorLimits.SLOWEST_S * e.series.rate_Hz)
        moved = np.where(good, slopes * np.nan_to_num(error), 0.0)
        sums = np.stack([np.bincount(block, row) for row in moved], axis=1)
        spread += sums.T @ sums
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inverse = np.linalg.pinv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0)))


def _slopes(model: Model, body: Polynomial, series: Series) -> F:
    """Return the change of the free run with each coefficient (terms, ticks)."""
    inputs = np.stack([series.position, series.speed, series.current])

    def run(index: int, change: float) -> F:
        terms = list(body.terms)
        terms[index] = replace(terms[index], coefficient=terms[index].coefficient + change)
        return run_batch(replace(model, body=replace(body, terms=tuple(terms))), inputs, series.segments)[0]

    steps = [STEP * abs(term.coefficient) or STEP for term in body.terms]
    return np.stack([(run(i, h) - run(i, -h)) / (2.0 * h) for i, h in enumerate(steps)])
