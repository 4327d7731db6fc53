"""A planted model, its rules and its data for the tests of identification."""

from __future__ import annotations

from dataclasses import replace

from planted import planted as planted_ride
from samplings import make_sampling

from ces_identify.polynomial.rules_file import parse_rules
from ces_observer.model import Envelope, Model
from ces_observer.structures.polynomial import Factor, Polynomial, Term

SAMPLING = make_sampling(500.0, 0.01)
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


def planted(seed, seconds=12.0, noise=5.0, name="planted", sampling=SAMPLING):
    return planted_ride(replace(PLANTED, sampling=sampling), seed, noise, seconds, name)
