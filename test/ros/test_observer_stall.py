"""A node that stalls: what queued up meanwhile is estimated in order, each sample at its own stamp."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from damper_models import plain_damper
from node_process import NodeProcess
from replay import offline
from vehicle import RECOVERIES, Vehicle, stamp_of, stroke, wait

from ces_observer.nodes.executors import AUTO, SINGLE

MAX_CURRENT_AGE_S = 0.6
MAX_LATE_S = 0.5  # of the vehicle: less than that
STALL_S = 1.0  # longer than that: a current may not be as old as its reading
CURRENT_A = 0.5


def stall(node: NodeProcess, seconds: float = STALL_S) -> None:
    """Stop the node's process for a while."""
    node.interrupt(signal.SIGSTOP)
    time.sleep(seconds)
    node.interrupt(signal.SIGCONT)


def drive_through_a_stall(vehicle: Vehicle, node: NodeProcess) -> int:
    """Drive until all is estimated; return when it began [ns].

    Where the vehicle too is held up, its currents really are too old; then it drives anew.
    """
    for _ in range(RECOVERIES):
        began = time.time_ns()
        with vehicle.driving(contiguous=True):
            wait(lambda since=began: len(vehicle.stamps(since)) > 200, "estimates before the stall")
            stall(node)
            time.sleep(0.3)
        wait(lambda: vehicle.late_s > MAX_LATE_S or vehicle.stamps()[-1] == vehicle.driven[-1], "the last estimate")
        if vehicle.late_s <= MAX_LATE_S:
            return began
    raise AssertionError(f"the vehicle was held up {RECOVERIES} times, lately for {vehicle.late_s} s")


@pytest.mark.parametrize("executor", [AUTO, SINGLE])
def test_every_sample_of_a_stall_is_estimated_late_but_right(
    vehicle: Vehicle, start: Callable[..., NodeProcess], tmp_path: Path, executor: str
) -> None:
    model, path = plain_damper(max_gap_s=0.3, max_current_age_s=MAX_CURRENT_AGE_S), tmp_path / "model.json"
    model.save(path)
    node = start(executor=executor, max_age_s=0.0, model=path)
    vehicle.meets_node()
    began = drive_through_a_stall(vehicle, node)
    stamps, driven = vehicle.stamps(began), [stamp for stamp in vehicle.driven if stamp >= began]
    assert stamps == driven[driven.index(stamps[0]) :]
    expected = offline([(stamp, stroke(stamp % 10**12 * 1e-9)) for stamp in driven], [(0, CURRENT_A)], model)
    forces = {stamp_of(one): one.effort[0] for one in vehicle.estimates}
    worst = max(abs(expected[stamp][2] - forces[stamp]) for stamp in stamps if stamp in expected)
    assert worst < 1e-3 * max(abs(forces[stamp]) for stamp in stamps)  # the node's first sample may be a later one


def test_what_a_full_queue_loses_is_counted(vehicle: Vehicle, start: Callable[..., NodeProcess]) -> None:
    node = start(input_depth=100)
    vehicle.meets_node()
    key = "position: dropped, in this node's queue"
    warning = "dropped by this node's queue: set input_depth higher"

    def count_lost() -> int:
        return max((int(v.value) for s in vehicle.statuses for v in s.values if v.key == key), default=0)

    def loses_300() -> bool:
        stall(node)  # again, if the vehicle too was held up
        time.sleep(2.0)  # for a status, of which there is one a second
        return count_lost() >= 300 and any(warning in status.message for status in vehicle.statuses)

    with vehicle.driving(contiguous=True):
        wait(lambda: len(vehicle.estimates) > 200, "estimates before the stall")
        wait(loses_300, f"the count of what stalls lost, and '{warning}'")
    assert count_lost() <= len(vehicle.driven) - 200
