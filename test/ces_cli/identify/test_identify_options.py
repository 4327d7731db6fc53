"""The node's parameters are the program's options: names, the request made of them, and the same as a command."""

from __future__ import annotations

import shlex
from math import inf
from pathlib import Path

import pytest
import yaml

from ces_cli.identify.program import share_time
from ces_cli.identify.request import EXIT_WHEN_DONE, PARAMETERS, IdentifyProgramRequest, find_given_parameters
from ces_cli.identify.worker import as_command
from ces_cli.terminal import terminal
from ces_cli.terminal.heartbeat import Heartbeat
from ces_observer.errors import CesError, OptionName
from ces_observer.options import NO_WORDS

CONFIG = Path(__file__).resolve().parents[3] / "config" / "identify.yaml"
# A node does not need campaigns, parts of recordings, cross-validation or text on standard output.
LEFT_OUT = frozenset({"campaign", "jobs", "folds", "show_candidates", "help", "json", "part", "title", "note"})
BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}
DEFAULTS = {parameter.name: parameter.default for parameter in PARAMETERS}
ACTIONS = {action.dest: action for action in terminal.parser(IdentifyProgramRequest)._actions}


def request(**values):
    """Return the request of parameters, which the program makes of the same as a command line, too."""
    given = find_given_parameters({**DEFAULTS, "bags": ["one"], **values})
    made = IdentifyProgramRequest.of(given, given)
    assert terminal.read(IdentifyProgramRequest, shlex.split(as_command(given))[2:]) == made
    return made


def test_every_option_is_a_parameter_or_left_out_on_purpose():
    assert set(BY_NAME) | LEFT_OUT == set(ACTIONS)
    assert not set(BY_NAME) & LEFT_OUT


def test_values_arrive_unchanged(monkeypatch):
    monkeypatch.setenv("HOME", "/home/somebody")
    made = request(
        bags=["~/one", "", "two"],
        delay=0.003,
        validate=["three"],
        report="~/report.html",
        blend=["speed:-0.3,0.3", "current:0.5,1"],
        certificate=False,
        time=0.30000000000000004,
    )
    assert [str(path) for path in made.bags] == ["/home/somebody/one", "two"]
    assert (str(made.validate[0]), str(made.report)) == ("three", "/home/somebody/report.html")
    assert (made.model.blend, made.model.certificate) == (("speed:-0.3,0.3", "current:0.5,1"), False)
    assert (made.model.time, made.model.delay) == (0.30000000000000004, 0.003)


def test_a_value_with_a_dash_is_no_option():
    assert request(bags=["-x"], teacher="--out=elsewhere").teacher == "--out=elsewhere"


def test_a_missing_recording_and_a_wrong_choice_are_named():
    with pytest.raises(CesError, match="parameter 'bags' is not set; set it to the paths of recordings"):
        find_given_parameters(DEFAULTS)
    with pytest.raises(CesError, match="parameter 'method' is 'best'; expected one of gauss-newton, thesis"):
        BY_NAME["method"].check_parameter("best")


def test_the_packaged_file_lists_every_parameter_with_its_default():
    parameters = yaml.safe_load(CONFIG.read_text())["/**"]["ros__parameters"]
    assert parameters.pop(EXIT_WHEN_DONE.name) is EXIT_WHEN_DONE.default
    assert {**parameters, "bags": NO_WORDS} == DEFAULTS
    assert "bags" not in parameters


def test_a_parameter_that_does_not_apply_is_refused_and_defaults_never_are():
    with pytest.raises(CesError) as caught:
        request(units=7)
    for wording, line in {
        OptionName.as_flag: "--units applies to --structure sigmoid or auto, not to polynomial; remove it",
        OptionName.as_parameter: "parameter 'units' applies to parameter structure:=sigmoid or auto, not to polynomial",
        OptionName.as_keyword: "units applies to structure='sigmoid' or auto, not to polynomial; remove it",
        OptionName.as_key: "units applies to structure: sigmoid or auto, not to polynomial; remove it",
    }.items():
        assert caught.value.word(wording).startswith(line)
    assert request(units=7, structure="sigmoid").model.sizes == {"units": 7}
    assert find_given_parameters({**DEFAULTS, "bags": ["one"]}) == {"bags": ["one"]}


def test_a_time_limit_counts_the_start_and_the_report_or_says_that_it_cannot_be_met(monkeypatch, capsys):
    monkeypatch.setattr(Heartbeat, "elapsed_s", 2.0)
    assert share_time(15.0) == 11.0 and share_time(inf) == inf and not capsys.readouterr().err
    monkeypatch.setattr(Heartbeat, "elapsed_s", 3.5)
    assert share_time(15.0) == 10.5 and not capsys.readouterr().err
    monkeypatch.setattr(Heartbeat, "elapsed_s", 10.0)
    assert share_time(15.0) == 10.5
    said = "--time 15 cannot be met: start and reading took 10.0 s, as will the report; it will be about 30 s"
    assert said in capsys.readouterr().err
