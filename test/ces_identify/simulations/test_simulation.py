"""Simulations by functions, recorded predictions and models: forces, numbers that they declare, and failures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmus import algebraic_fmu, changed
from hydraulic_models import GROOVE, hydraulic_model, make_hydraulic
from model_examples import make_model
from physical_examples import make_valve

from ces_data.recording import Channel, Recording
from ces_gap.baseline.wrappers import InputTiming, RetimedSimulation
from ces_identify.simulations.fmu import open_fmu
from ces_identify.simulations.simulation import (
    FunctionSimulation,
    ModelSimulation,
    Parameter,
    RecordedSimulation,
    function_simulation,
)
from ces_observer.errors import CesError

STAMPS = np.arange(100) * 1_000_000 + 5


def recording(**more):
    x = np.linspace(0, 1, 100)
    x[3] = np.nan
    channels = {
        "position": Channel("position", "m", STAMPS, x),
        "current": Channel("current", "A", STAMPS, np.full(100, 0.5)),
    }
    return Recording("made", {**channels, **more})


def test_a_function_gets_time_from_the_first_sample_and_answers_for_every_good_one():
    force = FunctionSimulation("f", lambda t, x, i: 1e3 * t + 10 * x + i).force(recording())
    assert np.isnan(force[3])
    np.testing.assert_allclose(force[4], 4.0 + 10 * 4 / 99 + 0.5)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda t, x, i: 1 / 0, "f: raised ZeroDivisionError"),
        (lambda t, x: x, r"f: raised TypeError: .*; it gets \(time_s, position_m, current_A\)"),
        (lambda t, x, i: x[:-1], r"f: returned shape \(98,\); expected \(99,\)"),
        (lambda t, x, i: x * np.nan, "f: returned nan at 0.000 s"),
    ],
)
def test_a_function_that_fails_is_named(function, message):
    with pytest.raises(CesError, match=message):
        FunctionSimulation("f", function).force(recording())


def test_functions_are_imported_by_name():
    assert function_simulation("numpy:hypot").function is np.hypot
    with pytest.raises(CesError, match="cannot be imported"):
        function_simulation("numpy:nothing")
    with pytest.raises(CesError, match="expected function"):
        function_simulation("numpy:pi")


def test_recorded_predictions_are_interpolated():
    predicted = Channel("sim_force", "N", STAMPS[::2], np.arange(50) * 2.0)
    force = RecordedSimulation("/p").force(recording(sim_force=predicted))
    np.testing.assert_allclose(force[:5], [0, 1, 2, 3, 4])
    with pytest.raises(CesError, match="no predictions on topic /p"):
        RecordedSimulation("/p").force(recording())


def force(time_s, position_m, current_A, *, seal_N=25.0, chambers=2, hot=False, oil="A", open_end=np.inf, none=None):
    return np.full_like(position_m, seal_N * chambers)


def test_a_function_declares_the_numbers_among_its_keyword_only_arguments():
    simulation = FunctionSimulation("f", force)
    assert simulation.parameters == (Parameter("seal_N", 25.0), Parameter("chambers", 2.0, whole=True))
    changed = simulation.with_values({"seal_N": 30.0}).with_values({"chambers": 3.0})
    assert changed.parameters[0].default == 30.0
    assert np.nanmax(changed.force(recording())) == 90.0
    assert changed.values["chambers"] == 3 and isinstance(changed.values["chambers"], int)
    assert FunctionSimulation("f", lambda t, x, i: x).parameters == ()


def test_what_wraps_a_simulation_has_its_parameters():
    late = RetimedSimulation(FunctionSimulation("f", force), InputTiming(0.5))
    assert late.with_values({"seal_N": 50.0}).parameters[0].default == 50.0
    assert np.nanmax(late.with_values({"seal_N": 50.0}).force(recording())) == 100.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def force(time_s, position_m, current_A:\n", "SyntaxError"),
        ("import sys\nsys.exit('no licence')\n", "SystemExit: no licence"),
        ("1 / 0\n", "ZeroDivisionError"),
    ],
)
def test_a_users_file_that_cannot_be_imported_is_one_line(text, message, tmp_path: Path, monkeypatch):
    name = f"broken_{abs(hash(text))}"
    (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(CesError, match=message) as raised:
        function_simulation(f"{name}:force")
    assert "\n" not in str(raised.value)


def test_a_users_function_that_ends_the_program_is_one_line():
    with pytest.raises(CesError, match="f: raised SystemExit: 3"):
        FunctionSimulation("f", lambda t, x, i: (_ for _ in ()).throw(SystemExit(3))).force(recording())


@pytest.mark.slow
@pytest.mark.needs("cc")
def test_the_parameters_of_an_fmu_are_set_before_it_starts(tmp_path):
    pytest.importorskip("fmpy")
    declared = (
        '<ScalarVariable name="gain" valueReference="4" causality="parameter" variability="fixed">'
        '<Real unit="mm" start="1.5" min="0.5" max="4"/></ScalarVariable></ModelVariables>'
    )
    source = {"in[3]": "in[5] = {0, 0, 0, 0, 1.5}", "out = 1500.0": "out = 1000.0 * in[4]"}
    source |= {"memset(in, 0, sizeof in);": "in[0] = in[1] = in[2] = 0; in[4] = 1.5;"}
    path = changed(algebraic_fmu(tmp_path, changes=source), {"</ModelVariables>": declared})
    fmu = open_fmu(str(path))
    assert fmu.parameters == (Parameter("gain", 1.5, 0.5, 4.0, "mm"),)
    doubled = fmu.with_values({"gain": 3.0})
    assert doubled.parameters[0].default == 3.0
    at_rest = fmu.with_values({"gain": 0.0}).force(recording())
    np.testing.assert_allclose(doubled.force(recording()) - at_rest, 2.0 * (fmu.force(recording()) - at_rest))


MODEL = hydraulic_model(make_hydraulic(make_valve()))
SIMULATION = ModelSimulation(MODEL)
NAMES = [
    *("compression_valve", "rebound_valve", "base_valve", "current_gain", "leak_m_s_rtN", "oil_stiffness", "gas_rate"),
    *("gas_force_change_N", "friction_N", "valve_lag_s"),
]


def sine(current_A: float = 0.5, hertz: float = 2.0) -> Recording:
    t = np.arange(2000) / 1000.0
    stamps = np.round(t * 1e9).astype(np.int64)
    signals = {"position": ("m", 0.012 * np.sin(2.0 * np.pi * hertz * t)), "current": ("A", np.full(2000, current_A))}
    return Recording("sine", {n: Channel(n, unit, stamps, values) for n, (unit, values) in signals.items()})


def cycle(simulation: ModelSimulation, **inputs: float) -> np.ndarray:
    """Return the force [N] of a second, at 2 Hz from the end of the rebound."""
    return simulation.force(sine(**inputs))[875:1875]


def test_a_twin_tube_has_its_valves_oil_gas_friction_and_lag():
    assert [p.name for p in SIMULATION.parameters] == NAMES
    defaults = {p.name: p.default for p in SIMULATION.parameters}
    assert (defaults["friction_N"], defaults["gas_rate"]) == (18.0, 1.0)
    assert defaults["valve_lag_s"] == pytest.approx(6.5e-3)
    uniflow = hydraulic_model(make_hydraulic(make_valve(), kind="uniflow"))
    assert [p.name for p in ModelSimulation(uniflow).parameters if "valve" in p.name] == [
        "external_valve",
        "valve_lag_s",
    ]


@pytest.mark.parametrize("bypass", [None, GROOVE])
def test_with_its_defaults_the_force_stays(bypass):
    simulation = ModelSimulation(hydraulic_model(make_hydraulic(make_valve(), bypass=bypass)))
    same = simulation.with_values({p.name: p.default for p in simulation.parameters})
    np.testing.assert_allclose(cycle(same), cycle(simulation), atol=1e-6)
    assert simulation.with_values({}) is simulation


def test_a_valve_is_softer_in_its_direction_only():
    softer = cycle(SIMULATION.with_values({"rebound_valve": 0.8})) / cycle(SIMULATION)
    compression, rebound = softer[100:200].mean(), softer[350:450].mean()
    assert compression == pytest.approx(1.0, abs=0.03) and 0.75 < rebound < 0.9


def test_values_replace_those_before_and_become_the_defaults():
    twice = SIMULATION.with_values({"rebound_valve": 0.5, "gas_rate": 2.0}).with_values({"rebound_valve": 0.8})
    changed = {p.name: p.default for p in twice.parameters if p not in SIMULATION.parameters}
    assert changed == {"rebound_valve": 0.8, "gas_rate": 2.0}
    np.testing.assert_array_equal(cycle(twice), cycle(SIMULATION.with_values({"gas_rate": 2.0, "rebound_valve": 0.8})))


def test_gas_oil_friction_and_leak_do_what_they_say():
    def change(name: str, value: float, **inputs: float) -> np.ndarray:
        return cycle(SIMULATION.with_values({name: value}), **inputs) - cycle(SIMULATION, **inputs)

    np.testing.assert_allclose(change("gas_force_change_N", 30.0), 30.0, atol=1e-6)
    position = sine().channel("position").values[875:1875]
    gas = np.interp(position, MODEL.body.side.position_m, MODEL.body.side.gas_N)
    np.testing.assert_allclose(change("gas_rate", 1.5), 0.5 * gas, atol=1e-2)
    assert np.abs(change("friction_N", 28.0, hertz=0.1)).max() == pytest.approx(10.0, rel=0.15)
    force = cycle(SIMULATION, hertz=8.0)
    assert np.ptp(change("leak_m_s_rtN", 2e-3)) > 50.0 and np.ptp(cycle(SIMULATION.with_values({"leak_m_s_rtN": 2e-3})))
    assert change("oil_stiffness", 0.2, hertz=8.0) @ np.gradient(force) < 0.0  # the force comes later


def test_the_current_moves_more_at_a_higher_gain():
    def moved(simulation: ModelSimulation) -> float:
        return float(np.ptp(cycle(simulation, current_A=0.3)) - np.ptp(cycle(simulation, current_A=0.1)))

    assert moved(SIMULATION.with_values({"current_gain": 1.3})) == pytest.approx(1.3 * moved(SIMULATION), rel=0.1)


def test_a_changed_model_is_not_held_at_the_forces_of_the_one_identified():
    low = replace(MODEL, force_envelope_N=(-700.0, 700.0))
    assert np.abs(cycle(ModelSimulation(low), hertz=4.0)).max() <= 700.0
    stiffer = ModelSimulation(low).with_values({"compression_valve": 2.0})
    assert np.abs(cycle(stiffer, hertz=4.0)).max() > 1000.0


def test_another_structure_has_no_parameters():
    simulation = ModelSimulation(make_model())
    assert simulation.parameters == () and simulation.with_values({}) is simulation
