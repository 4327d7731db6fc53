"""Parameters in named groups: bounds, projection, and that every vector within the bounds is a valid model."""

import json

import numpy as np
import pytest
from planted import SAMPLING
from planted_dampers import KINDS, models_of, true_parameters

from ces_identify.physical.layout import Layout, group
from ces_observer.model import Model, parse_model


def test_projection_moves_into_the_bounds_and_under_the_sum():
    layout = Layout((group("share", [0.2, 0.2], 0.1, 1.0, max_sum=0.5), group("mass", 1.0, 0.0, 2.0)))
    assert layout.project(np.array([0.05, 0.3, 9.0])).tolist() == [0.1, 0.3, 2.0]
    shrunk = layout.project(np.array([0.8, 0.8, -1.0]))
    assert shrunk[:2].sum() == pytest.approx(0.5)
    assert shrunk[2] == 0.0


def test_an_entry_of_the_penalty_is_never_too_small():
    """A rise that starts at next to nothing may still change as the others of its curve do."""
    assert group("rises", [1.0, 1e-9]).scale.tolist() == pytest.approx([1.0, 0.15])


@pytest.mark.parametrize("kind", KINDS)
def test_every_vector_within_the_bounds_is_a_model_that_its_file_can_hold(kind):
    models, random = models_of(kind), np.random.default_rng(4)
    for _ in range(10):
        theta = models.layout.project(true_parameters(kind) * np.exp(random.normal(0.0, 3.0, len(models.layout.start))))
        model = Model(SAMPLING, models.body(theta), models.training.envelope, (-1e9, 1e9))
        assert model.certify().holds
        assert parse_model(model.to_json(), "m.json").body == model.body
        assert json.loads(model.to_json())["structure"] == kind
