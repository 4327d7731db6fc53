"""A model's force on plain arrays, as a simulation function of a user's own would give it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_identify.recordings.recording import Channel, Recording
from ces_identify.simulations.simulate import sample_force
from ces_observer.model import Model

F = NDArray[np.float64]


def simulate_samples(model: Model, time_s: F, position: F, current: F) -> F:
    """Return the force [N] for arrays (n,) of time [s], position [m] and current [A]; NaN where it is withheld."""
    stamps = np.rint(np.asarray(time_s) * 1e9).astype(np.int64)
    channels = {
        "position": Channel("position", "m", stamps, np.asarray(position, np.float64)),
        "current": Channel("current", "A", stamps, np.asarray(current, np.float64)),
    }
    return sample_force(model, Recording("arrays", channels))
