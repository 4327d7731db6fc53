"""Quantities of a report: intervals hold the planted values as often as they say; steady forces are the model's own."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from planted import RATE_HZ
from planted_dampers import KINDS, planted_model, planted_models, truth

from ces_identify.numerics.search import TIME_IS_UP, Limits
from ces_identify.physical.physical_search import LAST_STEPS, STRENGTHS, PhysicalSearch
from ces_identify.physical.quantities import (
    describe_errors,
    find_undetermined,
    parameter_errors,
    read_quantities,
    recorded_speeds,
    steady_force_map,
)

DRAWS, LONG_S = 2, 30.0
STRENGTH = STRENGTHS[-1]


def fitted(kind, seed):
    """A fit from the true parameters: intervals say nothing of other optima."""
    models, (_, theta) = planted_models(kind, seed, seconds=LONG_S), truth(kind, seconds=LONG_S)
    search = PhysicalSearch(Limits(threads=1), lambda result: None)
    return models, search.refit(search._fit(models, theta, STRENGTH, 0, LAST_STEPS))


def test_a_search_whose_time_is_up_takes_no_step():
    (models, theta), search = truth("uniflow"), PhysicalSearch(Limits(threads=1, time=-1.0), lambda result: None)
    fit = search._fit(models, theta, STRENGTH, 0, LAST_STEPS)
    search._fit_kind(models, 1)
    assert search.refit(fit) is theta
    assert (fit.result.ended, len(search._fits)) == (TIME_IS_UP, 1)


def values_of(models, theta, errors):
    body, interval = models.body(theta), models.scales.interval_s
    stroke = models.training.envelope.position_m
    quantities = read_quantities(body, interval, stroke)
    forces = steady_force_map(body, interval, stroke, np.array(errors["speed_m_s"]), np.array(errors["current_A"]))
    return np.array(list(quantities.values())), forces


@cache
def scores(kind):
    """Errors in standard errors, of the quantities and of the steady forces at recorded speeds, for every draw."""
    both = []
    for seed in range(DRAWS):
        models, theta = fitted(kind, seed)
        errors = describe_errors(models, theta, STRENGTH)
        estimated, true = (values_of(models, at, errors) for at in (theta, truth(kind, seconds=LONG_S)[1]))
        speeds = np.array(errors["speed_m_s"])
        recorded = np.array([(speeds >= low) & (speeds <= high) for low, high in errors["recorded_m_s"]])
        sizes = np.array(list(errors["quantities"].values()))
        known = sizes > 0.0
        forces = (estimated[1] - true[1]) / np.array(errors["steady_force_N"])
        both.append([((estimated[0] - true[0])[known] / sizes[known]), forces[recorded]])
    return [np.concatenate(parts) for parts in zip(*both, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1], ids=["quantities", "steady forces"])
def test_the_95_percent_intervals_hold_the_planted_values(which):
    z = scores("twin tube")[which]
    assert len(z) > 25
    assert 0.88 <= np.mean(np.abs(z) < 1.96) <= 1.0
    assert 0.3 < np.sqrt(np.median(z**2)) / 0.6745 < 1.5


def test_what_recordings_do_not_determine_is_said_with_the_value_assumed():
    models, theta = planted_models("twin tube", 1), truth("twin tube")[1]
    held = replace(models, training=replace(models.training, inputs=models.training.inputs * [[1.0], [1.0], [0.0]]))
    lags = [text for text in find_undetermined(held, theta, STRENGTH) if "lag" in text]
    rise_ms = 1e3 * models.body(theta).valve.rise_s
    assert len(lags) == 2
    assert lags[0].startswith(f"the valve's lag while the current rises is not determined: {rise_ms:.3g} ms assumed; ")
    assert not [text for text in find_undetermined(models, theta, STRENGTH) if "lag" in text]


def test_too_little_data_gives_no_errors():
    models, theta = truth("uniflow")
    few = models.training.segments.copy()
    few[-1, 1] = few[-1, 0] + 300
    short = replace(models, training=replace(models.training, segments=few))
    assert parameter_errors(short, theta, STRENGTH) is None
    assert describe_errors(short, theta, STRENGTH) == {}


SPEEDS, CURRENTS = np.array([-0.3, -0.02, 0.05, 0.4]), np.array([0.35, 0.6])


@pytest.mark.parametrize("kind", KINDS)
def test_they_are_those_of_the_models_own_run(kind):
    model = planted_model(kind)
    stroke = (-0.02, 0.03)
    forces = steady_force_map(model.body, 1 / RATE_HZ, stroke, SPEEDS, CURRENTS)
    for n, current in enumerate(CURRENTS):
        for m, speed in enumerate(SPEEDS):
            run, position = model.make_predictor(), 0.005
            ticks = max(int(np.ceil(min(0.025 / abs(speed), 0.3) * RATE_HZ)), 10)
            force = 0.0
            for v in [-speed] * ticks + [speed] * ticks:
                position += v / RATE_HZ
                force = run.tick(position, v, current)
            assert forces[n, m] + model.body.side.gas(0.005) == pytest.approx(force, rel=1e-9)
    assert (np.diff(forces, axis=1) > 0.0).all()


def test_the_recorded_speeds_are_those_about_each_current():
    speed, current = np.array([-1.0, 1.0, -0.2, 0.2]), np.array([0.1, 0.1, 0.9, 0.9])
    spans = recorded_speeds(speed, current, np.array([0.0, 0.5, 1.0]))
    assert spans[1] == [0.0, 0.0]
    np.testing.assert_allclose([spans[0], spans[2]], [[-1.0, 1.0], [-0.2, 0.2]], atol=0.02)
