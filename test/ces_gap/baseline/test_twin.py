"""The twin of a simulation: fitted to the force of a known network, stored, and used for differences only."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from twin_traces import MADE, traced

from ces_data.arrays import F
from ces_gap.baseline import twin_fit
from ces_gap.baseline.twin import Twin, make_run
from ces_gap.baseline.twin_fit import find_column, find_twin, fit_twin, place_current_nodes
from ces_gap.effects.effect import Composition, Setting
from ces_gap.effects.library.leakage import PastPiston
from ces_gap.effects.library.mount_compliance import SeriesMount
from ces_gap.grid import rms
from ces_observer.errors import ModelError

LEAK = Composition((Setting(PastPiston(), (3e-5,)),))


HEAVY = replace(MADE.body, side=replace(MADE.body.side, mass_kg=3.0))
RINGING = replace(MADE, body=HEAVY, column_s2=(2.0 * np.pi * 120.0) ** -2)


@pytest.fixture(scope="module")
def fitted() -> Twin:
    twin = fit_twin([traced(seed=1), traced(seed=2)])
    assert twin is not None
    return twin


def test_the_recorded_force_is_exact_and_changes_are_the_twins() -> None:
    trace = replace(traced(), simulated=traced().simulated + 100.0)  # which the twin does not know
    alone = MADE.prepare_for(trace)
    np.testing.assert_array_equal(alone.force(trace, trace.inputs), trace.simulated)
    np.testing.assert_array_equal(alone.error_of_change(trace, trace.inputs), 0.0)
    equal = replace(trace.inputs, position=trace.inputs.position.copy())
    np.testing.assert_allclose(alone.force(trace, equal), trace.simulated, atol=1e-6)
    wider = trace.inputs.with_position(1.1 * trace.inputs.position, trace.rate_Hz)
    change = alone.force(trace, wider) - trace.simulated
    known = MADE.prepare_for(replace(trace, simulated=alone.recorded_force))
    np.testing.assert_allclose(change, known.force(trace, wider) - alone.recorded_force, atol=2.0)
    assert rms(change) > 20.0
    np.testing.assert_allclose(alone.error_of_change(trace, wider), 0.1 * np.abs(change))


def test_a_delay_moves_the_error_in_time() -> None:
    """What the twin does not know of the simulated force comes as late as all of it."""
    trace = traced()
    wave = 40.0 * np.sin(2.0 * np.pi * 2.0 * trace.time_s)
    own, late_s = replace(trace, simulated=trace.simulated + wave), 0.01
    late = np.interp(trace.time_s - late_s, trace.time_s, trace.inputs.position)
    inputs = trace.inputs.with_position(late, trace.rate_Hz)
    error = (MADE.force(own, inputs) - MADE.force(trace, inputs))[100:-100]
    np.testing.assert_allclose(error, np.interp(trace.time_s - late_s, trace.time_s, wave)[100:-100], atol=1.0)


def test_effects_inside_act_at_changed_inputs_too() -> None:
    trace = traced()
    slower = trace.inputs.with_position(0.8 * trace.inputs.position, trace.rate_Hz)
    here, there = (MADE.change(trace, inputs, LEAK) for inputs in (trace.inputs, slower))
    assert rms(here) > 5.0 and rms(there) > 5.0 and rms(here - there) > 5.0
    nothing = Composition((Setting(PastPiston(), (0.0,)),))
    np.testing.assert_allclose(MADE.change(trace, slower, nothing), 0.0, atol=0.5)


def test_a_twin_is_read_as_it_was_written() -> None:
    document = json.loads(json.dumps(RINGING.as_json()))
    assert Twin.from_json(document) == RINGING
    assert Twin.from_json({k: v for k, v in document.items() if k != "column_s2"}) == replace(RINGING, column_s2=0.0)
    with pytest.raises(ModelError, match="expected ces-twin"):
        Twin.from_json({**document, "schema": "ces-model/1"})
    with pytest.raises(ModelError):
        Twin.from_json({**document, "tick_s": 0.0})


def test_a_column_of_oil_is_seen_in_the_error_of_a_twin_without_one() -> None:
    """Its frequency is right to a fifth. Another error, as of a leak, does not ask for one."""
    plain, traces = replace(RINGING, column_s2=0.0), [traced(RINGING, seed) for seed in (1, 2)]
    assert find_column(plain, traces) == pytest.approx(RINGING.column_s2, rel=0.4)
    leaking = LEAK.edit(make_run(plain, traced(plain))).body
    assert find_column(plain, [traced(replace(plain, body=leaking))]) == 0.0


def test_a_softer_mount_lowers_the_frequency_of_a_column() -> None:
    run = make_run(RINGING, traced())
    assert run.soften(1e-6).column_s2 == pytest.approx(RINGING.column_s2 + RINGING.body.side.mass_kg * 1e-6)
    assert make_run(MADE, traced()).soften(1e-6).column_s2 == 0.0


@pytest.mark.slow
def test_a_twin_of_a_network_with_a_column_has_its_mass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(twin_fit, "KINDS", ("twin tube",))
    twin = fit_twin([traced(RINGING, seed) for seed in (1, 2)], 2)
    assert twin is not None and twin.cost_J < 3.0
    assert twin.column_s2 == pytest.approx(RINGING.column_s2, rel=0.4)
    assert twin.body.side.mass_kg == pytest.approx(RINGING.body.side.mass_kg, rel=0.2)


def test_nodes_lie_where_currents_are_frequent_and_one_beyond() -> None:
    def place(*levels: float) -> list[float]:
        current: F = np.repeat(levels, 100)
        return [round(float(node), 3) for node in place_current_nodes(current)]

    assert place(0.2, 0.5, 1.1) == [-0.1, 0.2, 0.5, 1.1, 1.7]
    assert place(0.5) == [0.25, 0.5, 0.75]
    assert place(0.0) == [-0.1, 0.0, 0.1]


def test_without_motion_there_is_no_twin() -> None:
    still = traced(moving=False)
    assert fit_twin([replace(still, simulated_at_base=np.zeros_like(still.time_s))]) is None


def test_ctrl_c_leaves_no_twin_that_is_half_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    def press(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(twin_fit.PhysicalSearch, "_fit_kind", press)
    with pytest.raises(KeyboardInterrupt):
        fit_twin([traced()])


@pytest.mark.slow
def test_a_twin_of_a_network_is_close_to_it(fitted: Twin) -> None:
    trace = traced(seed=3)
    own, made = fitted.prepare_for(trace), MADE.prepare_for(trace)
    assert fitted.cost_J < 3.0 and fitted.body.kind in twin_fit.KINDS
    assert rms(own.recorded_force - made.recorded_force) < 0.05 * rms(made.recorded_force)
    soft = Composition((Setting(SeriesMount(), (1e6,)),))
    wanted = made.change(trace, trace.inputs, soft)
    assert rms(own.change(trace, trace.inputs, soft) - wanted) < 0.2 * rms(wanted)


@pytest.mark.slow
def test_a_stored_twin_is_used_again(fitted: Twin, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    calls = []
    monkeypatch.setattr(twin_fit, "fit_twin", lambda *_: calls.append(0) or fitted)
    one, other = [traced(seed=1)], [traced(seed=2)]
    assert find_twin(one) == find_twin(one) == fitted and len(calls) == 1
    find_twin(other)
    assert len(calls) == 2
    for stored in (tmp_path / "ces_observer" / "twins").iterdir():
        stored.write_text("{")
    assert find_twin(one) == fitted and len(calls) == 3


@pytest.mark.slow
def test_a_twin_knows_a_constant_current() -> None:
    twin = fit_twin([traced(seed=1, current_A=0.5)])
    assert twin is not None and twin.cost_J < 3.0
