"""Information: the fast formulas equal the slow ones, and more rows never make anything less known."""

from __future__ import annotations

import numpy as np
import pytest

from ces_rig.experiments.information import ERROR_VARIANCE, Information

COUNT = 12


def slow_covariance(rows: np.ndarray) -> np.ndarray:
    """Return the posterior covariance by inverting the information matrix."""
    return np.linalg.inv(np.eye(COUNT) + rows.T @ rows / ERROR_VARIANCE)


def test_added_rows_give_the_inverse_of_the_information_matrix() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.standard_normal((7, COUNT)), rng.standard_normal((5, COUNT))
    information = Information.none(COUNT).add(first).add(second)
    assert information.covariance == pytest.approx(slow_covariance(np.concatenate([first, second])), abs=1e-10)


def test_the_gain_is_the_fall_of_the_weighted_mean_variance() -> None:
    rng = np.random.default_rng(2)
    known, rows, targets = (rng.standard_normal((n, COUNT)) for n in (4, 6, 30))
    weights = rng.random(30)
    before = Information.none(COUNT).add(known)
    after = before.add(rows)
    fall = np.average(before.variance(targets) - after.variance(targets), weights=weights)
    assert before.gain(rows, before.weigh(targets, weights)) == pytest.approx(fall, rel=1e-9)


def test_more_rows_cover_more() -> None:
    rng = np.random.default_rng(3)
    targets = 0.5 * rng.standard_normal((50, COUNT))
    shares = [Information.none(COUNT).add(rng.standard_normal((n, COUNT))).coverage(targets) for n in (0, 40, 4000)]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
