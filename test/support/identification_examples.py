"""A planted model, its rules and its data for the tests of identification."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ces_data.recording import Channel, Recording
from ces_identify.polynomial.candidates import parse_rules
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulate import simulate_series
from ces_observer.model import Envelope, Model, Sampling
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

SAMPLING = Sampling(500.0, 40.0, 0.01)


PLANTED = Model(
    SAMPLING,
    Polynomial(
        (
            Term(900.0, (Factor("speed", 0, 0.5),)),
            Term(1500.0, (Factor("speed", 0, 1.0), Factor("current", 5, 1.0, signed=False))),
            Term(0.6, (Factor("force", 2),)),
        )
    ),
    Envelope((-1.0, 1.0), (-5.0, 5.0), (-5.0, 5.0)),
    (-1e5, 1e5),
)


RULES = parse_rules(
    {
        "force": {"lags": [1, 2, 5]},
        "speed": {"lags": [0, 2, 5], "powers": [0.5, 1.0, 2.0], "forms": ["signed", "magnitude"]},
        "current": {"lags": [0, 5], "powers": [1.0], "forms": ["magnitude"]},
        "products": [[], ["speed"], ["speed", "current"], ["force"], ["force", "speed"]],
    },
    "test",
)


def planted(seed, seconds=12.0, noise=5.0, name="planted"):
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * 500)) / 500.0
    tones = zip(random.uniform(1, 8, 6), random.uniform(0, 6, 6), strict=True)
    x = sum(0.004 * np.sin(2 * np.pi * f * t + p) for f, p in tones)
    i = 0.5 + 0.2 * np.sin(2 * np.pi * 1.3 * t + seed)
    stamps = (t * 1e9).round().astype(np.int64)
    channels = {"position": Channel("position", "m", stamps, x), "current": Channel("current", "A", stamps, i)}
    bare = Recording(name, channels)
    force = simulate_series(PLANTED, prepare(bare, SAMPLING)).force + random.normal(0, noise, len(t))
    return replace(bare, channels={**channels, "force": Channel("force", "N", stamps, force)})
