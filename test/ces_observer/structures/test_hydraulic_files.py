"""Model files of hydraulic networks: what is written is read back, and each wrong key gives one line."""

from __future__ import annotations

import json
from copy import deepcopy
from random import Random

import pytest
from hydraulic_models import GROOVE, hydraulic_model, make_hydraulic, random_hydraulic
from physical_models import FITTED, LINEAR, SEEDS, fitted_model
from physical_twins import hydraulic_forces

from ces_observer.errors import ModelError
from ces_observer.model import load_model, parse_model

MODEL = hydraulic_model(make_hydraulic(LINEAR.valve, bypass=GROOVE))
RAW = json.loads(MODEL.to_json())
SIDE = RAW["hydraulic"]["side"]
EDGE = {"flow_m_s": [-1.0, 0.0, 1.0], "force_N": [[-9.0, 0.0, 9.0]]}

REFUSALS = [
    ("", "kind", "triple tube", "kind is 'triple tube'; expected one of uniflow, twin tube, monotube"),
    ("", "kind", ["uniflow"], "kind is"),
    ("", "valve", {}, "valve: key 'current_A' is missing"),
    ("", "reach", 0.9, "reach is 0.9; expected a number from 1 to 10"),
    ("", "extra", 1.0, "unknown key 'extra'"),
    ("", "base", {**EDGE, "flow_m_s": [-1.0, 0.5, 1.0]}, "base: no node at flow_m_s 0 with force_N 0"),
    ("", "piston", {**EDGE, "force_N": [[-9.0, 0.1, 9.0]]}, "piston: no node at flow_m_s 0 with force_N 0"),
    ("", "external", {**EDGE, "force_N": [[-9, 0, 9], [-9, 9, 10]]}, "external: no node at flow_m_s 0"),
    ("piston", "force_N", [[0.0, 1.0]], "force_N is .*; expected a list of 19"),
    ("piston", "force_N", "x", "force_N is .*; expected a list of 1 to 16 lists"),
    ("piston", "force_N", [], "force_N is .*; expected a list of 1 to 16 lists"),
    ("piston", "flow_m_s", [-1.0, 0.0, 0.0, 1.0], "flow_m_s does not rise"),
    ("piston", "flow_m_s", [-1.0, 0.0, 1e-13, 1.0], "flow_m_s does not rise"),
    ("", "base", {**EDGE, "force_N": [[-9.0, 0.0, -1.0]]}, "base: force_N does not rise"),
    ("", "base", {**EDGE, "flow_m_s": [-1e-300, 0.0, 1e-300]}, "base: a slope of 9e.300 from"),
    ("bypass", "opening", [0.0, 1.0, -1.0, 0.0, 0.0], r"opening\[0\] is 0.0; expected a number from 1e-12"),
    ("bypass", "opening", [1.0, 1.0], "opening is .*; expected a list of 5"),
    ("bypass", "position_m", [0.0, 0.0], "bypass: position_m does not rise"),
    ("bypass", "position_m", [0.0, 1e-300, 1.0, 2.0, 3.0], "bypass: .*does not rise"),
    ("valve", "current_A", [0.0], "current_A is .*; expected a list of 2 to 64 numbers"),
    ("valve", "current_A", [1.0, 0.0], "valve: current_A does not rise from number to number"),
    ("valve", "setting", [0.0, 0.5, 1.0], "setting is .*; expected a list of 2"),
    ("valve", "setting", [0.0, 0.5], "setting runs from 0 to 0.5; expected 0 to 1"),
    ("side", "position_m", [0.0, 0.0], "side: position_m does not rise"),
    ("", "side", {**SIDE, "position_m": [0.0, 1e-300], "gas_N": [0.0, 1.0]}, "a slope of 1e.300 from 0 on; expected 0"),
    ("side", "friction", [{}], "key 'stiffness_N_m' is missing"),
    ("side", "friction", [{"stiffness_N_m": 1.0, "yield_N": 1.0, "moved_N": -1.0}], "moved_N is -1.0"),
    ("side", "friction", [{}] * 9, "friction is .*; expected a list of 0 to 8 mappings"),
]


def test_what_is_written_is_read_back(tmp_path):
    for body in (MODEL.body, LINEAR, *(random_hydraulic(Random(seed)) for seed in range(20))):
        model = hydraulic_model(body)
        model.save(tmp_path / "model.json")
        assert load_model(tmp_path / "model.json") == model
    assert MODEL.size == "twin tube, 3 curves of the piston valve, bypass"
    assert hydraulic_model(LINEAR).size == "uniflow, 2 curves of the external valve"


@pytest.mark.parametrize("name", FITTED)
def test_fitted_models_are_read_and_written_back(name):
    model = fitted_model(name)
    assert model.to_json() == (SEEDS / f"{name}.json").read_text(encoding="utf-8")
    inputs = [(0.01 * (-1) ** (k // 9), 0.3 * (-1) ** (k // 7), 0.3 + 0.01 * k) for k in range(30)]
    run = model.make_predictor()
    assert [run.tick(*one) for one in inputs] == pytest.approx(hydraulic_forces(model, inputs), rel=1e-9, abs=1e-6)


@pytest.mark.parametrize(("part", "key", "value", "message"), REFUSALS)
def test_a_wrong_value_gives_one_line(part, key, value, message):
    raw = deepcopy(RAW)
    node = raw["hydraulic"][part] if part else raw["hydraulic"]
    node[key] = value
    with pytest.raises(ModelError, match=message) as caught:
        parse_model(json.dumps(raw), "m.json")
    assert str(caught.value).startswith("m.json: hydraulic") and "\n" not in str(caught.value)


def test_a_missing_key_is_named():
    for key in RAW["hydraulic"]:
        raw = deepcopy(RAW)
        del raw["hydraulic"][key]
        with pytest.raises(ModelError, match=f"'{key}' is missing|{key} is None"):
            parse_model(json.dumps(raw), "m.json")


@pytest.mark.parametrize("name", ["relaxation", "chambers"])
def test_models_of_structures_that_are_gone_must_be_identified_again(name):
    text = json.dumps({**RAW, "structure": name, name: {}})
    with pytest.raises(ModelError, match=rf"^m\.json: structure is '{name}'.*'hydraulic'.*identify the model again$"):
        parse_model(text, "m.json")
