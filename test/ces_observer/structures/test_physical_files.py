"""Model files of relaxation and chambers: what is written is read back, and each wrong key gives one line."""

from __future__ import annotations

import json
from copy import deepcopy

import pytest
from physical_models import CHAMBERS, FITTED, RELAXATION, SEEDS, fitted_model, physical_model

from ces_observer.errors import ModelError
from ces_observer.model import load_model, parse_model

BODIES = {"relaxation": RELAXATION, "chambers": CHAMBERS}
RAW = {name: json.loads(physical_model(body).to_json()) for name, body in BODIES.items()}
SIDE = RAW["chambers"]["chambers"]["side"]
CURVE = {"drop_N": [-1.0, 0.0, 1.0], "flow_m_s": [-1.0, 0.0, 1.0]}

REFUSALS = [
    ("", "valve", {}, "valve: key 'current_A' is missing"),
    ("", "reach", 0.9, "reach is 0.9; expected a finite number from 1 to 10"),
    ("", "reach", 11.0, "reach is 11.0"),
    ("", "extra", 1.0, "unknown key 'extra'"),
    ("valve", "current_A", [0.0], "current_A is .*; expected a list of 2 finite numbers"),
    ("valve", "current_A", [1.0, 0.0], "valve: current_A does not rise from number to number"),
    ("valve", "setting", [0.0, 0.5, 1.0], "setting is .*; expected a list of 2"),
    ("valve", "delay_ticks", -1.0, "delay_ticks is -1.0"),
    ("valve", "delay_ticks", 1000.0, "delay_ticks is 1000.0"),
    ("valve", "hysteresis_A", -0.1, "hysteresis_A is -0.1"),
    ("valve", "rise_s", 2.0, "rise_s is 2.0"),
    ("valve", "fall_s", None, "fall_s is None"),
    ("map", "force_N", [[0.0, 1.0]], "force_N has no 2 to 16 lists"),
    ("map", "force_N", "x", "force_N has no 2 to 16 lists"),
    ("side", "lead_s", 1.0, "lead_s is 1.0"),
    ("side", "max_acceleration_m_s2", -1.0, "max_acceleration_m_s2 is -1.0"),
    ("side", "viscous_Ns_m", -1.0, "viscous_Ns_m is -1.0"),
    ("side", "mass_kg", True, "mass_kg is True"),
    ("side", "position_m", [0.0, 0.0], "side: position_m does not rise"),
    ("", "side", {**SIDE, "position_m": [0.0, 1e-300], "gas_N": [0.0, 1.0]}, "a slope of 1e.300 from 0 on; expected 0"),
    ("side", "gas_N", [0.0, 1e10], "gas_N is"),
    ("side", "friction", [{}], "key 'stiffness_N_m' is missing"),
    ("side", "friction", [{}] * 9, "friction is .*; expected a list of 0 to 8 objects"),
]
OF_RELAXATION = [
    ("", "compliance_m_N", 0.0, "compliance_m_N is 0.0"),
    ("", "leak_m_Ns", -1.0, "leak_m_Ns is -1.0"),
    ("", "springs", [{"stiffness_N_m": 0.0, "yield_N": [1.0, 1.0]}], "stiffness_N_m is 0.0"),
    ("", "springs", [{"stiffness_N_m": 1.0, "yield_N": [1.0]}], "yield_N is .*; expected a list of 2"),
    ("", "springs", [{"stiffness_N_m": 1.0, "yield_N": [1.0, -1.0]}], "yield_N has -1; expected forces from 0 on"),
    ("side", "friction", [{"stiffness_N_m": 1.0, "yield_N": 1.0}], "side has friction elements; expected none"),
    ("map", "speed_m_s", [-1.0, 0.0, 0.0, 1.0], "speed_m_s does not rise"),
    ("map", "speed_m_s", [-1.0, 0.0, 1e-13, 1.0], "speed_m_s does not rise"),
    ("map", "force_N", [[-1.0, 0.0, 1.0, 2.0], [-1.0, 2.0, 1.0, 3.0]], "force_N does not rise"),
]
OF_CHAMBERS = [
    ("", "area_ratio", -0.1, "area_ratio is -0.1"),
    ("", "compression_m_N", 0.0, "compression_m_N is 0.0"),
    ("", "rebound_m_N", 1e-13, "rebound_m_N is 1e-13"),
    ("", "mount_m_N", -1e-9, "mount_m_N is"),
    ("", "friction_growth_1_N", -1.0, "friction_growth_1_N is -1.0"),
    ("", "check", {**CURVE, "drop_N": [-1.0, 0.5, 1.0]}, "check: no node at drop_N 0 with flow_m_s 0"),
    ("", "refill", {**CURVE, "flow_m_s": [-1.0, 0.1, 1.0]}, "refill: no node at drop_N 0 with flow_m_s 0"),
    ("", "check", {**CURVE, "drop_N": [-1e-300, 0.0, 1e-300]}, "check: a slope of 1e.300 from"),
    ("", "check", {**CURVE, "flow_m_s": [-1e-16, 0.0, 1e-16]}, "a slope of 1e-16 from -1 on; expected 1e-15 to"),
    ("map", "flow_m_s", [-0.01, 0.001, 0.1, 1.0], "no node at flow_m_s 0 with force_N 0"),
    ("map", "force_N", [[-9.0, 0.0, 1.0, 2.0], [-9.0, 0.5, 1.0, 2.0]], "no node at flow_m_s 0 with force_N 0"),
]
ROWS = [(name, *row) for name in BODIES for row in REFUSALS]
ROWS += [("relaxation", *row) for row in OF_RELAXATION] + [("chambers", *row) for row in OF_CHAMBERS]


@pytest.mark.parametrize("name", BODIES)
def test_what_is_written_is_read_back(name, tmp_path):
    model = physical_model(BODIES[name])
    model.save(tmp_path / "model.json")
    assert load_model(tmp_path / "model.json") == model


@pytest.mark.parametrize("name", FITTED)
def test_fitted_models_are_read_and_written_back(name):
    assert fitted_model(name).to_json() == (SEEDS / f"{name}.json").read_text(encoding="utf-8")


@pytest.mark.parametrize(("name", "part", "key", "value", "message"), ROWS)
def test_a_wrong_value_gives_one_line(name, part, key, value, message):
    raw = deepcopy(RAW[name])
    node = raw[name][part] if part else raw[name]
    node[key] = value
    with pytest.raises(ModelError, match=message) as caught:
        parse_model(json.dumps(raw), "m.json")
    assert str(caught.value).startswith(f"m.json: {name}") and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", BODIES)
def test_a_missing_key_is_named(name):
    for key in RAW[name][name]:
        raw = deepcopy(RAW[name])
        del raw[name][key]
        with pytest.raises(ModelError, match=f"key '{key}' is missing"):
            parse_model(json.dumps(raw), "m.json")
