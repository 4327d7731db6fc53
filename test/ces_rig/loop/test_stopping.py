"""When an iteration stops (a target counts as reached only if the interval of the cost says so), and its line."""

from __future__ import annotations

import json
from math import inf, isnan, nan
from pathlib import Path
from types import SimpleNamespace

import pytest

from ces_rig.loop.iterate import find_stop
from ces_rig.loop.store import Iteration


def row(**facts):
    return SimpleNamespace(**{"number": 1, "total_s": 10.0, "fresh_J": None, "fresh_high_J": None, **facts})


def plan(target_J):
    stop = SimpleNamespace(target_J=target_J, max_iterations=9, budget_s=60.0)
    return SimpleNamespace(stop=stop, experiments=SimpleNamespace(kind="designed"))


@pytest.mark.parametrize(
    ("facts", "reached"),
    [
        ({}, False),
        ({"fresh_J": 3.9}, False),  # too short for an interval
        ({"fresh_J": 3.9, "fresh_high_J": 4.1}, False),
        ({"fresh_J": 3.2, "fresh_high_J": 3.9}, True),
    ],
)
def test_a_target_is_reached_when_the_whole_interval_is_below(facts, reached):
    text = find_stop(plan(4.0), [row(**facts)], 10.0)
    assert text.startswith("target reached: J 3.20 %, with 95 % confidence at most 3.90 %") == reached
    assert bool(text) == reached


def test_a_diverged_run_is_null_in_its_line_and_no_number_when_it_is_read_again():
    one = Iteration(2, "two", 3.0, 6.0, 0.0, 0.0, inf, 5.0, {"other": nan}, 0.5, 0.1, 0.1, (), "m.json")
    row = json.loads(json.dumps(one.to_row(), allow_nan=False))
    again = Iteration.from_row(row, Path("iterations.jsonl"))
    assert again.fresh_J is None
    assert isnan(again.validation_J["other"])
    assert (again.number, again.fit_J) == (2, 5.0)
