"""What the log says of a model at start."""

from __future__ import annotations

from dataclasses import replace

import pytest
from damper_models import plain_damper
from physical_models import CHAMBERS, RELAXATION, physical_model

from ces_observer.errors import ModelError
from ces_observer.nodes.model_check import describe_model, require_stable
from ces_observer.structures.flow_map import FlowMap
from ces_observer.structures.increasing_curves import IncreasingCurve


def test_a_model_that_clamps_says_so() -> None:
    model = plain_damper()
    text = describe_model(model)
    assert text == f"polynomial_narx, {model.size}; inputs outside the envelope are clamped to it"


def test_a_model_that_extrapolates_says_how_far_and_what_is_proved() -> None:
    text = describe_model(physical_model(RELAXATION))
    assert (
        "relaxation, 2 force-speed curves of 4 nodes, 1 springs; inputs outside the envelope are used as they" in text
    )
    assert "force bound 1900 N for inputs in the envelope; 3122.22 N for any input" in text


def test_chambers_whose_force_cannot_be_bounded_are_refused() -> None:
    closed = IncreasingCurve((-1.0, 0.0, 1.0), (-1e-14, 0.0, 1e-14))
    curve = (-1e9, 0.0, 1e9)
    body = replace(CHAMBERS, check=closed, refill=closed, map=FlowMap((-1e-4, 0.0, 1e-4), (curve, curve)))
    with pytest.raises(ModelError, match=r"m\.json: its force is not proved to be bounded for every input"):
        require_stable(replace(physical_model(CHAMBERS), body=body), "m.json")
