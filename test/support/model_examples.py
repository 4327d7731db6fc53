"""Small polynomial models for the tests of ces_observer."""

from __future__ import annotations

from samplings import make_sampling

from ces_observer.model import Envelope, Model
from ces_observer.structures.polynomial import Factor, Polynomial, Term

TERMS = (
    Term(1200.0, (Factor("speed", 0, 0.5), Factor("current", 5, 1.0, signed=False))),
    Term(0.4, (Factor("force", 2), Factor("speed", 1, 1.0, signed=False))),
    Term(-3.0, ()),
)


def make_model(terms=TERMS, **changes):
    fields = {
        "sampling": make_sampling(),
        "body": Polynomial(terms),
        "envelope": Envelope((-0.1, 0.1), (-1.0, 1.0), (0.0, 1.0)),
        "force_envelope_N": (-5000.0, 5000.0),
        "provenance": {"tool": "test"},
    }
    return Model(**{**fields, **changes})
