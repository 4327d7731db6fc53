"""A mean of a polynomial, a recurrent network and a hydraulic one, for tests."""

from __future__ import annotations

from damper_models import plain_damper
from hydraulic_models import ENVELOPE, SAMPLING, make_hydraulic
from physical_examples import make_valve
from recurrent_models import make_recurrent

from ces_observer.model import Model
from ces_observer.structures.mixture import Mixture, WeightedModel


def mixture_model() -> Model:
    members = (
        WeightedModel(0.3, plain_damper().body, (-900.0, 1000.0)),
        WeightedModel(0.45, make_recurrent(), (-9e3, 9e3)),
        WeightedModel(0.25, make_hydraulic(make_valve()), (-7e3, 7e3)),
    )
    return Model(SAMPLING, Mixture(members), ENVELOPE, (-1200.0, 1500.0))
