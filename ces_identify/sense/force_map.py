"""A flexible causal map from motion and current to the force, fitted by linear least squares, for the sense checks.

It is piecewise linear in the speed, quadratic in the current, and has the short memory that dampers and valves have.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from ces_identify.numerics.arrays import F
from ces_identify.sense.motion import RATE_HZ, Motion

KNOTS = (0.0, 0.02, 0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9, 0.98, 1.0)  # quantiles of the speed
LAGS_S = (0.0, 0.003, 0.008)  # memory of the force
VALVE_LAGS_S = (0.0, 0.01, 0.025)
RIDGE = 1e-5
SAME_CURRENT = 0.02  # relative spread below which a current counts as constant


def force_features(motion: Motion) -> F:
    """Return features (k, n): a map of speed and current, also behind lags, and the position."""
    speeds, factors = hats(motion.speed, KNOTS), [np.ones(len(motion))]
    if not is_constant(motion.current):
        n = normalize(motion.current)
        factors += [n, n**2, *(lag(n, seconds) for seconds in VALVE_LAGS_S[1:])]
    base = np.concatenate([speeds * factor for factor in factors])
    return np.concatenate([*(lag(base, seconds) for seconds in LAGS_S), normalize(motion.position)[None]])


def is_constant(current: F) -> bool:
    """Return whether a current hardly changes."""
    return bool(current.std() <= SAME_CURRENT * max(abs(float(current.mean())), 1e-3))


def hats(values: F, quantiles: tuple[float, ...]) -> F:
    """Return piecewise linear functions (k, n) with knots at the quantiles; they sum to one."""
    knots = np.unique(np.quantile(values, quantiles))
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))])


def lag(values: F, seconds: float) -> F:
    """Return signals (..., n) behind a first-order lag."""
    if seconds == 0.0:
        return values
    keep = float(np.exp(-1.0 / (RATE_HZ * seconds)))
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values, axis=-1))


def normalize(values: F) -> F:
    """Return a signal (n,) with mean 0 and standard deviation 1."""
    return np.asarray((values - values.mean()) / max(float(values.std()), 1e-30))


def fit_errors(features: F, targets: F) -> F:
    """Return the relative error (m,) of the least-squares fit of each column of `targets` (n, m)."""
    a, y = features - features.mean(axis=0), targets - targets.mean(axis=0)
    gram = a.T @ a
    damped = gram + RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    right = a.T @ y
    weights = np.linalg.solve(damped, right)
    energy = np.maximum((y**2).sum(axis=0), 1e-30)
    rest = energy - 2.0 * (weights * right).sum(axis=0) + (weights * (gram @ weights)).sum(axis=0)
    return np.asarray(np.sqrt(np.maximum(rest, 0.0) / energy))
