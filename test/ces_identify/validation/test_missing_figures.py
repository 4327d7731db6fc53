"""Every dash in a table of costs has a reason, with the recordings that it concerns."""

from __future__ import annotations

from dataclasses import replace

import pytest
from report_examples import damper, model

from ces_identify.validation.cost_interval import cost_interval
from ces_identify.validation.cycle_noise import CycleNoise, cycle_noise
from ces_identify.validation.evaluate import VALIDATION, Evaluation, evaluate
from ces_identify.validation.missing_figures import DIVERGED, SHORT, explain_missing
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

FLOOR = CycleNoise(0.25, 20, 3.0, 0.4)


@pytest.fixture(scope="module")
def road() -> Evaluation:
    return evaluate(model(), [damper("road")], VALIDATION)[0]


def explain(*evaluations: Evaluation) -> list[str]:
    intervals = [cost_interval([e]) for e in evaluations]
    return explain_missing(evaluations, intervals, [cycle_noise(e.series) for e in evaluations])


def test_nothing_is_missing_where_all_figures_are_known(road: Evaluation) -> None:
    assert explain_missing([road], [cost_interval([road])], [FLOOR]) == []


def test_a_short_recording_has_no_interval() -> None:
    short = evaluate(model(), [damper("short", ticks=330)], VALIDATION)[0]
    assert f"{SHORT}: short" in explain(short)


def test_a_diverged_run_is_named_once(road: Evaluation) -> None:
    unstable = model(body=Polynomial((Term(1.01, (Factor("force", 1),)), Term(50.0, (Factor("speed", 0),)))))
    lost = evaluate(replace(unstable, force_envelope_N=(-2000.0, 2000.0)), [damper("lost")], VALIDATION)[0]
    lines = explain_missing([lost, road], [cost_interval([lost]), cost_interval([road])], [FLOOR, FLOOR])
    assert lines == [f"{DIVERGED}: lost"]


def test_recordings_with_the_same_reason_share_a_line(road: Evaluation) -> None:
    again = replace(road, name="town")
    whole = [f"no noise floor ({cycle_noise(road.series)}): all recordings"]
    assert explain(road, again) == explain(road, road) == whole
    some = explain_missing([road, again, road], [cost_interval([road])] * 3, ["why", "why", FLOOR])
    assert some == ["no noise floor (why): road, town"]
