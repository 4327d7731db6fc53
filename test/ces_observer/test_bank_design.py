"""Motion, gains and smoothing of one kind of stroke, against SciPy and a filter that carries its past states along."""

from math import exp

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov, solve_discrete_are

from ces_observer import bank_design as kalman
from ces_observer.bank_design import free_motion, join, smoothing_gains, speed_predictor, stationary

ANGLES = (2e-3, 0.02, 0.3, 2.5)  # 0.3 Hz at 1 kHz to near half the rate
POSITION, SPEED = [1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0, 0.0]


def drift():
    """The matrix A of the stroke's state in units of its angle."""
    a = np.diag(np.ones(4), 1)
    a[4, 1:] = -np.poly(np.roots(np.polymul(*([1.0, 2.0 * damping, 1.0] for damping in kalman.SHAPE))))[:0:-1]
    return a


def arrays(motion):
    return np.array(motion.advance), np.array(motion.noise)


@pytest.mark.parametrize("angle", ANGLES)
def test_free_motion_is_the_exponential_and_keeps_the_speeds_variance(angle):
    a, advance, noise = drift(), *arrays(free_motion(angle, 3.0))
    np.testing.assert_allclose(advance, expm(a * angle), rtol=1e-12, atol=1e-12)
    density = np.diag([0.0, 0.0, 0.0, 1.0])
    speeds = solve_continuous_lyapunov(a[1:, 1:], -density)
    speeds *= 3.0 / speeds[0, 0]
    np.testing.assert_allclose(
        advance[1:, 1:] @ speeds @ advance[1:, 1:].T + noise[1:, 1:], speeds, rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("angle", ANGLES)
def test_motions_one_after_another_are_one_motion(angle):
    parts = join(free_motion(0.25 * angle, 3.0), free_motion(0.75 * angle, 3.0))
    for found, whole in zip(arrays(parts), arrays(free_motion(angle, 3.0)), strict=True):
        np.testing.assert_allclose(found, whole, rtol=1e-10, atol=1e-10 * abs(whole).max())


@pytest.mark.parametrize("angle", ANGLES)
def test_speed_predictor_continues_the_free_speed(angle):
    advance, state = arrays(free_motion(angle, 1.0))[0], np.array([0.3, 1.0, -0.7, 0.4, 2.0])
    speeds = [(np.linalg.matrix_power(advance, k) @ state)[1] for k in range(5)]
    assert np.dot(speed_predictor(angle), speeds[3::-1]) == pytest.approx(speeds[4], rel=1e-9)


@pytest.mark.parametrize("rows", [[POSITION], [POSITION, SPEED]], ids=["position", "and speed"])
@pytest.mark.parametrize("relative_noise", [1e-4, 0.1, 30.0])
@pytest.mark.parametrize("angle", ANGLES)
def test_gains_solve_the_riccati_equation(angle, relative_noise, rows):
    noise = [(relative_noise * angle) ** 2, 0.5][: len(rows)]
    motion, h, r = free_motion(angle, 1.0), np.array(rows), np.diag(noise)
    (f, q), found = arrays(motion), stationary(motion, rows, noise)
    p = solve_discrete_are(f.T, h.T, q, r)
    spread = h @ p @ h.T + r
    np.testing.assert_allclose(found.covariance, p, rtol=1e-5, atol=1e-7 * abs(p).max())
    np.testing.assert_allclose(found.spread, spread, rtol=1e-5)
    p = np.array(found.covariance)  # exact to rounding, where SciPy's is not
    gain = np.linalg.solve(h @ p @ h.T + r, h @ p).T
    np.testing.assert_allclose(found.gain, gain, rtol=1e-9, atol=1e-9 * abs(gain).max())
    np.testing.assert_allclose(f @ (p - gain @ h @ p) @ f.T + q, p, rtol=1e-9, atol=1e-13 * abs(p).max())
    assert abs(np.linalg.eigvals(f @ (np.eye(5) - gain @ h))).max() < 1.0


@pytest.mark.parametrize("rows", [[POSITION], [POSITION, SPEED]], ids=["position", "and speed"])
def test_smoothing_gains_are_those_of_a_filter_that_keeps_its_past(rows):
    """The past state as a part of the state: the gains on it, tick by tick, once the filter is stationary."""
    motion, noise, delay, kept = free_motion(0.1, 1.0), [1e-4, 0.3][: len(rows)], 6, 7
    (f, q), h, r, n = arrays(motion), np.array(rows), np.diag(noise), 5
    filtered = stationary(motion, rows, noise)
    big = np.zeros((n * kept, n * kept))
    big[:n, :n], big[n:, :-n] = f, np.eye(n * (kept - 1))
    seen, covariance = np.hstack([h, np.zeros((len(h), n * (kept - 1)))]), np.kron(np.eye(kept), filtered.covariance)
    for _ in range(400):
        gain = covariance @ seen.T @ np.linalg.inv(seen @ covariance @ seen.T + r)
        lags = gain
        covariance = big @ (covariance - gain @ seen @ covariance) @ big.T
        covariance[:n, :n] += q
    found = smoothing_gains(motion, rows, filtered, delay, 0.0)
    expected = [lags[n * lag : n * (lag + 1)] for lag in range(delay + 1)]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * abs(lags).max())


def test_the_last_smoothing_gain_holds_all_later_ones_discounted():
    motion, fade = free_motion(0.1, 1.0), exp(-0.5)
    filtered = stationary(motion, [POSITION], [1e-4])
    later = smoothing_gains(motion, [POSITION], filtered, 80, 0.0)
    sums = sum(fade**j * np.array(gain) for j, gain in enumerate(later[3:]))
    np.testing.assert_allclose(smoothing_gains(motion, [POSITION], filtered, 3, fade)[3], sums, rtol=1e-8)


def test_products_round_at_each_term_in_every_version_of_python():
    assert kalman.product([[1e16, 1.0, -1e16]], [[1.0], [1.0], [1.0]]) == [[0.0]]


def test_elimination_finds_pivots():
    a = [[0.0, 2.0, 1.0], [1.0, -1.0, 0.0], [3.0, 0.0, 1e-9]]
    np.testing.assert_allclose(kalman.solve(a, kalman.identity(3)), np.linalg.inv(a), rtol=1e-12, atol=1e-12)
