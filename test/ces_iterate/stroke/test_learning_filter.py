"""The learning filter: its condition holds for plants drawn at random, and the iteration contracts as it says."""

import numpy as np
import pytest

from ces_iterate.errors import StrokeError
from ces_iterate.stroke.actuator import ActuatorModel, MeasuredResponse
from ces_iterate.stroke.learning_filter import MAX_CONTRACTION, design_filter, plants_within

MODEL = ActuatorModel(1.0, 0.004, 35.0, 0.8, 0.001)


def measured(model, spread=0.01):
    frequencies = np.arange(0.5, 40.0, 0.5)
    response = model.response(frequencies)
    full = np.full(len(frequencies), spread)
    return MeasuredResponse(frequencies, response, full, np.full_like(full, 0.5))


def remaining(f, plant):
    """Return |Q (1 - L G)| on a finer grid than the design's."""
    at = np.linspace(0.0, 100.0, 3001)
    return np.abs(f.robustness(at) * (1.0 - f.learning(at) * plant.response(at)))


@pytest.mark.parametrize("design", ["model", "measured"])
def test_the_condition_holds_for_any_plant_of_which_the_model_is_30_percent_wrong(design):
    f = design_filter(MODEL, measured(MODEL) if design == "measured" else None, 0.3, 60.0)
    assert f.contraction.max() <= MAX_CONTRACTION
    random = np.random.default_rng(4)
    worst = 0.0
    for _ in range(300):
        wrong = 1.0 + 0.3 * random.uniform(-1.0, 1.0, 3)  # the model's error, relative to the plant
        gain, bandwidth, delay = (float(1.0 / w) for w in wrong)
        worst = max(worst, remaining(f, MODEL.scale(gain, bandwidth, delay)).max())
    assert 0.5 < worst < 1.0
    assert worst <= f.contraction.max() + 0.01


def test_the_learning_bandwidth_ends_where_the_condition_would_fail():
    wide = design_filter(MODEL, None, 0.1, 60.0)
    narrow = design_filter(ActuatorModel(1.0, 0.015, 20.0, 0.8), None, 0.5, 60.0)
    assert wide.bandwidth_Hz == 60.0
    assert 2.0 < narrow.bandwidth_Hz < 15.0
    beyond = narrow.frequency_Hz > narrow.bandwidth_Hz
    assert np.fmax(narrow.bound_in_tolerance, 0.0)[beyond].max() > MAX_CONTRACTION
    assert not narrow.share[beyond].any()


def test_a_measured_response_replaces_a_wrong_model():
    wrong = MODEL.scale(1.3, 0.7, 1.3)
    blind, seeing = design_filter(wrong, None, 0.3, 60.0), design_filter(wrong, measured(MODEL), 0.3, 60.0)
    part = (np.linspace(0.0, 100.0, 3001) > 1.0) & (np.linspace(0.0, 100.0, 3001) < 15.0)
    assert remaining(seeing, MODEL)[part].max() < 0.15 < remaining(blind, MODEL)[part].max()


def test_an_uncertain_measurement_narrows_the_bandwidth():
    """|1 - h| + h radius cannot be below 1 for a radius of 1."""
    spread = np.where(np.arange(0.5, 40.0, 0.5) > 20.0, 0.6, 0.01)
    f = design_filter(MODEL, measured(MODEL, spread), 0.3, 60.0)
    assert f.bandwidth_Hz == pytest.approx(20.0, abs=1.0)


def test_hopeless_uncertainty_is_said():
    with pytest.raises(StrokeError, match=r"convergence cannot be guaranteed above .* record a longer or larger probe"):
        design_filter(MODEL, measured(MODEL, 1.0), 0.3, 60.0)


def test_the_iteration_contracts_by_what_the_bound_allows():
    """The update in the frequency domain on the worst plant of the family, without noise."""
    f = design_filter(MODEL, None, 0.3, 60.0)
    at = np.fft.rfftfreq(4096, 1e-3)
    wanted = np.fft.rfft(np.random.default_rng(1).standard_normal(4096))
    for plant in plants_within(MODEL, 0.3)[::10]:
        q, law, g = f.robustness(at), f.learning(at), plant.response(at)
        limit = q * law * (1 - g) * wanted / (1 - q * (1 - law * g))
        correction, distances = np.zeros_like(wanted), []
        for _ in range(6):
            distances.append(np.linalg.norm(correction - limit))
            correction = q * (correction + law * (wanted - g * (wanted + correction)))
        ratios = np.array(distances[1:]) / np.array(distances[:-1])
        assert ratios.max() <= f.contraction.max() + 0.01
