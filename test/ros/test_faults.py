"""The observer under faults over real DDS: a short campaign of bench/reliability, one episode of some faults each.

Other faults are in test_observer_node.py (no number, no current) and test_misuse.py (garbage).
"""

from __future__ import annotations

import os
import re
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from damper_models import plain_damper
from failing_observer import STEPS
from node_process import ROOT, NodeProcess, ros_args
from patience import PATIENCE_S
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from test_misuse import CURRENT_A, EXECUTORS, compare
from vehicle import Vehicle, reliable_inputs, wait

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
PATIENT_S = 2.0  # for recoveries and pauses: a busy computer holds processes up
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
    limits = replace(make_limits(MODEL), recovery_s=PATIENT_S, longest_pause_s=PATIENT_S)
    for _ in range(TRIES):
        [outcome] = play(stage, [fault], limits, dice)
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


# -------------------------------- An observer with planted defects: it runs on, says so, and publishes nothing wrong.


PROGRAM = Path(__file__).parent / "failing_observer.py"
PLANTED = ("the estimator", "the diagnostics", "a timer", "the health", "the check of parameters", "rclpy")


@contextmanager
def failing(namespace: str, executor: str, model: Path) -> Iterator[NodeProcess]:
    settings = {"model": model, "max_age_s": 0.0, "executor": executor, "current.constant": CURRENT_A}
    words = ros_args(namespace, {**settings, **reliable_inputs(namespace, ["joint_states"])})
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    node = NodeProcess([sys.executable, str(PROGRAM), *words], {"PYTHONPATH": paths})
    try:
        yield node
    finally:
        node.kill()


def set_twice(vehicle: Vehicle) -> list[str]:
    """Set a parameter twice; return the reasons for refusal: one of the answers never comes."""
    client = vehicle.node.create_client(SetParameters, "observer/set_parameters")
    assert client.wait_for_service(PATIENCE_S)
    request = SetParameters.Request(parameters=[Parameter("still_warn_s", value=2.0).to_parameter_msg()])
    answers = [client.call_async(request) for _ in range(2)]
    wait(lambda: any(answer.done() for answer in answers), "an answer")
    return [answer.result().results[0].reason for answer in answers if answer.done()]


@pytest.mark.parametrize("executor", EXECUTORS)
def test_defects_end_neither_the_node_nor_the_truth(
    vehicle: Vehicle, namespace: str, executor: str, tmp_path: Path
) -> None:
    path = tmp_path / "model.json"
    model = plain_damper(warm_up_s=0.5, max_gap_s=5.0, max_current_age_s=60.0)  # it forgets its past meanwhile
    model.save(path)
    with failing(namespace, executor, path) as node:
        vehicle.meets_node()
        with vehicle.driving(current=None, contiguous=True):
            wait(lambda: len(vehicle.estimates) > 100, "the first estimates")
            assert set_twice(vehicle) == ["unexpected error in the node; see its log"]
            assert "being checked" in vehicle.reloads.answer().message
            vehicle.hears_value("last change of the model", "not checked within 0.5 s")
            wait(lambda: len(vehicle.driven) > 3 * STEPS, "three failures of the estimator")
            vehicle.hears("unexpected errors, the last: ", None)
        node.interrupt()
        status, output = node.ended()
    assert status == 0, output
    entries = output.split("unexpected error, logged once")[1:]
    ends = [re.findall(rf"^\w+: .*planted in ({'|'.join(PLANTED)})", entry, re.MULTILINE)[-1:] for entry in entries]
    logged = Counter(chain.from_iterable(ends))  # of a failure in the handling of another: the last in its traceback
    assert logged == dict.fromkeys(PLANTED, 1), output  # each kind once, however often it happened
    compare(vehicle, model)
