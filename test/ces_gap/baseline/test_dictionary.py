"""The learner's dictionary: size, features of order one, weighted sums and JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from engine_plant import traced

from ces_gap.baseline.learner import Dictionary, Scales
from ces_gap.trace import Trace

KINDS = [
    pytest.param(constant, by_force, by_time, id=f"{constant}-{by_force}-{by_time}")
    for constant in (None, 0.6)
    for by_force in (True, False)
    for by_time in (True, False)
]


@cache
def one(constant_A: float | None) -> Trace:
    return traced(seconds=3.0, constant_A=constant_A)


def dictionary(trace: Trace, by_force: bool, by_time: bool) -> Dictionary:
    return Dictionary(Scales.of([trace], [trace.simulated]), by_force, by_time)


@pytest.mark.parametrize(("constant", "by_force", "by_time"), KINDS)
def test_size_is_the_number_of_columns_and_every_column_is_used(
    constant: float | None, by_force: bool, by_time: bool
) -> None:
    trace = one(constant)
    learner = dictionary(trace, by_force, by_time)
    features = learner.features(trace, trace.inputs, trace.simulated)
    assert features.shape == (len(trace), learner.size + (5 if by_time else 0))
    assert np.isfinite(features).all()
    assert (np.abs(features[trace.usable]).max(axis=0) > 0.0).all()  # a column beyond those filled would stay zero
    assert np.sqrt(np.mean(features**2, axis=0)).max() < 10.0


@pytest.mark.parametrize(("constant", "by_force", "by_time"), KINDS)
def test_the_prediction_is_the_weighted_sum_of_the_features(
    constant: float | None, by_force: bool, by_time: bool
) -> None:
    trace = one(constant)
    learner = dictionary(trace, by_force, by_time)
    features = learner.features(trace, trace.inputs, trace.simulated)
    weights = np.random.default_rng(1).standard_normal(features.shape[1])
    predicted = learner.predict(trace, trace.inputs, trace.simulated, weights)
    np.testing.assert_allclose(predicted, features @ weights, rtol=1e-9, atol=1e-9)


def test_extreme_currents_are_clipped() -> None:
    trace = one(None)
    learner = dictionary(trace, True, False)
    far = trace.inputs.with_current(np.full(len(trace), 100.0))
    further = trace.inputs.with_current(np.full(len(trace), 1e4))
    np.testing.assert_array_equal(
        learner.features(trace, far, trace.simulated), learner.features(trace, further, trace.simulated)
    )


def test_only_usable_ticks_determine_the_scales() -> None:
    trace = one(None)
    spoiled = trace.simulated.copy()
    spoiled[~trace.usable] = 1e9
    assert (~trace.usable).any()
    assert Scales.of([trace], [spoiled]) == Scales.of([trace], [trace.simulated])


def test_a_current_that_hardly_changes_counts_as_constant() -> None:
    assert Scales.of([one(None)], [one(None).simulated]).varies
    still = one(0.6)
    assert not Scales.of([still], [still.simulated]).varies
    ripple = replace(still, inputs=still.inputs.with_current(0.6 + 0.006 * np.sin(20.0 * still.time_s)))
    assert not Scales.of([ripple], [still.simulated]).varies


@pytest.mark.parametrize(("constant", "by_force", "by_time"), KINDS)
def test_the_json_round_trip_is_exact(constant: float | None, by_force: bool, by_time: bool) -> None:
    learner = dictionary(one(constant), by_force, by_time)
    assert Dictionary.from_json(json.loads(json.dumps(learner.as_json()))) == learner


@pytest.mark.parametrize("missing", ["scales", "by_force", "by_time"])
def test_incomplete_json_is_refused(missing: str) -> None:
    document = dictionary(one(None), True, False).as_json()
    del document[missing]
    with pytest.raises(KeyError):
        Dictionary.from_json(document)
