"""Inputs, terms and tables for the tests of kernels."""

from __future__ import annotations

import numpy as np
import pytest

from ces_identify.polynomial.problem import lay_out_terms
from ces_observer.model import Envelope
from ces_observer.structures.polynomial import Factor, Term

TERMS = (
    Term(5.0, (Factor("speed", 0, 0.5),)),
    Term(-2.0, (Factor("speed", 7, 1.7, signed=False), Factor("current", 3, 1.0, signed=False))),
    Term(0.3, (Factor("force", 1), Factor("speed", 2, 1.0, signed=False))),
    Term(-0.2, (Factor("force", 4), Factor("current", 0, 2.0, signed=False))),
    Term(1.0, (Factor("position", 1), Factor("speed", 0, 2.0), Factor("current", 5, 1.0, signed=False))),
    Term(0.7, ()),
)


WIDE = Envelope((-9.0, 9.0), (-9.0, 9.0), (-9.0, 9.0))


SEGMENTS = np.array([[0, 1500], [1500, 1503], [1503, 4000]])


@pytest.fixture(name="inputs")
def make_inputs():
    random = np.random.default_rng(5)
    return random.normal(size=4000), random.normal(size=4000), random.uniform(0, 1, 4000)


def tables(terms, inputs):
    layout = lay_out_terms(terms)
    powers = layout.power_table(WIDE, inputs, SEGMENTS, 1000.0)
    return layout, powers, np.array([t.coefficient for t in terms])
