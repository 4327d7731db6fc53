"""Stamps drive the estimates: replay in bursts, simulated time and its jumps, jumps of the stamps themselves."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from node_process import NodeProcess
from replay import MS, START_NS, Samples, currents, jittered_positions, offline, require_equal
from rosgraph_msgs.msg import Clock
from vehicle import STAMPED_CURRENT, Vehicle, reliable_inputs, stroke, wait

S = 1_000_000_000
JUMPS = "jumps of time"
Start = Callable[..., NodeProcess]


@pytest.mark.parametrize(
    ("executor", "order"), [("events", "as recorded"), ("events", "positions first"), ("single", "positions first")]
)
def test_a_burst_equals_the_offline_replay(
    vehicle: Vehicle, start: Start, namespace: str, executor: str, order: str
) -> None:
    positions, held = jittered_positions(2000), currents(2000)
    start(
        executor=executor,
        max_age_s=0.0,
        wait_for_current_s=10.0,
        **STAMPED_CURRENT,
        **reliable_inputs(namespace, ["joint_states", "stamped_current"]),
    )
    vehicle.meets_node()
    publish_burst(vehicle, positions, held, recorded_order=order == "as recorded")
    require_equal(vehicle, offline(positions, held))


def publish_burst(vehicle: Vehicle, positions: Samples, held: Samples, *, recorded_order: bool) -> None:
    """Publish as fast as it goes, in the order of the stamps or every current after the last position."""
    samples = [(stamp if recorded_order else 0, vehicle.publish_position, (stamp, value)) for stamp, value in positions]
    samples += [(stamp, vehicle.publish_current, (stamp, value)) for stamp, value in held]
    for _, publish, sample in sorted(samples, key=lambda sample: sample[0]):
        publish(*sample)


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


def test_simulated_time_is_respected(simulated: SimulatedVehicle) -> None:
    stamps = simulated.drives(50 * S)
    assert stamps[0] - 50 * S < 0.2 * S


def test_simulated_time_that_jumps_back_begins_anew_and_is_told(
    simulated: SimulatedVehicle, module_vehicle: Vehicle
) -> None:
    simulated.drives(80 * S)
    stamps = simulated.drives(20 * S)
    assert 0.1 * S <= stamps[0] - 20 * S < 0.3 * S
    module_vehicle.hears_value(JUMPS, "simulated time jumped by -60.")


def test_simulated_time_that_jumps_forward_begins_anew_and_is_told(
    simulated: SimulatedVehicle, module_vehicle: Vehicle
) -> None:
    simulated.drives(200 * S)
    stamps = simulated.drives(500 * S)
    assert 0.1 * S <= stamps[0] - 500 * S < 0.3 * S
    module_vehicle.hears_value(JUMPS, "simulated time jumped by +299.")


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
