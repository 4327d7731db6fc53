"""The learner's compiled loops against a slow readable version."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import interp1d

from ces_data.arrays import F
from ces_gap.baseline.learner_kernels import fill_features

RATE_HZ, TICKS = 250.0, 200
FINE, COARSE, LEVEL = np.array([-2.0, -0.5, 0.5, 3.0]), np.array([-1.0, 0.2, 1.0]), np.array([-1.0, 0.0, 1.5])
TURNS, MEMORIES_S, VALVE_S = np.array([0.05, 0.4]), np.array([0.004, 0.02, 0.1]), np.array([0.008, 0.05])


def lagged(values: F, time_s: float) -> F:
    """A first-order lag, that starts at the first value."""
    out = [values[0]]
    for value in values[1:]:
        out.append(value + np.exp(-1.0 / (RATE_HZ * time_s)) * (out[-1] - value))
    return np.array(out)


def stopped(position: F, radius: float) -> F:
    """A stop operator: follows the position's steps and never leaves its radius."""
    out = [0.0]
    for step in np.diff(position):
        out.append(float(np.clip(out[-1] + step, -radius, radius)))
    return np.array(out)


def hats(values: F, knots: F) -> list[F]:
    """Piecewise linear functions, one at a knot and zero at the others, constant beyond the ends."""
    inside = np.clip(values, knots[0], knots[-1])
    return list(interp1d(knots, np.eye(len(knots)), axis=1)(inside))


def times(columns: list[F], *factors: F | float) -> list[F]:
    return [c * factor for factor in factors for c in columns]


def slow_features(x: F, v: F, i: F, f: F, varies: bool, by_force: bool) -> F:
    """Every feature as a column, in order."""
    by_current = (1.0, i) if varies else (1.0,)
    warped = np.arcsinh(10.0 * v)
    columns = times(hats(warped, FINE), *by_current, *((i * i,) if varies else ()))
    columns += [x, x**2, x**3, *([x * i] if varies else []), *times(hats(warped, COARSE), x)]
    for radius in TURNS:
        columns += times([stopped(x, radius) / radius], *by_current, v > 0.0)
    if varies:
        for time in VALVE_S:
            columns += times(hats(warped, COARSE), i - lagged(i, time))
    for time in MEMORIES_S[:1] if by_force else MEMORIES_S:
        columns += times(hats(np.arcsinh(10.0 * lagged(v, time)), FINE), *by_current)
    if by_force:
        columns += times(hats(f, LEVEL), *by_current) + times([f], *by_current)
        for time in MEMORIES_S:
            columns += times([3.0 * (f - lagged(f, time))], *by_current, f > 0.0)
    return np.stack(columns, axis=1).astype(np.float64)


def signals(seed: int) -> tuple[F, F, F, F]:
    rng = np.random.default_rng(seed)
    x, v, i, f = (1.5 * np.convolve(rng.standard_normal(TICKS + 9), np.full(10, 0.3), "valid") for _ in range(4))
    return x, 0.3 * v, i, f


def fill(x: F, v: F, i: F, f: F, varies: bool, by_force: bool, weights: F, columns: int) -> F:
    out = np.zeros((TICKS, columns))
    knots = (FINE, COARSE, LEVEL, TURNS, MEMORIES_S, VALVE_S)
    fill_features(x, v, i, f, RATE_HZ, varies, by_force, *knots, weights, out)
    return out


@pytest.mark.parametrize("varies", [True, False])
@pytest.mark.parametrize("by_force", [True, False])
def test_features_and_their_weighted_sum_equal_those_of_the_slow_version(varies: bool, by_force: bool) -> None:
    inputs = signals(1)
    expected = slow_features(*inputs, varies, by_force)
    features = fill(*inputs, varies, by_force, np.empty(0), expected.shape[1])
    np.testing.assert_allclose(features, expected, rtol=1e-12, atol=1e-12)
    weights = np.random.default_rng(3).standard_normal(expected.shape[1])
    predicted = fill(*inputs, varies, by_force, weights, 1)[:, 0]
    np.testing.assert_allclose(predicted, expected @ weights, rtol=1e-11, atol=1e-11)
