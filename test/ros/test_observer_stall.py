"""A node that stalls: what queued up meanwhile is estimated in order, each sample at its own stamp."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from damper_models import plain_damper
from node_process import NodeProcess
from replay import offline
from vehicle import Vehicle, stamp_of, stroke, wait

from ces_observer.nodes.executors import AUTO, SINGLE

MAX_CURRENT_AGE_S = 0.6  # in case this test's own publisher is held up by other work
STALL_S = 1.0  # longer than that
CURRENT_A = 0.5


def stall(node: NodeProcess, seconds: float = STALL_S) -> None:
    """Stop the node's process for a while."""
    node.interrupt(signal.SIGSTOP)
    time.sleep(seconds)
    node.interrupt(signal.SIGCONT)


@pytest.mark.parametrize("executor", [AUTO, SINGLE])
def test_every_sample_of_a_stall_is_estimated_late_but_right(
    vehicle: Vehicle, start: Callable[..., NodeProcess], tmp_path: Path, executor: str
) -> None:
    model, path = plain_damper(max_gap_s=0.3, max_current_age_s=MAX_CURRENT_AGE_S), tmp_path / "model.json"
    model.save(path)
    node = start(executor=executor, max_age_s=0.0, model=path)
    vehicle.meets_node()
    with vehicle.driving(contiguous=True):
        wait(lambda: len(vehicle.estimates) > 200, "estimates before the stall")
        stall(node)
        time.sleep(0.3)
    wait(lambda: stamp_of(vehicle.estimates[-1]) == vehicle.driven[-1], "the last estimate")
    estimates = list(vehicle.estimates)
    assert vehicle.stamps() == vehicle.driven[vehicle.driven.index(vehicle.stamps()[0]) :]
    positions = [(stamp, stroke(stamp % 10**12 * 1e-9)) for stamp in vehicle.driven]
    expected = offline(positions, [(0, CURRENT_A)], model)
    worst = max(abs(expected[stamp_of(one)][2] - one.effort[0]) for one in estimates if stamp_of(one) in expected)
    assert worst < 1e-3 * max(abs(one.effort[0]) for one in estimates)  # the node's first sample may be a later one


def test_what_a_full_queue_loses_is_counted(vehicle: Vehicle, start: Callable[..., NodeProcess]) -> None:
    node = start(input_depth=100)
    vehicle.meets_node()
    key = "position: dropped, in this node's queue"

    def count_lost() -> int:
        return max((int(v.value) for s in vehicle.statuses for v in s.values if v.key == key), default=0)

    with vehicle.driving(contiguous=True):
        wait(lambda: len(vehicle.estimates) > 200, "estimates before the stall")
        stall(node)
        vehicle.hears("dropped by this node's queue: set input_depth higher", level=None)
        wait(lambda: count_lost() >= 300, "the count of what the stall lost")  # a status may come while it counts
    assert count_lost() <= len(vehicle.driven) - 200


def test_options_in_force_are_in_the_diagnostics(vehicle: Vehicle, start: Callable[..., NodeProcess]) -> None:
    start(cpu_affinity="[0]")
    assert vehicle.hears_value("processors", "0") == "0"
    assert vehicle.hears_value("memory locked", "no") == "no"


def test_an_impossible_option_is_one_warning_and_the_node_runs(
    vehicle: Vehicle, start: Callable[..., NodeProcess]
) -> None:
    node = start(cpu_affinity="[4000]")
    vehicle.hears("no position samples arrive")
    assert vehicle.hears_value("scheduling", "SCHED_") == "SCHED_OTHER"
    node.interrupt()
    status, output = node.ended()
    assert status == 0
    assert output.count("cpu_affinity 4000 is not possible") == 1
