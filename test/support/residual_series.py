"""Series and evaluations whose force, error and gaps a test sets by hand."""

import numpy as np
from scipy.signal import lfilter

from ces_identify.prepare.cost import series_cost
from ces_identify.prepare.series import FreeRun, Series
from ces_identify.validation.evaluate import VALIDATION, Evaluation

RATE = 500.0


def coloured(n, pole, seed):
    """First-order noise of variance one."""
    noise = np.random.default_rng(seed).normal(size=n + 2000)
    return lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], noise)[2000:]


def series(n=10_000, seed=1, force=None, warm_up=0, segments=None, name="made", **signals):
    """A rough ride with independent speed, position and current."""
    given = {
        "position": 0.02 * coloured(n, 0.99, seed + 10),
        "speed": 0.4 * coloured(n, 0.95, seed + 20),
        "current": 0.5 + 0.1 * coloured(n, 0.98, seed + 30),
        **signals,
    }
    segments = np.array([[0, n]] if segments is None else segments, np.int64)
    scored = np.zeros(n, bool)
    for start, stop in segments:
        scored[start + warm_up : stop] = True
    force = 500.0 * coloured(n, 0.98, seed + 40) if force is None else force
    return Series(
        name, RATE, np.arange(n) / RATE, *given.values(), force, segments, scored & np.isfinite(force), warm_up, {}
    )


def evaluation(one, error, role=VALIDATION):
    """An evaluation with this error (ticks,) [N]."""
    never = np.zeros(len(one), bool)
    run = FreeRun(one.force - error, never, never, (-1e6, 1e6))
    return Evaluation(one.name, role, one, run, series_cost(one, run.force))


def single_run(n):
    return np.array([[0, n]], np.int64)
