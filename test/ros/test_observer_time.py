"""Stamps drive the estimates: replay in bursts, simulated time and its jumps, jumps of the stamps themselves."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from damper_models import damper_with_past
from node_process import NodeProcess
from replay import MS, START_NS, Offline, S, faulty_segments, require_equal
from rosgraph_msgs.msg import Clock
from vehicle import RECOVERIES, STAMPED_CURRENT, Vehicle, reliable_inputs, stamp_of, stroke, wait

from ces_observer.current_hold import ConstantCurrent
from ces_observer.nodes.executors import AUTO, SINGLE

JUMPS = "jumps of time"
Start = Callable[..., NodeProcess]


@pytest.mark.parametrize(("executor", "is_in_order"), [("events", True), ("events", False), ("single", False)])
def test_bursts_of_faulty_samples_whose_clock_jumps_equal_an_estimator_that_is_fed_them(
    vehicle: Vehicle, start: Start, namespace: str, executor: str, is_in_order: bool
) -> None:
    """Each segment is published as fast as it goes, in the order of the stamps or every current after the positions."""
    lossless = reliable_inputs(namespace, ["joint_states", "stamped_current"])
    start(executor=executor, max_age_s=0.0, wait_for_current_s=10.0, **STAMPED_CURRENT, **lossless)
    vehicle.meets_node()
    offline, expected = Offline(), {}
    for segment in faulty_segments():
        vehicle.publish_burst(segment.positions, segment.currents, is_in_order=is_in_order)
        expected |= offline.take(segment.positions, segment.currents)
        vehicle.hears_estimates(len(expected))
    require_equal(vehicle, expected)


class SimulatedVehicle:
    """A vehicle in simulated time, with a node that runs in it."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._clock = vehicle.node.create_publisher(Clock, "clock", 10)

    def drives(self, from_ns: int, duration_s: float = 0.6) -> list[int]:
        """Let simulated time go by twice as fast as real time; return the stamps of the estimates from it."""
        for k in range(round(duration_s * 1000)):
            if k % 10 == 0:
                time.sleep(0.005)
                message = Clock()
                message.clock.sec, message.clock.nanosec = divmod(from_ns + k * MS, S)
                self._clock.publish(message)
            self._vehicle.publish_position(from_ns + k * MS, stroke(k * 1e-3))
        end_ns = from_ns + round(duration_s * S)

        def estimates() -> list[int]:
            return [stamp for stamp in self._vehicle.stamps() if from_ns <= stamp < end_ns]

        wait(lambda: bool(estimates()) and estimates()[-1] == end_ns - MS, f"an estimate at {(end_ns - MS) / S:g} s")
        return estimates()


@pytest.fixture(scope="module")
def simulated(module_vehicle: Vehicle, module_start: Start) -> Iterator[SimulatedVehicle]:
    inputs = reliable_inputs(module_vehicle.namespace, ["joint_states"])
    module_start(use_sim_time=True, **{"current.constant": 0.5}, **inputs)
    module_vehicle.meets_node()
    return SimulatedVehicle(module_vehicle)


@pytest.mark.parametrize(("from_s", "to_s", "told"), [(80, 20, "-60."), (200, 500, "+299.")])
def test_simulated_time_is_respected_and_a_jump_begins_anew_and_is_told(
    simulated: SimulatedVehicle, module_vehicle: Vehicle, from_s: int, to_s: int, told: str
) -> None:
    assert simulated.drives(from_s * S)[0] - from_s * S < 0.3 * S
    stamps = simulated.drives(to_s * S)
    assert 0.1 * S <= stamps[0] - to_s * S < 0.3 * S
    module_vehicle.hears_value(JUMPS, f"simulated time jumped by {told}")


def test_switching_simulated_time_off_is_told(simulated: SimulatedVehicle, module_vehicle: Vehicle) -> None:
    simulated.drives(700 * S)
    assert module_vehicle.sets("use_sim_time", False).successful
    module_vehicle.hears_value(JUMPS, "simulated time was switched off")
    module_vehicle.drive_until(lambda: module_vehicle.stamps()[-1] > START_NS, "an estimate by the wall clock")


@pytest.mark.parametrize("jump_s", [-30.0, 30.0])
def test_stamps_that_jump_restart_the_estimates(vehicle: Vehicle, start: Start, namespace: str, jump_s: float) -> None:
    start(max_age_s=0.0, **{"current.constant": 0.5}, **reliable_inputs(namespace, ["joint_states"]))
    vehicle.meets_node()
    vehicle.drive(0.4, contiguous=True)
    first, last = vehicle.drive(0.4, clock_offset_s=jump_s, contiguous=True)
    jump_ns = round(jump_s * S)
    wait(lambda: vehicle.stamps()[-1] == last + jump_ns, "the newest estimate")
    after = [stamp for stamp in vehicle.stamps() if abs(stamp - first - jump_ns) < S]
    assert 0.09 * S < after[0] - (first + jump_ns) < 0.3 * S
    assert len(after) > 200


# ------------------ A node that stalls: what queued up meanwhile is estimated in order, each sample at its own stamp.


MAX_CURRENT_AGE_S = 0.6
MAX_LATE_S = 0.5  # of the vehicle: less than that
STALL_S = 1.0  # longer than that: a current may not be as old as its reading
CURRENT_A = 0.5
RATE_HZ = 250  # that a busy computer can keep
FORGETS_S = 1.0  # time in which the model forgets its start


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
        with vehicle.driving(contiguous=True, rate_Hz=RATE_HZ):
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
    path = tmp_path / "model.json"
    settings = {"rate_Hz": RATE_HZ, "warm_up_s": FORGETS_S, "max_gap_s": 0.3, "max_current_age_s": MAX_CURRENT_AGE_S}
    model = damper_with_past(0.6, **settings)
    model.save(path)
    node = start(executor=executor, max_age_s=0.0, model=path)
    vehicle.meets_node()
    began = drive_through_a_stall(vehicle, node)
    stamps, driven = vehicle.stamps(began), [stamp for stamp in vehicle.driven if stamp >= began]
    assert stamps == driven[driven.index(stamps[0]) :]
    positions = [(stamp, stroke(stamp % 10**12 * 1e-9)) for stamp in driven]
    expected = Offline(model, ConstantCurrent(CURRENT_A)).take(positions)
    forces = {stamp_of(one): one.effort[0] for one in vehicle.estimates}
    worst = max(abs(expected[stamp][2] - forces[stamp]) for stamp in stamps if stamp in expected)
    assert worst < 1e-6 * max(abs(forces[stamp]) for stamp in stamps)  # the node's first sample may be a later one


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
