"""Autocorrelated noise: identified from simulated autoregressions, and whitened."""

from __future__ import annotations

import numpy as np
import pytest
from gap_traces import ar, ar_noise
from numpy.typing import NDArray

from ces_gap.baseline.learner import make_white_noise, noise_of

F = NDArray[np.float64]
EVERYWHERE = np.ones(40000, bool)


def simulated(pole: float, seed: int = 1, rms_N: float = 8.0) -> F:
    return ar_noise(len(EVERYWHERE), rms_N, pole, np.random.default_rng(seed))


def autocorrelation(values: F, lag: int) -> float:
    return float(values[:-lag] @ values[lag:] / (values @ values))


@pytest.mark.parametrize("pole", [0.0, 0.7, -0.5, 0.97])
def test_simulated_noise_is_identified_and_whitened(pole: float) -> None:
    values = simulated(pole)
    noise = noise_of([values], [EVERYWHERE])
    assert noise.ar[0] == pytest.approx(pole, abs=0.03)
    np.testing.assert_allclose(noise.ar[1:], 0.0, atol=0.03)
    assert noise.rms_N == pytest.approx(8.0, rel=0.1)
    assert noise.innovation_N == pytest.approx(8.0 * np.sqrt(1.0 - pole**2), rel=0.02)
    flat = noise.whiten(values)[len(noise.ar) :]
    assert flat.std() == pytest.approx(1.0, abs=0.02)
    assert max(abs(autocorrelation(flat, lag)) for lag in range(1, 20)) < 4.0 / np.sqrt(len(flat))


def test_whitening_is_linear_and_works_column_by_column() -> None:
    noise = ar(8.0, 0.6)
    columns = np.stack([simulated(0.6, 1), simulated(0.6, 2)], axis=1)
    np.testing.assert_allclose(noise.whiten(columns)[:, 1], noise.whiten(columns[:, 1]))
    np.testing.assert_allclose(noise.whiten(columns @ [2.0, -3.0]), noise.whiten(columns) @ [2.0, -3.0], atol=1e-9)


def test_white_noise_is_only_scaled() -> None:
    values = simulated(0.0)
    np.testing.assert_allclose(make_white_noise(4.0).whiten(values), values / 4.0)


def test_only_usable_ticks_count() -> None:
    usable = np.arange(len(EVERYWHERE)) % 4000 > 400
    spoiled = np.where(usable, simulated(0.7), 1e6)
    noise = noise_of([spoiled], [usable])
    assert noise.rms_N == pytest.approx(8.0, rel=0.05)
    assert noise.ar[0] == pytest.approx(0.7, abs=0.03)


def test_a_whitened_value_is_usable_if_it_depends_on_usable_ticks_only() -> None:
    noise = noise_of([simulated(0.7)], [EVERYWHERE], order=3)
    usable = np.ones(20, bool)
    usable[[10]] = False
    assert np.flatnonzero(~noise.usable_after_whitening(usable)).tolist() == [0, 1, 2, 10, 11, 12, 13]
    values, spoiled = np.arange(20.0), np.where(usable, np.arange(20.0), 1e6)
    clean = noise.usable_after_whitening(usable)
    np.testing.assert_array_equal(noise.whiten(values)[clean], noise.whiten(spoiled)[clean])


def test_zero_residuals_give_finite_noise() -> None:
    noise = noise_of([np.zeros(500)], [np.ones(500, bool)])
    assert np.isfinite(noise.whiten(np.ones(500))).all()
    assert noise.rms_N < 1e-3
