"""Identification of the actuator: planted parameters and responses are recovered from runs, with honest spreads."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from ces_iterate.errors import StrokeError
from ces_iterate.stroke.actuator import ActuatorModel, CommandedRun, fit_model, identify_actuator, measure_response
from ces_iterate.stroke.learning import make_probe
from ces_iterate.stroke.limits import StrokeLimits

TRUE = ActuatorModel(0.95, 0.005, 30.0, 0.7, 0.002)
INTERVAL = 1e-3
LIMITS = StrokeLimits()


def respond(command, model, noise=20e-6, seed=1):
    """Return the position of a linear actuator, computed in the frequency domain with zeros behind."""
    size = 2 * len(command)
    spectrum = np.fft.rfft(command, size) * model.response(np.fft.rfftfreq(size, INTERVAL))
    position = np.fft.irfft(spectrum, size)[: len(command)]
    return position + noise * np.random.default_rng(seed).standard_normal(len(command))


def stroke(seed=3, seconds=8.0, cutoff=8.0):
    noise = np.random.default_rng(seed).standard_normal(round(seconds / INTERVAL))
    smooth = sosfiltfilt(butter(4, cutoff, fs=1 / INTERVAL, output="sos"), noise)
    window = np.clip(np.minimum(np.arange(len(noise)), np.arange(len(noise))[::-1]) / 500.0, 0.0, 1.0) ** 3
    return 0.015 * window * smooth / np.abs(smooth).max()


def test_planted_parameters_are_recovered_from_a_probe():
    command = make_probe(8.0, 60.0, INTERVAL, LIMITS, stroke())
    run = CommandedRun(command, respond(command, TRUE), INTERVAL)
    model, measured = identify_actuator([[run]], 60.0)
    at = np.linspace(0.5, 55.0, 100)
    assert np.abs(model.response(at) / TRUE.response(at) - 1.0).max() < 0.02
    assert model.gain == pytest.approx(0.95, abs=0.01)
    assert measured.frequency_Hz[-1] > 45.0


def test_the_spread_is_that_of_the_estimate():
    errors = []
    for seed in range(8):
        command = make_probe(8.0, 60.0, INTERVAL, LIMITS, stroke())
        run = CommandedRun(command, respond(command, TRUE, 200e-6, seed), INTERVAL)
        measured = measure_response([[run]], 60.0, TRUE)
        off = np.abs(measured.response / TRUE.response(measured.frequency_Hz) - 1.0)
        errors.append(np.mean((off / measured.spread) ** 2))
    assert 0.7 < np.mean(errors) < 1.6


def test_runs_without_content_are_refused():
    command = np.zeros(4000)
    run = CommandedRun(command, respond(command, TRUE), INTERVAL)
    with pytest.raises(StrokeError, match="was found in 0 bands of frequencies; expected at least 4: use a probe"):
        measure_response([[run]], 60.0, TRUE)


@pytest.mark.parametrize("model", [TRUE, ActuatorModel(1.2, 0.0, 12.0, 0.4, 0.0), ActuatorModel(1.0, 0.02, 8.0, 1.2)])
def test_a_fit_finds_the_response(model):
    at = np.linspace(0.3, 40.0, 60)
    found = fit_model(at, model.response(at), np.full(60, 0.01))
    assert np.abs(found.response(at) / model.response(at) - 1.0).max() < 0.01
