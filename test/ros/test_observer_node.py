"""The observer node on a real ROS 2: the estimator's forces, a named reason whenever there are none, recovery."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Callable
from math import isfinite, nan

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from damper_models import plain_damper
from diagnostic_msgs.msg import DiagnosticStatus
from node_process import NodeProcess
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rosgraph_msgs.msg import Clock
from vehicle import JOINT, Vehicle, reliable_inputs, stroke, wait

from ces_observer.estimator import Estimator

MS = 1_000_000
START_NS = 1_000_000_000_000_000_000
WARM_UP_S = 0.1  # of the test model
RECOVERY_S = 0.2
ON_THE_WAY_NS = 150 * MS  # estimates of good samples that may still arrive on a busy computer
Start = Callable[..., NodeProcess]


def test_forces_equal_the_estimators(vehicle: Vehicle, start: Start, namespace: str) -> None:
    currents = {START_NS + 10 * k * MS: 0.5 + 0.001 * k for k in range(200)}
    positions = jittered_samples(2000)
    expected = offline(positions, currents)
    start(
        **{"current.topic": "stamped_current", "current.type": "sensor_msgs/msg/Temperature"},
        **{"current.field": "temperature", "max_age_s": 0.0},
        **reliable_inputs(namespace, ["joint_states", "stamped_current"]),
    )
    vehicle.meets_node()
    for stamp, current in currents.items():
        vehicle.publish_current(stamp, current)
    time.sleep(1.0)  # the two topics have queues of their own
    for stamp, position in positions:
        vehicle.publish_position(stamp, position)
    wait(lambda: len(vehicle.estimates) >= len(expected), "all estimates")
    assert vehicle.stamps() == list(expected)
    for message, (position, speed, force) in zip(vehicle.estimates, expected.values(), strict=True):
        assert message.position[0] == pytest.approx(position, rel=1e-9)
        assert message.velocity[0] == pytest.approx(speed, rel=1e-9)
        assert message.effort[0] == pytest.approx(force, rel=1e-9)
    assert len(expected) > 1500
    assert max(abs(force) for _, _, force in expected.values()) > 100.0


def test_live_stream(vehicle: Vehicle, start: Start) -> None:
    start()
    vehicle.meets_node()
    first, last = vehicle.drive(1.5)
    vehicle.hears("estimating", DiagnosticStatus.OK)
    wait(lambda: vehicle.stamps()[-1] > last - 100 * MS, "the newest estimate")
    assert vehicle.stamps()[0] - first <= (RECOVERY_S + WARM_UP_S) * 1e9
    assert all(b > a for a, b in zip(vehicle.stamps(), vehicle.stamps()[1:], strict=False))
    for message in vehicle.estimates:
        assert (list(message.name), message.header.frame_id) == ([JOINT], "chassis")
        assert isfinite(message.position[0]) and isfinite(message.velocity[0])
        assert abs(message.effort[0]) < 8000.0


FAULTS = {
    "no usable current": {"current": None},
    "position is not finite": {"position": lambda time_s: nan},
    "no joint 'rear_damper'; the message has ['steering', 'front']": {"joint": "front"},
    "position stamps are off the node's clock": {"clock_offset_s": -3.0},
}


@pytest.mark.parametrize("reason", FAULTS)
def test_withholds_says_why_and_recovers(vehicle: Vehicle, start: Start, reason: str) -> None:
    start()
    vehicle.meets_node()
    vehicle.drive(0.6)
    vehicle.hears("estimating", DiagnosticStatus.OK)
    fault_begins, _ = vehicle.drive(0.6, **FAULTS[reason])
    status = vehicle.hears(reason)
    assert status.name.endswith(f"observer: {JOINT}")
    recovers, _ = vehicle.drive(0.6)
    wait(lambda: vehicle.stamps()[-1] > recovers, "recovery")
    held_ns = 200 * MS if "current" in reason else 0  # as long as the model allows
    assert not [at for at in vehicle.arrivals if fault_begins + held_ns + ON_THE_WAY_NS < at < recovers]
    resumed = next(stamp for stamp in vehicle.stamps() if stamp >= recovers)
    assert resumed - recovers <= (RECOVERY_S + WARM_UP_S) * 1e9


def test_silence_is_told_and_ends(vehicle: Vehicle, start: Start) -> None:
    start()
    vehicle.meets_node()
    vehicle.drive(0.5)
    vehicle.hears("joint_states has a publisher that is silent")
    recovers, _ = vehicle.drive(0.5)
    wait(lambda: vehicle.stamps()[-1] > recovers, "recovery")
    resumed = next(stamp for stamp in vehicle.stamps() if stamp >= recovers)
    assert resumed - recovers <= (RECOVERY_S + WARM_UP_S) * 1e9


def test_a_topic_of_another_type_is_told(vehicle: Vehicle, start: Start) -> None:
    start(**{"position.type": "std_msgs/msg/Float64", "position.field": "data"})
    vehicle.hears("joint_states carries sensor_msgs/msg/JointState; position.type is std_msgs/msg/Float64")


def test_a_constant_current_needs_no_topic(vehicle: Vehicle, start: Start) -> None:
    start(**{"current.constant": 0.0})
    vehicle.meets_node()
    vehicle.drive(0.5, current=None)
    wait(lambda: bool(vehicle.estimates), "an estimate")


def test_a_position_without_header_is_stamped_on_arrival(vehicle: Vehicle, start: Start, namespace: str) -> None:
    from std_msgs.msg import Float64

    publisher = vehicle.node.create_publisher(Float64, "bare", 100)
    start(**{"position.topic": "bare", "position.type": "std_msgs/msg/Float64", "position.field": "data"}, name="front")
    wait(lambda: publisher.get_subscription_count() > 0, "the node subscribes")
    before = time.time_ns()
    end = time.monotonic() + 10.0
    while not vehicle.estimates and time.monotonic() < end:
        vehicle.current.publish(Float64(data=0.5))
        publisher.publish(Float64(data=stroke(time.monotonic())))
        time.sleep(0.002)
    assert before < vehicle.stamps()[0] < time.time_ns()
    assert list(vehicle.estimates[0].name) == ["front"]


def test_simulated_time_is_respected(vehicle: Vehicle, start: Start) -> None:
    clock = vehicle.node.create_publisher(Clock, "clock", 10)
    start(use_sim_time=True, **{"current.constant": 0.5})
    vehicle.meets_node()
    for k in range(800):
        if k % 10 == 0:
            time.sleep(0.01)
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(50 * 10**9 + k * MS, 10**9)
            clock.publish(message)
        vehicle.publish_position(50 * 10**9 + k * MS, stroke(k * 1e-3))
    wait(lambda: bool(vehicle.estimates), "an estimate in simulated time")
    assert 50 * 10**9 < vehicle.stamps()[0] < 51 * 10**9


def test_the_age_limit_can_be_lifted_while_running(vehicle: Vehicle, start: Start, namespace: str) -> None:
    start(**{"current.constant": 0.5})
    vehicle.meets_node()
    vehicle.drive(0.5, clock_offset_s=-1e6)
    vehicle.hears("1e+06 s behind it, max_age_s allows 0.5 s")
    assert not vehicle.estimates
    client = AsyncParameterClient(vehicle.node, f"{namespace}/observer")
    assert client.wait_for_services(5.0)
    answer = client.set_parameters([Parameter("max_age_s", value=0.0)])
    wait(answer.done, "the parameter is set")
    assert answer.result().results[0].successful
    vehicle.drive(0.5, clock_offset_s=-1e6)
    wait(lambda: bool(vehicle.estimates), "an estimate")


BROKEN = {"nan.json": "NaN", "unstable.json": "1.01"}  # coefficient of the past force
MISTAKES = {
    "expected a finite number": {"model": "nan.json"},
    "not proved to count for less than one": {"model": "unstable.json"},
    "no such model file": {"model": "/nowhere/model.json"},
    "parameter 'model' is not set": {"model": "''"},
    "message type 'sensor_msgs/msg/JoinState' is not installed": {"position.type": "sensor_msgs/msg/JoinState"},
    "there is no 'pos'; there are header, name, position": {"position.field": "pos[rear_damper]"},
    "'data' is no array": {"current.field": "data[0]"},
    "is a Header; expected the path to a number": {"position.field": "header"},
    "unknown key 'feild'": {"position.feild": "data"},
    "scale is 0": {"position.scale": 0},
    "max_age_s out of range": {"max_age_s": -1.0},
    "Invalid topic name": {"position.topic": "no topic"},
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_at_start_is_one_fatal_line_and_status_2(start: Start, model_path: object, line: str) -> None:
    mistake = dict(MISTAKES[line])
    if mistake.get("model") in BROKEN:
        coefficient = f'"coefficient": {BROKEN[mistake["model"]]}'
        mistake["model"] = model_path.with_name(mistake["model"])
        mistake["model"].write_text(model_path.read_text().replace('"coefficient": 0.9', coefficient))
    status, output = start(**mistake).ended()
    fatal = [text for text in output.splitlines() if "[WARN]" not in text]
    assert status == 2
    assert len(fatal) == 1, output
    assert "[FATAL]" in fatal[0] and line in fatal[0]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_node_in_order_under_load(vehicle: Vehicle, start: Start, number: int) -> None:
    node = start()
    vehicle.meets_node()
    vehicle.drive(0.4)
    node.interrupt(number)
    vehicle.drive(0.3)
    status, output = node.ended()
    assert status == 0, output
    assert "Traceback" not in output


def jittered_samples(count: int) -> list[tuple[int, float]]:
    """Return (stamp, position) at 1 kHz with jitter, lost and repeated samples, an outlier and a NaN."""
    chance = random.Random(1)
    samples = [(START_NS + k * MS + chance.randrange(MS // 2), stroke(k * 1e-3)) for k in range(count)]
    samples[500] = (samples[500][0], nan)
    samples[600] = (samples[600][0], 0.09)
    samples[700] = samples[699]
    return samples[:800] + samples[820:]


def offline(positions: list[tuple[int, float]], currents: dict[int, float]) -> dict[int, tuple[float, float, float]]:
    """Return by stamp the position, speed and force of an estimator that is fed in order."""
    estimator = Estimator(plain_damper(max_gap_s=0.3))
    found = {}
    for stamp, position in positions:
        current = currents[max(s for s in currents if s <= stamp)]
        force = estimator.step(stamp, position, current)
        if force is not None:
            found[stamp] = (estimator.position, estimator.speed, force)
    return found
