"""The vehicle around the node: publishes position and current, hears estimates and diagnostics."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from math import pi, sin
from types import TracebackType

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Float64

DEEP = QoSProfile(depth=5000)  # reliable
JOINT = "rear_damper"
RATE_HZ = 1000


def stroke(time_s: float) -> float:
    """Return the position [m] of a 2 Hz sine of 20 mm."""
    return 0.02 * sin(2.0 * pi * 2.0 * time_s)


class Vehicle:
    """Publishers and subscriptions in one namespace; what is heard is kept in `estimates` and `statuses`."""

    def __init__(self, namespace: str) -> None:
        self._context = rclpy.Context()
        self._context.init()
        self._name = f"{namespace}/observer"
        self.node = rclpy.create_node("vehicle", namespace=namespace, context=self._context)
        self.estimates: list[JointState] = []
        self.arrivals: list[int] = []  # [ns] of the estimates
        self.statuses: list[DiagnosticStatus] = []
        self.node.create_subscription(JointState, "observer/estimate", self._hear_estimate, DEEP)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear_diagnostics, DEEP)
        self.position = self.node.create_publisher(JointState, "joint_states", DEEP)
        self.current = self.node.create_publisher(Float64, "valve_current", DEEP)
        self.stamped_current = self.node.create_publisher(Temperature, "stamped_current", DEEP)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)

    def __enter__(self) -> Vehicle:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._executor.shutdown()
        self._thread.join()
        self.node.destroy_node()
        self._context.shutdown()

    def meets_node(self) -> None:
        """Wait until the node hears this vehicle's position and this vehicle hears the node."""
        wait(lambda: self.position.get_subscription_count() > 0, "the node subscribes to position")
        wait(lambda: self.node.count_publishers("observer/estimate") > 0, "the node offers estimates")
        time.sleep(0.3)  # matching is told to each side on its own

    def drive(
        self,
        duration_s: float,
        *,
        joint: str = JOINT,
        position: Callable[[float], float] = stroke,
        current: float | None = 0.5,
        clock_offset_s: float = 0.0,
    ) -> tuple[int, int]:
        """Publish at 1 kHz for `duration_s`, a current at every fifth sample; return the first and last time [ns]."""
        times = []
        offset_ns = round(clock_offset_s * 1e9)
        start = time.monotonic()
        for k in range(round(duration_s * RATE_HZ)):
            time.sleep(max(0.0, start + k / RATE_HZ - time.monotonic()))
            times.append(time.time_ns())
            if current is not None and k % 5 == 0:
                self.current.publish(Float64(data=current))
            self.publish_position(times[-1] + offset_ns, position(times[-1] % 10**12 * 1e-9), joint)
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

    def stamps(self) -> list[int]:
        """Return the stamps of the estimates heard [ns]."""
        return [stamp_of(estimate) for estimate in list(self.estimates)]

    def hears(self, text: str, level: bytes = DiagnosticStatus.ERROR, timeout_s: float = 10.0) -> DiagnosticStatus:
        """Wait for a status that has `text` in its message, and return it."""
        wait(
            lambda: self._find(text, level) is not None, f"'{text}' in {[s.message for s in self.statuses]}", timeout_s
        )
        return self._find(text, level)

    def _find(self, text: str, level: bytes) -> DiagnosticStatus | None:
        return next((s for s in list(self.statuses) if text in s.message and s.level == level), None)

    def _hear_estimate(self, message: JointState) -> None:
        self.arrivals.append(time.time_ns())
        self.estimates.append(message)

    def _hear_diagnostics(self, message: DiagnosticArray) -> None:
        self.statuses.extend(s for s in message.status if s.name.startswith(self._name))


def stamp_of(message: JointState) -> int:
    """Return the header stamp [ns]."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def wait(condition: Callable[[], bool], what: str, timeout_s: float = 10.0) -> None:
    """Wait until `condition` holds; fail, naming `what`, if it does not in time."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, f"not within {timeout_s} s: {what}"
        time.sleep(0.01)


def reliable_inputs(namespace: str, topics: Iterable[str]) -> dict[str, object]:
    """Return parameters that make the node's inputs lossless, for tests that compare sample by sample."""
    found: dict[str, object] = {}
    for topic, kind in [*((topic, "subscription") for topic in topics), ("observer/estimate", "publisher")]:
        found[f"qos_overrides.{namespace}/{topic}.{kind}.reliability"] = "reliable"
        found[f"qos_overrides.{namespace}/{topic}.{kind}.depth"] = 5000
    return found
