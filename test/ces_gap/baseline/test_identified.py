"""A model of the references as simulation: its error is that on recordings that it has not seen."""

from dataclasses import replace

import numpy as np
import pytest
from bands import make_band
from damper_models import plain_damper
from rig_rides import identified, rig_ride

from ces_gap.baseline.identified import add_left_out_force, add_own_error, identify_baseline
from ces_gap.baseline.learner import learn_correction
from ces_gap.errors import GapError
from ces_gap.limits import EvidenceLimits
from ces_gap.trace import open_trace
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation
from ces_observer.model import load_model

FRESH = (3, 4, 5, 6)


def reference_traces():
    return [add_left_out_force(identified(), open_trace(identified(), rig_ride(seed), False)) for seed in (1, 2)]


def fresh_error_N(correction):
    """The RMS error [N] of baseline and correction on rides that nothing was fitted to."""
    traces = [open_trace(identified(), rig_ride(seed), False) for seed in FRESH]
    errors = [(t.force - t.simulated - correction.force(t, t.inputs, t.simulated))[t.usable] for t in traces]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


@pytest.mark.slow
def test_the_noise_is_not_underestimated_by_what_the_model_has_seen():
    traces = reference_traces()
    correction, learnt = learn_correction(traces)
    seen = learn_correction([replace(t, simulated_left_out=None) for t in traces])[1]
    fresh_N = fresh_error_N(correction)
    assert learnt.noise.rms_N > 1.05 * seen.noise.rms_N
    assert 0.85 * fresh_N < learnt.noise.rms_N < 1.5 * fresh_N
    ratio = (learnt.noise.rms_N / seen.noise.rms_N) ** 2
    np.testing.assert_allclose(learnt.covariance, ratio * seen.covariance)


@pytest.mark.slow
def test_it_runs_as_its_model_and_left_out_forces_are_for_its_references_only():
    baseline, fresh = identified(), rig_ride(3)
    np.testing.assert_array_equal(baseline.force(fresh), ModelSimulation(baseline.model).force(fresh))
    assert baseline.left_out_force(fresh) is None
    trace = open_trace(baseline, fresh, False)
    assert add_left_out_force(baseline, trace) is trace
    left_out = baseline.left_out_force(rig_ride(1))
    assert left_out is not None and np.nanstd(left_out - baseline.force(rig_ride(1))) > 1.0


def test_a_given_simulation_has_no_left_out_force():
    simulation = FunctionSimulation("f", lambda time_s, position_m, current_A: 1e3 * np.gradient(position_m, time_s))
    trace = open_trace(simulation, rig_ride(1), False)
    assert add_left_out_force(simulation, trace).simulated_left_out is None


def test_a_model_says_by_its_band_how_far_it_may_be_off_on_the_usable_ticks():
    widths = dict.fromkeys(range(7), 0.0) | {0: 20.0, 1: 60.0}  # half-widths at lowest and highest current [N]
    band = make_band(parts=tuple(widths.values()), constant_share=1.0, current_A=(0.3, 0.7))
    simulation = ModelSimulation(replace(plain_damper(), band=band))
    trace = open_trace(simulation, rig_ride(1), False)
    expected = 20.0 + 40.0 * np.clip((trace.inputs.current - 0.3) / 0.4, 0.0, 1.0)
    early, late = (replace(trace, usable=trace.usable & (side > 0)) for side in (4 - trace.time_s, trace.time_s - 4))
    for part in (trace, early, late):
        root = np.sqrt(np.mean(expected[part.usable] ** 2))
        assert add_own_error(simulation, part).own_error_N == pytest.approx(
            EvidenceLimits.UNSEEN * root / 1.645, rel=0.02
        )
    assert add_own_error(ModelSimulation(plain_damper()), trace) is trace
    assert add_own_error(FunctionSimulation("f", lambda t, x, i: x), trace) is trace


@pytest.mark.slow
def test_it_is_saved_under_the_name_that_results_use(tmp_path):
    saved = identified().save(tmp_path / "model.json")
    assert saved.name == str(tmp_path / "model.json")
    assert load_model(tmp_path / "model.json").body == saved.model.body


def test_it_needs_references():
    with pytest.raises(GapError, match="without references"):
        identify_baseline([])
