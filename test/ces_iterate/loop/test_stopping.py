"""When an iteration stops: a target counts as reached only if the interval of the cost says so."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from ces_iterate.loop.iterate import find_stop


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
