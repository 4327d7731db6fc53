"""The vehicle around the node: publishes position and current, hears estimates and diagnostics."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import pi, sin
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from party import Party
from patience import PATIENCE_S, wait_until
from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSLivelinessPolicy, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

DEPTH = 50_000  # nothing is lost while a busy computer holds up either side
DEEP = QoSProfile(depth=DEPTH)  # reliable
LOSSY = QoSProfile(depth=DEPTH, reliability=QoSReliabilityPolicy.BEST_EFFORT)  # hears any publisher
JOINT = "rear_damper"
STAMPED_CURRENT = {  # parameters of a current whose messages have stamps
    "current.topic": "stamped_current",
    "current.type": "sensor_msgs/msg/Temperature",
    "current.field": "temperature",
}
RATE_HZ = 1000
RECOVERIES = 5
PROMISES = ("deadline", "liveliness_lease_duration")  # policies by which the middleware tells of silence
LATE_S = 0.2  # less than the age of a sample that a node allows


def stroke(time_s: float) -> float:
    """Return the position [m] of a 2 Hz sine of 20 mm."""
    return 0.02 * sin(2.0 * pi * 2.0 * time_s)


class Vehicle(Party):
    """Publishers and subscriptions in one namespace; what is heard is kept in `estimates` and `statuses`."""

    def __init__(self, namespace: str) -> None:
        super().__init__("vehicle", namespace)
        self._name = f"{namespace}/observer"
        self.estimates: list[JointState] = []
        self.statuses: list[DiagnosticStatus] = []
        self.driven: list[int] = []  # stamps of the positions published by drive
        self.late_s = 0.0  # the most that the last drive was late: something held this process up
        self.node.create_subscription(JointState, "observer/estimate", self._hear_estimate, DEEP)
        for topic in ("/diagnostics", "observer/details"):
            self.node.create_subscription(DiagnosticArray, topic, self._hear_diagnostics, DEEP)
        self.reloads = ModelReloads(self.node, "observer")
        self.position = self.node.create_publisher(JointState, "joint_states", DEEP)
        self.current = self.node.create_publisher(Float64, "valve_current", DEEP)
        self.stamped_current = self.node.create_publisher(Temperature, "stamped_current", DEEP)

    def hear_estimates(self, topic: str) -> list[JointState]:
        """Return a list that the estimates on a further topic are kept in from now on."""
        heard: list[JointState] = []
        self.node.create_subscription(JointState, topic, heard.append, LOSSY)
        return heard

    def meets_node(self, estimate: str = "observer/estimate") -> None:
        """Wait until the node hears this vehicle's position and this vehicle hears the node."""
        wait(lambda: self.position.get_subscription_count() > 0, "the node subscribes to position")
        wait(lambda: self.node.count_publishers(estimate) > 0, "the node offers estimates")
        time.sleep(0.3)  # matching is told to each side on its own

    @contextmanager
    def driving(self, **options: Any) -> Iterator[None]:
        """Drive as `drive` does, beside what is done in this context."""
        ends = threading.Event()
        thread = threading.Thread(target=self.drive, args=(3600.0,), kwargs={**options, "ends": ends})
        thread.start()
        try:
            yield
        finally:
            ends.set()
            thread.join()

    @contextmanager
    def promising(self, policy: str, time_s: float) -> Iterator[dict[str, object]]:
        """Publish positions with a time in this policy; yield the parameters of an observer that asks for it."""
        before = self.position
        offered = {"liveliness": QoSLivelinessPolicy.MANUAL_BY_TOPIC, policy: Duration(seconds=time_s)}
        self.position = self.node.create_publisher(JointState, "joint_states", QoSProfile(depth=DEPTH, **offered))
        yield {f"qos_overrides.{self.namespace}/joint_states.subscription.{policy}": round(time_s * 1e9)}
        self.node.destroy_publisher(self.position)
        self.position = before

    def goes_silent_within(self, most_s: float) -> None:
        """Drive until there are estimates, and stop; the node must say that positions are missing in time."""
        self.meets_node()
        self.drive_until(lambda: len(self.estimates) > 100, "estimates")
        told, stopped = len(self.statuses), time.monotonic()
        self.hears("no position samples arrive", since=told)
        assert time.monotonic() - stopped < most_s

    def keeps_bond(self, name: str, begin: Callable[[], bool], end: Callable[[], bool]) -> None:
        """Form a bond with a node as a lifecycle manager does, see it last, and break when the node ends it."""
        bondpy = pytest.importorskip("bondpy.bondpy", reason="bondpy is not installed")
        events: list[str] = []
        bond = bondpy.Bond(self.node, "bond", name, lambda: events.append("broken"), lambda: events.append("formed"))
        bond.heartbeat_timeout = PATIENCE_S
        assert begin()
        bond.start()
        wait(lambda: events == ["formed"], "a bond")
        assert end()
        wait(lambda: events == ["formed", "broken"], "the end of the bond")
        bond.is_shutdown = True  # its own `shutdown` takes the subscription from under the executor

    def drive_until(self, condition: Callable[[], bool], what: str, **options: Any) -> None:
        """Drive until `condition` holds: samples that a busy computer holds up for too long are withheld."""
        with self.driving(**options):
            wait(condition, what)

    def recover(self, most_s: float) -> int:
        """Drive until there is an estimate again, after samples of `most_s` at most; return when it began [ns].

        Where this computer holds samples up, the node withholds more of them, and rightly; then it is tried again.
        """
        for _ in range(RECOVERIES):
            began, told = time.time_ns(), len(self.statuses)
            self.drive_until(lambda since=began: bool(self.estimates) and self.stamps()[-1] > since, "recovery")
            resumed = next(stamp for stamp in self.stamps() if stamp >= began)
            if sum(began <= stamp < resumed for stamp in self.driven) <= most_s * RATE_HZ:
                return began
            self.hears("joint_states has a publisher that is silent", since=told)
        raise AssertionError(f"more than {most_s} s until an estimate, {RECOVERIES} times")

    def drive(
        self,
        duration_s: float,
        *,
        joint: str = JOINT,
        position: Callable[[float], float] = stroke,
        current: float | None = 0.5,
        clock_offset_s: float = 0.0,
        contiguous: bool = False,
        rate_Hz: int = RATE_HZ,
        ends: threading.Event | None = None,
    ) -> tuple[int, int]:
        """Publish for `duration_s`, a current at every fifth sample; return the first and last time [ns].

        The stamps are a period apart, as a sensor's are. Where this computer is late by more than LATE_S, the
        samples until then are left out, or if they are to be `contiguous`, published late.
        """
        times: list[int] = []
        offset_ns = round(clock_offset_s * 1e9)
        start, start_ns = time.monotonic(), time.time_ns()
        self.late_s = 0.0
        for k in range(round(duration_s * rate_Hz)):
            late_s = time.monotonic() - start - k / rate_Hz
            self.late_s = max(self.late_s, late_s)
            time.sleep(max(0.0, -late_s))
            if late_s > LATE_S and not contiguous:
                start, start_ns = start + late_s, start_ns + round(late_s * rate_Hz) * 10**9 // rate_Hz
            times.append(start_ns + k * 10**9 // rate_Hz)
            if current is not None and k % 5 == 0:
                self.current.publish(Float64(data=current))
            self.driven.append(times[-1] + offset_ns)
            self.publish_position(self.driven[-1], position(times[-1] % 10**12 * 1e-9), joint)
            if ends is not None and ends.is_set():
                break
        return times[0], times[-1]

    def publish_position(self, stamp_ns: int, position_m: float, joint: str = JOINT) -> None:
        """Publish one sample among another joint's."""
        message = JointState(name=["steering", joint], position=[1.0, position_m])
        message.header.frame_id = "chassis"
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        self.position.publish(message)

    def publish_current(self, stamp_ns: int, current_A: float) -> None:
        """Publish a stamped current."""
        message = Temperature(temperature=current_A)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        self.stamped_current.publish(message)

    def publish_burst(
        self, positions: Iterable[tuple[int, float]], currents: Iterable[tuple[int, float]], *, is_in_order: bool
    ) -> None:
        """Publish samples as fast as it goes, in the order of the currents' stamps or every current after the last."""
        waiting = deque(currents)
        for stamp_ns, position_m in positions:
            while is_in_order and waiting and waiting[0][0] <= stamp_ns:
                self.publish_current(*waiting.popleft())
            self.publish_position(stamp_ns, position_m)
        for sample in waiting:
            self.publish_current(*sample)

    def hears_estimates(self, count: int) -> None:
        """Wait until there have been so many."""
        wait(lambda: len(self.estimates) >= count, f"{count} estimates")

    def stamps(self, since_ns: int = 0) -> list[int]:
        """Return the stamps of the estimates heard [ns], from `since_ns` on."""
        return [stamp for stamp in map(stamp_of, list(self.estimates)) if stamp >= since_ns]

    def hears(self, text: str, level: bytes | None = DiagnosticStatus.ERROR, since: int = 0) -> DiagnosticStatus:
        """Wait for a status of this level, None for any, that has `text` in its message, and return it.

        `since` is how many of the statuses heard are too old to count.
        """

        def found() -> DiagnosticStatus | None:
            heard = list(self.statuses)[since:]
            return next((s for s in heard if text in s.message and level in (None, s.level)), None)

        try:
            wait(lambda: found() is not None, f"'{text}'")
        except AssertionError as error:
            raise AssertionError(f"{error} in {[s.message for s in self.statuses[since:]]}") from None
        return found()

    def hears_value(self, key: str, text: str) -> str:
        """Wait for a status whose value at `key` has `text` in it, and return the value."""

        def found() -> str | None:
            values = [v.value for s in list(self.statuses) for v in s.values if v.key == key]
            return next((value for value in values if text in value), None)

        wait(lambda: found() is not None, f"'{text}' in the values '{key}'")
        return str(found())

    @contextmanager
    def measuring(self, factor: float, estimates: list[JointState] | None = None) -> Iterator[None]:
        """Publish `factor` times each new one of `estimates` as the measured force, beside what is done meanwhile."""
        estimates = self.estimates if estimates is None else estimates
        force = self.node.create_publisher(WrenchStamped, "measured_force", DEEP)
        message = WrenchStamped()

        def measure() -> None:
            estimate = estimates[-1]
            message.header.stamp, message.wrench.force.z = estimate.header.stamp, factor * estimate.effort[0]
            force.publish(message)

        wait(lambda: bool(estimates), "an estimate")
        with self.repeating(0.005, measure):
            yield

    def sets(self, name: str, value: object) -> SetParametersResult:
        """Set a parameter of the node; returns its answer."""
        return self.set_parameters("observer", {name: value})

    def gets(self, name: str) -> object:
        """Return the value of a parameter of the node."""
        return self.get_parameter("observer", name)

    def _hear_estimate(self, message: JointState) -> None:
        self.estimates.append(message)

    def _hear_diagnostics(self, message: DiagnosticArray) -> None:
        self.statuses.extend(s for s in message.status if s.name.startswith(self._name))


def stamp_of(message: JointState) -> int:
    """Return the header stamp [ns]."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def wait(condition: Callable[[], bool], what: str) -> None:
    """Wait until `condition` holds; fail, naming `what`, if it does not within PATIENCE_S."""
    wait_until(condition, f"not within {PATIENCE_S} s: {what}")


def reliable_inputs(namespace: str, topics: Iterable[str]) -> dict[str, object]:
    """Return parameters that make the observer's inputs lossless, for tests that compare sample by sample."""
    return lossless_topics(namespace, topics, ["observer/estimate"])


def lossless_topics(namespace: str, heard: Iterable[str], published: Iterable[str]) -> dict[str, object]:
    """Return parameters of a node that hears and publishes these topics without loss."""
    ends = [*((topic, "subscription") for topic in heard), *((topic, "publisher") for topic in published)]
    policies = {"reliability": "reliable", "depth": DEPTH}
    return {
        f"qos_overrides.{namespace}/{topic}.{end}.{policy}": value
        for topic, end in ends
        for policy, value in policies.items()
    }


# ------- Calls of a node's service `reload_model`, and the outcome of each, which the node latches on `model_status`.


ENDS = ("accepted", "refused", "overtaken")  # the last state before which another model may run
EVERY = QoSProfile(depth=1000, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a request: whether the model was accepted, and the line that says so or why not."""

    success: bool
    message: str


class ModelReloads:
    """The service and the status of the node `name`, relative to the namespace of `node`."""

    def __init__(self, node: Node, name: str) -> None:
        self.statuses: list[DiagnosticStatus] = []
        self._client = node.create_client(Trigger, f"{name}/reload_model", qos_profile=QoSProfile(depth=1000))
        node.create_subscription(DiagnosticStatus, f"{name}/model_status", self.statuses.append, EVERY)

    def call(self, timeout_s: float = PATIENCE_S) -> Outcome:
        """Have the file read again; return the outcome, which is the answer itself for a file that is no model."""
        answer, end = self.answer(), time.monotonic() + timeout_s
        while (outcome := self._find_outcome(answer)) is None:
            assert time.monotonic() < end, "no outcome of reload_model in time"
            time.sleep(0.005)
        return outcome

    def answer(self) -> Trigger.Response:
        """Have the file read again; return the answer of the service."""
        return self.answers(1)[0]

    def answers(self, count: int) -> list[Trigger.Response]:
        """Make so many requests at once; return the answers."""
        assert self._client.wait_for_service(PATIENCE_S)
        futures = [self._client.call_async(Trigger.Request()) for _ in range(count)]
        wait_until(lambda: all(one.done() for one in futures), "no answer of reload_model in time")
        return [one.result() for one in futures]

    def _find_outcome(self, answer: Trigger.Response) -> Outcome | None:
        if not answer.success:
            return Outcome(False, answer.message)
        number = answer.message.partition(":")[0].removeprefix("request ")
        for status in list(self.statuses):
            values = {pair.key: pair.value for pair in status.values}
            if values["request"] == number and values["state"] in ENDS:
                return Outcome(values["state"] == "accepted", status.message)
        return None
