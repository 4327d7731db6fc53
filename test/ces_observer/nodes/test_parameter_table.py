"""Values of parameters are checked against the table, and the shipped file says nothing that it does not know."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from ces_observer.errors import CesError
from ces_observer.nodes.parameter_table import DAMPERS, NAME, OF_A_DAMPER, OF_THE_NODE, find_unknown
from ces_observer.signals import NAMES, Signals

SPECS = {spec.name: spec for spec in (*OF_THE_NODE, *OF_A_DAMPER, NAME)}
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
        ("executor", "many", "'executor' is 'many'; expected one of auto, events, single"),
        ("max_age_s", -0.1, "'max_age_s' is -0.1; expected a number from 0 to 3600"),
        ("max_age_s", "soon", "'max_age_s' is 'soon'; expected a number"),
        ("max_age_s", float("nan"), "'max_age_s' is nan; expected a number from 0 to 3600"),
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


def test_a_whole_number_will_do_for_a_number() -> None:
    value = SPECS["max_age_s"].check_parameter(1, "max_age_s")
    assert (value, type(value)) == (1.0, float)


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
