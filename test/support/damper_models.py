"""Small models for tests: a plain damper with one past force."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from samplings import make_sampling

from ces_observer.model import Envelope, Model
from ces_observer.structures.polynomial import Factor, Polynomial, Term

RATE_HZ = 1000.0


def damper_with_past(coefficient: float, **sampling: Any) -> Model:
    """Return the plain damper with another coefficient of its past force: another digest, stable below 1."""
    model = plain_damper(**sampling)
    first, *others = model.body.terms
    return replace(model, body=Polynomial((Term(coefficient, first.factors), *others)))


def plain_damper(warm_up_s: float = 0.1, **sampling: Any) -> Model:
    """Return F[k] = 0.9 F[k-1] + 200 v[k] + 100 v[k] i[k]: about 2.5 kN at 1 m/s and 0.5 A, slow by 10 ticks."""
    terms = (
        Term(0.9, (Factor("force", 1),)),
        Term(200.0, (Factor("speed", 0),)),
        Term(100.0, (Factor("speed", 0), Factor("current", 0))),
    )
    envelope = Envelope((-0.1, 0.1), (-2.0, 2.0), (0.0, 2.0))
    settings = make_sampling(**{"rate_Hz": RATE_HZ, "outlier_m": 0.02, "warm_up_s": warm_up_s, **sampling})
    return Model(settings, Polynomial(terms), envelope, (-8000.0, 8000.0))


def delayed_damper(delay_s: float, **sampling: float) -> Model:
    """Return a slower damper whose forces come `delay_s` [s] late."""
    return damper_with_past(0.92, delay_s=delay_s, **sampling)
