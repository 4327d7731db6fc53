"""Recordings with the errors of models of known cost, for the tests of comparisons."""

import numpy as np
from residual_series import coloured

from ces_identify.comparison.compared_models import AlignedRecording

RATE_HZ = 500.0


def aligned(errors, seed=0, name="made", diverged=None):
    """A recording of a force of variance 20² N² on which the models make these `errors` (models, n)."""
    errors = np.asarray(errors, dtype=float)
    models, n = errors.shape
    measured = 20.0 * coloured(n, 0.98, seed + 10**6)
    time_s, still = np.arange(n) / RATE_HZ, np.zeros(n)
    lost = diverged or (False,) * models
    return AlignedRecording(
        name, f"hash of {name}", "", RATE_HZ, time_s, still, still, measured, measured - errors, np.ones(n, bool),
        lost, ((),) * models, dict.fromkeys(("position", "speed", "current"), (0.0, 0.0)),
    )  # fmt: skip


def two_models(n, seed, ratio=1.0, pole=0.9):
    """Errors (2, n) with a common part, whose own parts have sizes `ratio` and 1."""
    common, first, second = (coloured(n, pole, 3 * seed + i) for i in range(3))
    return np.stack([common + ratio * first, common + second])
