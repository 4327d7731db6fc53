"""A planted sigmoid network and a planted neuro-fuzzy model, and recordings of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from samplings import make_sampling

from ces_data.recording import Channel, Recording
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulate import simulate_series
from ces_observer.model import Envelope, Model
from ces_observer.structures.fuzzy import Bell, Fuzzy, Premise, Rule
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.network import Network, SigmoidUnit

RATE_HZ = 400.0
SAMPLING = make_sampling(RATE_HZ, 0.01)
WIDE = Envelope((-1.0, 1.0), (-5.0, 5.0), (-5.0, 5.0))
REGRESSORS = (
    Regressor("force", 1, 0.0, 500.0),
    Regressor("speed", 0, 0.0, 0.3),
    Regressor("speed", 1, 0.0, 0.3),
    Regressor("current", 3, 0.5, 0.15),
)
NETWORK = Model(
    SAMPLING,
    Network(
        REGRESSORS,
        500.0,
        -0.25,
        (0.6, 0.1, 0.05, 0.02),
        (SigmoidUnit(1.2, 0.4, (0.3, 2.0, -0.5, 0.5)), SigmoidUnit(-0.7, -0.3, (-0.2, -1.5, 0.0, 0.8))),
    ),
    WIDE,
    (-1e5, 1e5),
)
FUZZY = Model(
    SAMPLING,
    Fuzzy(
        REGRESSORS,
        500.0,
        (Premise("speed", 0, (Bell(-0.4, 0.3, 2.0), Bell(0.4, 0.3, 2.0))),),
        (Rule((0,), -0.4, (0.8, 0.1, 0.05, -0.05)), Rule((1,), 0.3, (0.6, 0.3, 0.1, 0.15))),
    ),
    WIDE,
    (-1e5, 1e5),
)


def stroked(seed: int, seconds: float = 10.0, name: str = "planted", rate_Hz: float = RATE_HZ) -> Recording:
    """Position and current of a rough ride."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate_Hz)) / rate_Hz
    tones = zip(random.uniform(1, 8, 6), random.uniform(0, 6, 6), strict=True)
    x = sum(0.005 * np.sin(2 * np.pi * f * t + p) for f, p in tones)
    i = 0.5 + 0.2 * np.sin(2 * np.pi * 1.3 * t + seed) + 0.05 * np.sin(2 * np.pi * 4.1 * t)
    stamps = (t * 1e9).round().astype(np.int64)
    return Recording(
        name, {"position": Channel("position", "m", stamps, x), "current": Channel("current", "A", stamps, i)}
    )


def planted(model: Model, seed: int, noise: float = 4.0, seconds: float = 10.0, name: str = "planted") -> Recording:
    """The force of `model` with `noise` [N] on a rough ride."""
    return with_force(model, stroked(seed, seconds, name, model.sampling.rate_Hz), seed, noise)


def with_force(model: Model, bare: Recording, seed: int, noise: float) -> Recording:
    """The recording with the force of `model` and noise."""
    force = simulate_series(model, prepare(bare, model.sampling)).force
    noisy = force + np.random.default_rng(seed + 1000).normal(0.0, noise, len(force))
    return with_values(bare, force=noisy)


def with_values(recording: Recording, **values: np.ndarray) -> Recording:
    """The recording with other values of some channels, all at the stamps of the position."""
    stamps, units = recording.channel("position").stamps_ns, {"force": "N", "current": "A", "position": "m"}
    channels = {name: Channel(name, units[name], stamps, one) for name, one in values.items()}
    return replace(recording, channels={**recording.channels, **channels})
