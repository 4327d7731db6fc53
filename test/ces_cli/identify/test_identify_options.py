"""The node's parameters are the program's options: names, and the command line built from them."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from ces_cli.identify.options import EXIT_WHEN_DONE, PARAMETERS, build_command_line
from ces_cli.identify.program import make_parser
from ces_observer.errors import CesError
from ces_observer.options import NO_WORDS

CONFIG = Path(__file__).resolve().parents[3] / "config" / "identify.yaml"
# A node does not need campaigns, clusters, cross-validation or text on standard output.
LEFT_OUT = frozenset({"campaign", "jobs", "folds", "show_candidates", "help", "json"})
BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}
DEFAULTS = {parameter.name: parameter.default for parameter in PARAMETERS}
ACTIONS = {action.dest: action for action in make_parser()._actions}


def options(**values):
    return vars(make_parser().parse_args(build_command_line({**DEFAULTS, "bags": ["one"], **values})))


def test_every_option_is_a_parameter_or_left_out_on_purpose():
    assert set(BY_NAME) | LEFT_OUT == set(ACTIONS)
    assert not set(BY_NAME) & LEFT_OUT


def test_values_arrive_unchanged(monkeypatch):
    monkeypatch.setenv("HOME", "/home/somebody")
    values = options(
        bags=["~/one", "", "two"],
        delay=0.003,
        validate=["three"],
        report="~/report.html",
        blend=["speed:-0.3,0.3", "current:0.5,1"],
        certificate=False,
        time=0.30000000000000004,
    )
    assert [str(path) for path in values["bags"]] == ["/home/somebody/one", "two"]
    assert (str(values["validate"][0]), str(values["report"])) == ("three", "/home/somebody/report.html")
    assert (values["blend"], values["certificate"]) == (["speed:-0.3,0.3", "current:0.5,1"], False)
    assert (values["time"], values["delay"]) == (0.30000000000000004, 0.003)


def test_a_value_with_a_dash_is_no_option():
    assert options(bags=["-x"], teacher="--out=elsewhere")["teacher"] == "--out=elsewhere"


def test_a_missing_recording_and_a_wrong_choice_are_named():
    with pytest.raises(CesError, match="parameter 'bags' is not set; set it to the paths of recordings"):
        build_command_line(DEFAULTS)
    with pytest.raises(CesError, match="parameter 'method' is 'best'; expected one of gauss-newton, thesis"):
        BY_NAME["method"].check_parameter("best")


def test_the_packaged_file_lists_every_parameter_with_its_default():
    parameters = yaml.safe_load(CONFIG.read_text())["/**"]["ros__parameters"]
    assert parameters.pop(EXIT_WHEN_DONE.name) is EXIT_WHEN_DONE.default
    assert {**parameters, "bags": NO_WORDS} == DEFAULTS
    assert "bags" not in parameters


def test_a_parameter_that_does_not_apply_is_refused_and_defaults_never_are():
    with pytest.raises(CesError, match="--units applies to --structure sigmoid or auto, not to polynomial"):
        options(units=7)
    assert options(units=7, structure="sigmoid")["units"] == 7
    assert build_command_line({**DEFAULTS, "bags": ["one"]}) == ["--", "one"]
