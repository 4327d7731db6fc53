"""A physical model from its file gives the parameters it was made of; one on other nodes cannot be opened."""

import numpy as np
import pytest
from physical_models import CHAMBERS, RELAXATION
from planted_dampers import KINDS, models_of, planted_model, ride, true_parameters

from ces_identify.simulations.simulate import simulate_series


@pytest.mark.parametrize("kind", KINDS)
def test_its_parameters_and_force_are_those_of_the_file(kind):
    models, model = models_of(kind), planted_model(kind)
    opened, theta = type(models).reopen(model.body, models.scales.interval_s, models.training)
    np.testing.assert_allclose(theta, true_parameters(kind), rtol=1e-6, atol=1e-9)
    series = ride(1)
    force = simulate_series(model, series).force
    np.testing.assert_allclose(opened.force(theta)[series.scored], force[series.scored], atol=1e-6)


@pytest.mark.parametrize("body", [CHAMBERS, RELAXATION], ids=["chambers", "relaxation"])
def test_a_model_made_by_hand_is_refused(body):
    kind = "chambers" if body is CHAMBERS else "relaxation"
    models = models_of(kind)
    assert type(models).reopen(body, models.scales.interval_s, models.training) is None
