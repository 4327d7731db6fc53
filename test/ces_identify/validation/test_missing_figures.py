"""Every dash in a table of costs has a reason, with the recordings that it concerns."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from report_examples import damper, model

from ces_identify.validation.cycle_noise import CycleNoise
from ces_identify.validation.evaluate import DIVERGED, SHORT, VALIDATION, Evaluation, evaluate, explain_missing

FLOOR = CycleNoise(0.25, 20, 3.0, 0.4)


@pytest.fixture(scope="module")
def road() -> Evaluation:
    return evaluate(model(), [damper("road")], VALIDATION)[0]


def with_noise(evaluation: Evaluation, noise: CycleNoise | str) -> Evaluation:
    """Return the evaluation with a given noise floor, or a given reason why there is none."""
    other = replace(evaluation)
    vars(other)["noise"] = noise
    return other


def test_a_short_recording_has_no_interval() -> None:
    short = evaluate(model(), [damper("short", ticks=330)], VALIDATION)[0]
    assert f"{SHORT}: short" in explain_missing([short])


def test_a_diverged_run_is_named_once(road: Evaluation) -> None:
    lost = replace(road, name="lost", cost=math.inf)
    lines = explain_missing([lost, road], floors=False)
    assert lines == [f"{DIVERGED}: lost"]


def test_recordings_with_the_same_reason_share_a_line(road: Evaluation) -> None:
    again = replace(road, name="town")
    whole = [f"no noise floor ({road.noise}): all recordings"]
    assert explain_missing([road, again]) == explain_missing([road, road]) == whole
    some = explain_missing([with_noise(road, "why"), with_noise(again, "why"), with_noise(road, FLOOR)])
    assert some == ["no noise floor (why): road, town"]
