"""The estimator over a recording, sample by sample, as the observer node runs it."""

from __future__ import annotations

from collections import Counter
from math import nan

import numpy as np
from numpy.typing import NDArray

from ces_identify.preparation.series import hold_current, hold_motion
from ces_identify.recordings.recording import Recording
from ces_observer.estimator import Estimator
from ces_observer.model import Model


def estimate_forces(model: Model, recording: Recording) -> tuple[NDArray[np.float64], Counter[str]]:
    """Return rows (n, 6) of stamp [ns], position [m], speed [m/s], force [N] and its bounds [N]; reasons where none.

    Without a band, the bounds are NaN.
    """
    estimator = Estimator(model)
    position = recording.channel("position")
    current = hold_current(recording, position.stamps_ns, model.sampling.max_current_age_s)
    rows: list[tuple[int, float, float, float, float, float]] = []
    reasons: Counter[str] = Counter()
    motion = hold_motion(recording, position.stamps_ns, model.sampling)
    columns = (position.stamps_ns, position.values, current, motion)
    for stamp, x, c, m in zip(*(column.tolist() for column in columns), strict=True):
        force = estimator.step(stamp, x, c, m)
        if force is None:
            reasons[estimator.reason] += 1
        else:
            half_width = estimator.half_width()
            width = nan if half_width is None else half_width
            rows.append((stamp, estimator.position, estimator.speed, force, force - width, force + width))
    return np.array(rows, dtype=object).reshape(-1, 6), reasons
