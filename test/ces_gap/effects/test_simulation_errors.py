"""Errors of the simulation as effects: maps of calibration that are linear, and timing counted in samples."""

from __future__ import annotations

import numpy as np
import pytest
from engine_plant import traced

from ces_gap.effects.simulation_errors import CALIBRATION_FORMS as FORMS
from ces_gap.effects.simulation_errors import ForceMap, ForceMapOfCurrent, SampleTiming, simulation_errors
from ces_gap.trace import Trace


@pytest.fixture(scope="module")
def trace() -> Trace:
    return traced(seed=3)


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f.form)
def test_a_calibration_is_linear_in_its_parameters_and_nothing_at_zero(trace: Trace, form: ForceMap) -> None:
    rng = np.random.default_rng(0)
    one, two = (rng.standard_normal(len(form.parameters)) for _ in range(2))

    def added(values: np.ndarray) -> np.ndarray:
        return form.respond(trace, trace.inputs, trace.simulated, values.tolist()) - trace.simulated

    np.testing.assert_allclose(added(2.0 * one + two), 2.0 * added(one) + added(two), atol=1e-6)
    assert np.abs(added(0.0 * one)).max() == 0.0
    assert np.abs(added(one)).max() > 0.0


def test_a_map_without_current_is_part_of_the_map_of_current(trace: Trace) -> None:
    values = np.arange(1.0, 9.0).tolist()
    plain = ForceMap().respond(trace, trace.inputs, trace.simulated, values)
    wider = ForceMapOfCurrent().respond(trace, trace.inputs, trace.simulated, values + 6 * [0.0])
    np.testing.assert_array_equal(plain, wider)


def test_maps_cost_more_than_effects_and_timing_is_no_cause() -> None:
    assert all(form.prior_share > 0.0 for form in FORMS)
    assert [form.name for form in simulation_errors() if form.nuisance] == ["simulation_timing"]


def test_timing_shifts_by_samples_of_the_log(trace: Trace) -> None:
    shifted = SampleTiming().respond(trace, trace.inputs, trace.simulated, (1.0, 0.0))
    expected = np.interp(trace.time_s - trace.sample_s, trace.time_s, trace.simulated)
    inner = slice(200, -200)
    error = np.sqrt(np.mean((shifted - expected)[inner] ** 2))
    assert error < 0.15 * np.sqrt(np.mean((trace.simulated - expected)[inner] ** 2))


def test_a_negative_spread_sharpens_what_was_smoothed(trace: Trace) -> None:
    smooth = SampleTiming().respond(trace, trace.inputs, trace.simulated, (0.0, 0.2))
    again = SampleTiming().respond(trace, trace.inputs, smooth, (0.0, -0.2))
    inner = slice(200, -200)
    lost, left = (float(np.std((force - trace.simulated)[inner])) for force in (smooth, again))
    assert 0.0 < left < 0.5 * lost
