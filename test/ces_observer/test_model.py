"""Model files: what is written is read back, and what is wrong is named in one line."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from copy import deepcopy
from random import Random

import pytest
from bands import BAND
from damper_models import plain_damper
from hydraulic_models import GROOVE, hydraulic_model, make_hydraulic, random_hydraulic
from mixture_models import mixture_model
from model_examples import make_model
from physical_models import FITTED, LINEAR, SEEDS, fitted_model
from physical_twins import hydraulic_forces
from recurrent_models import make_recurrent, recurrent_model
from trained_models import experts_model, fuzzy_model, network_model

from ces_observer.errors import CesError, ModelError
from ces_observer.model import load_model, parse_model
from ces_observer.structures.constructed_inputs import Frequency, Hysteresis, Lag, make_memberships
from ces_observer.structures.polynomial import Factor, Term


def broken(change):
    raw = json.loads(make_model().to_json())
    change(raw)
    return json.dumps(raw)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.pop("terms"), "key 'terms' is missing"),
        (lambda m: m["sampling"].pop("rate_Hz"), "sampling: key 'rate_Hz' is missing"),
        (lambda m: m.update(schema="ces-model/9"), "schema is 'ces-model/9'"),
        (lambda m: m["terms"][0]["factors"][0].update(lag=10**6), "lag is 1000000; expected a whole number from 0"),
        (lambda m: m["terms"][1]["factors"][0].update(lag=0), "lag is 0; expected a whole number from 1"),
        (lambda m: m["terms"][1]["factors"].append({"signal": "force", "lag": 1}), "more than one past force"),
        (lambda m: m["terms"][0]["factors"][0].update(signal="valve"), "signal is 'valve'; expected one of"),
        (lambda m: m.update(terms=[]), "terms is .*expected a list of 1 to"),
        (lambda m: m.update(structure="pickle"), "structure is 'pickle'"),
        (lambda m: m["input_envelope"].update(speed_m_s=[1.0, -1.0]), "speed_m_s is .*expected \\[low, high\\]"),
        (lambda m: m["sampling"].update(rate_Hz=0), "rate_Hz is 0"),
        (lambda m: m["sampling"].pop("speed_m_s"), "sampling: key 'speed_m_s' is missing"),
        (lambda m: m["sampling"].update(noise_m=0.0), "noise_m is 0.0; expected a number from 1e-12"),
        (lambda m: m["sampling"].update(stroke_m=[0.1, -0.1]), "stroke_m is .*expected \\[low, high\\]"),
        (lambda m: m["sampling"].update(frequencies_Hz=[]), "frequencies_Hz is \\[\\]"),
        (
            lambda m: m["sampling"].update(frequencies_Hz=[3.0] * 13),
            "frequencies_Hz is .*expected a list of 1 to 12 numbers",
        ),
        (
            lambda m: m["sampling"].update(frequencies_Hz=[3.0, 500.0]),
            "frequencies_Hz are .*expected 0 to half the rate",
        ),
        (lambda m: m["sampling"].update(delay_s=0.0035), "delay_s is 0.0035; expected whole ticks of 0.001 s"),
        (lambda m: m["sampling"].update(delay_s=0.021), "delay_s is 0.021; expected a number from 0 to 0.02 s"),
        (
            lambda m: m["sampling"].update(max_gap_s=9.0, rate_Hz=1e5),
            "max_gap_s spans 900000 ticks; expected at most 20000",
        ),
        (lambda m: m["sampling"].update(order=3), "sampling: unknown key 'order'"),
        (lambda m: m["sampling"].update(bandwidth_Hz=60.0), "sampling: written by .*: identify the model again$"),
    ],
)
def test_what_is_wrong_is_named(change, message):
    with pytest.raises(ModelError, match=message) as caught:
        parse_model(broken(change), "m.json")
    assert str(caught.value).startswith("m.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[1]", "null", '"x"', "[" * 100_000])
def test_what_is_not_a_model_is_refused(text):
    with pytest.raises(ModelError, match=re.escape("m.json")):
        parse_model(text, "m.json")


def test_missing_and_oversized_files_are_refused(tmp_path):
    with pytest.raises(ModelError, match="no such model file"):
        load_model(tmp_path / "none.json")
    (tmp_path / "big.json").write_text(" " * 1_000_001)
    with pytest.raises(ModelError, match="at most 1000000"):
        load_model(tmp_path / "big.json")


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "m.json"
    make_model().save(path)
    before = path.read_text()

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("ces_observer.json_text.os.fsync", fail)
    with pytest.raises(CesError, match="No space left"):
        make_model(force_envelope_N=(-1.0, 1.0)).save(path)
    assert path.read_text() == before
    assert [p.name for p in tmp_path.iterdir()] == ["m.json"]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(CesError, match=r"none.m\.json: cannot be written"):
        make_model().save(tmp_path / "none" / "m.json")


def test_a_file_of_an_earlier_version_with_two_models_is_refused():
    raw = json.loads(make_model().to_json()) | {"delayed": {"delay_s": 0.003}}
    with pytest.raises(ModelError, match=r"m\.json: holds a second model in the key 'delayed'; expected one model"):
        parse_model(json.dumps(raw), "m.json")


# ---------------- Model files of every structure: what is written is read back, and no number that cannot be is read.


CONSTRUCTED = (
    Hysteresis("hysteresis", "stop", "position", 0.002),
    Lag("valve", "current", 0.008),
    Frequency("frequency", 0.25, (0.5, 20.0), 1e-4),
    *make_memberships("by_current", "current", (0.2, 0.5, 1.1)),
)
TERMS = tuple(Term(1.0, (Factor(made.name, 0, 1.0, False, made),)) for made in CONSTRUCTED)
MODELS = {  # with the size that each tells
    "polynomial": (make_model(), "3 terms"),
    "a band": (make_model(band=BAND), "3 terms"),
    "a measured speed": (plain_damper(motion="speed", motion_noise=2e-3), "3 terms"),
    "constructed inputs": (
        make_model(terms=tuple(Term(1.0, (Factor(made.name, 0, 1.0, False, made),)) for made in CONSTRUCTED)),
        "6 terms",
    ),
    "network": (network_model(), "2 sigmoid units on 5 regressors"),
    "fuzzy": (fuzzy_model(), "4 rules on 5 regressors"),
    "experts": (experts_model(), "3 experts on 3 inputs"),
    "recurrent": (recurrent_model(), "2 networks with 12 filters, "),
    "recurrent, no current": (recurrent_model(make_recurrent(current=False)), "2 networks with 10 filters, "),
    "mixture": (mixture_model(), "mean of 3 models: 0.30 polynomial (3 terms), 0.45 recurrent ("),
    "uniflow": (hydraulic_model(LINEAR), "uniflow, 2 curves of the external valve"),
    "twin tube": (
        hydraulic_model(make_hydraulic(LINEAR.valve, bypass=GROOVE)),
        "twin tube, 3 curves of the piston valve, bypass",
    ),
}
NO_NUMBERS = (math.nan, math.inf, -1e300, 1e300, True, "1")


@pytest.mark.parametrize("name", MODELS)
def test_a_saved_model_reads_back_equal(name, tmp_path):
    model, size = MODELS[name]
    model.save(tmp_path / "m.json")
    again = load_model(tmp_path / "m.json")
    assert again == model and again.digest() == model.digest()
    assert again.size.startswith(size)


def numbers(node, key: str = "") -> Iterator[tuple[str, object, object]]:
    """Yield the key above each number in a file, and where it is; of a list the last one."""
    pairs = node.items() if isinstance(node, dict) else [(len(node) - 1, node[-1])] if node else []
    for place, value in pairs:
        name = place if isinstance(node, dict) else key
        if isinstance(value, dict | list):
            yield from numbers(value, name)
        elif isinstance(value, float):
            yield name, node, place


@pytest.mark.parametrize("name", MODELS)
def test_what_cannot_be_a_number_is_refused_by_its_key(name):
    raw = json.loads(MODELS[name][0].to_json())
    found = list(numbers({key: part for key, part in raw.items() if key not in ("provenance", "certificate")}))
    assert len(found) > 10
    for key, node, place in found:
        before = node[place]
        for value in NO_NUMBERS:
            node[place] = value
            with pytest.raises(ModelError, match=key) as caught:
                parse_model(json.dumps(raw), "m.json")
            assert str(caught.value).startswith("m.json") and "\n" not in str(caught.value)
        node[place] = before


# ---------------- Model files of hydraulic networks: what is written is read back, and each wrong key gives one line.


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
