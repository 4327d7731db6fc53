"""Values of parameters are checked against the table, and the shipped file says nothing that it does not know."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from parameter_cases import AT_START, CASES

from ces_observer.errors import CesError
from ces_observer.model import load_model
from ces_observer.nodes.parameter_table import (
    DAMPERS,
    NAME,
    OF_A_DAMPER,
    OF_THE_CONTROLLER,
    OF_THE_NODE,
    check_value,
    find_unknown,
    signal_options,
)
from ces_observer.signals import NAMES, Signals

SPECS = {spec.name: spec for spec in (*OF_THE_NODE, *OF_A_DAMPER, NAME)}
OF_SIGNALS = {spec.name: spec for spec in signal_options("position", {})}
SHIPPED = Path(__file__).parents[3] / "config" / "observer.yaml"


def shipped() -> dict[str, object]:
    parameters: dict[str, object] = yaml.safe_load(SHIPPED.read_text())["/**"]["ros__parameters"]
    return parameters


@pytest.mark.parametrize("name", SPECS)
def test_defaults_are_allowed_and_described(name: str) -> None:
    spec = SPECS[name]
    assert spec.check_parameter(spec.default, name) == spec.default
    assert len(spec.meaning) > 20


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("cost_window_s", 2, "'cost_window_s' is 2; expected a whole number from 3 to 3600"),
        ("cost_window_s", 5.0, "'cost_window_s' is 5.0; expected a whole number"),
        ("allow_uncertified", 1, "'allow_uncertified' is 1; expected true or false"),
        ("model", None, "'model' is None; expected a text"),
    ],
)
def test_wrong_values_say_what_was_expected(name: str, value: object, text: str) -> None:
    with pytest.raises(CesError) as caught:
        SPECS[name].check_parameter(value, name)
    assert text in str(caught.value)


def test_values_of_another_type_or_range_are_refused_in_the_words_of_both_nodes() -> None:
    at_start = [(name, kind, yaml.safe_load(text), words) for words, (name, kind, text) in AT_START.items()]
    of_the_table = [case for case in (*CASES, *at_start) if case[0] in SPECS | OF_SIGNALS]
    assert len(of_the_table) > 30
    for name, kind, value, words in of_the_table:
        if any(other in words for other in ("cannot be set", "10001", "unknown type")):
            continue  # said before the table is asked
        said = ""
        try:
            check_value((SPECS | OF_SIGNALS)[name], name, kind.replace(" ", "_").upper(), value)
        except CesError as error:
            said = str(error)
        assert said == words


def test_unknown_names_are_reported():
    names = ["model", "modle", "front.model", "front.modle", "front.position.field", "rear.model", "current.constant"]
    names += ["use_sim_time", "qos_overrides./parameter_events.publisher.depth"]
    assert find_unknown(names, SPECS, NAMES, ["front"]) == ["modle", "front.modle", "rear.model"]
    assert find_unknown(["model.topic"], ["model"]) == ["model.topic"]


def test_the_shipped_file_shows_the_defaults() -> None:
    parameters = shipped()
    assert set(parameters) <= {*SPECS, *NAMES, "use_sim_time", DAMPERS}
    for name, spec in SPECS.items():
        if name != "model":
            assert parameters[name] == spec.default, name
    signals = {name: parameters[name] for name in ("position", "current", "force")}
    assert Signals.from_mapping(signals, "shipped").by_name == Signals.from_mapping({}, "defaults").by_name


# ------------------- The controller's shipped_ct parameter file and sample model say what the code takes for granted.


CONFIG = Path(__file__).resolve().parents[3] / "config"
NOT_IN_THE_FILE = {"model"}


def shipped_ct() -> dict[str, Any]:
    given = yaml.safe_load((CONFIG / "controller.yaml").read_text(encoding="utf-8"))["/**"]["ros__parameters"]
    curve = {f"curve.{key}": points for key, points in given.pop("curve").items()}
    return {**given, **curve}


def test_the_file_shows_every_parameter_at_its_default() -> None:
    given = shipped_ct()
    assert given.pop("use_sim_time") is False
    defaults = {spec.name: spec.default for spec in OF_THE_CONTROLLER}
    assert given == {name: value for name, value in defaults.items() if name not in NOT_IN_THE_FILE}


def test_the_sample_model_is_proved_stable_and_tells_where_it_is_from() -> None:
    model = load_model(CONFIG / "models" / "sample.json")
    assert model.is_stable()
    assert [one["recording"] for one in model.provenance["identification"]] == ["noise", "sweep", "road"]
