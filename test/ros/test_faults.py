"""The observer under faults over real DDS: a short campaign of bench/reliability, one episode of some faults each.

Other faults are in test_observer_node.py (no number, no current) and test_misuse.py (garbage).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")


from damper_models import plain_damper

from bench.reliability.campaign import make_limits, play, start_stage
from bench.reliability.judge import Fault, faults

if TYPE_CHECKING:
    from bench.reliability.campaign import Stage
    from bench.reliability.judge import FaultOutcome

MODEL = plain_damper()
NAMES = (
    "rows of 1 to 5 samples lost",
    "stamps 2 to 60 s behind",
    "observer stalls, then a burst",
    "publisher killed, another started",
)
MIN_S, LONGER_S = 0.4, 0.2
TRIES = 5


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with start_stage(MODEL, tmp_path_factory.mktemp("faults")) as stage:
        yield stage


def shorten(fault: Fault) -> Fault:
    """Return the fault with about its shortest duration; a shorter one might not show."""
    least_s = max(MIN_S, fault.seconds[0])
    return replace(fault, seconds=(least_s, least_s + LONGER_S))


def play_undisturbed(stage: Stage, fault: Fault, dice: Random) -> FaultOutcome:
    """Play one episode, and again if it went wrong: its limits are times, and a busy computer holds processes up."""
    for _ in range(TRIES):
        [outcome] = play(stage, [fault], make_limits(MODEL), dice)
        if not outcome.wrong:
            break
    return outcome


def test_a_short_campaign_of_faults(stage: Stage) -> None:
    by_name = {fault.name: fault for fault in faults(MODEL.sampling.max_current_age_s)}
    chosen = [shorten(by_name[name]) for name in NAMES]
    dice = Random(1)
    outcomes = [play_undisturbed(stage, fault, dice) for fault in chosen]
    assert {one.fault: one.wrong for one in outcomes if one.wrong} == {}
    assert [one.fault for one in outcomes] == list(NAMES)
    assert max(one.worst_force_N for one in outcomes) > 100.0
    assert not stage.observer.end()
    assert not stage.monitor.estimates.misread
