"""Receives all estimates and diagnoses of the observer with their times of arrival, and sends it requests.

Memory stays small enough for an hour at 1 kHz: estimates are kept in arrays.
"""

from __future__ import annotations

import threading
import time
from array import array
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from wire import read_estimate

from ces_observer.nodes.executors import EventsExecutor
from ces_observer.nodes.qos import LATCHED

NODE = "observer"
MODEL_TOPIC = "model"
DEEP = QoSProfile(depth=5000)
CHECK_EVERY = 997  # estimates: the middleware's own code must read the same values


class Estimates:
    """All estimates in the order of their arrival; stamps and times of arrival [ns], forces [N]."""

    def __init__(self) -> None:
        self.at, self.stamps, self.forces, self.others = array("q"), array("q"), array("d"), array("d")
        self.misread = 0

    def __len__(self) -> int:
        return len(self.others)

    def take(self, message: bytes) -> None:
        now = time.time_ns()
        stamp, position, speed, force = read_estimate(message)
        self.at.append(now)
        self.stamps.append(stamp)
        self.forces.append(force)
        self.others.append(position + speed)  # finite if and only if both are
        if len(self) % CHECK_EVERY == 1:
            self.misread += not is_same_estimate(
                deserialize_message(message, JointState), stamp, position, speed, force
            )


def is_same_estimate(message: JointState, stamp_ns: int, *numbers: float) -> bool:
    stamp = message.header.stamp
    read = [*message.position, *message.velocity, *message.effort]
    return stamp.sec * 10**9 + stamp.nanosec == stamp_ns and read == list(numbers)


@dataclass(frozen=True)
class ReceivedStatus:
    """A status of the observer and its time of arrival [ns]."""

    at: int
    level: int
    message: str
    values: dict[str, str]


class ObserverMonitor:
    """Subscriptions and clients in `namespace`, served by their own thread inside the context."""

    def __init__(self, namespace: str) -> None:
        self._context = rclpy.Context()
        self._context.init()
        self._name = f"{namespace}/{NODE}"
        self._node = rclpy.create_node("monitor", namespace=namespace, context=self._context)
        self.estimates = Estimates()
        self.diagnoses: list[ReceivedStatus] = []
        self._node.create_subscription(JointState, f"{NODE}/estimate", self.estimates.take, DEEP, raw=True)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, DEEP)
        self._models = self._node.create_publisher(String, MODEL_TOPIC, LATCHED)
        self._parameters = AsyncParameterClient(self._node, self._name)
        self._reload = self._node.create_client(Trigger, f"{NODE}/reload_model")
        self._outcomes: dict[str, tuple[bool, str]] = {}  # of requests for another model, by number
        self._node.create_subscription(DiagnosticStatus, f"{NODE}/model_status", self._on_model_status, LATCHED)
        self._executor = (EventsExecutor or SingleThreadedExecutor)(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin)

    def __enter__(self) -> ObserverMonitor:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._context.shutdown()
        self._thread.join()

    def set_parameter(self, name: str, value: Any, timeout_s: float = 10.0) -> tuple[bool, str]:
        """Set a parameter of the observer; return whether it was accepted, and the reason if not."""
        result = self._answer(self._parameters.set_parameters([Parameter(name, value=value)]), timeout_s).results[0]
        return result.successful, result.reason

    def reload_model(self, timeout_s: float = 30.0) -> tuple[bool, str]:
        """Make the observer reload its model; return whether it did, and its message."""
        answer = self._answer(self._reload.call_async(Trigger.Request()), timeout_s)
        if not answer.success:
            return False, answer.message
        number, end = answer.message.partition(":")[0].removeprefix("request "), time.monotonic() + timeout_s
        while number not in self._outcomes:
            if time.monotonic() > end:
                raise TimeoutError(f"{self._name}: no outcome of request {number} within {timeout_s:g} s")
            time.sleep(0.005)
        return self._outcomes[number]

    def publish_model(self, text: str) -> None:
        self._models.publish(String(data=text))

    def is_well(self, since_ns: int) -> bool:
        """Return whether an estimate came in the last 50 ms and the newest diagnosis after `since_ns` is no error."""
        newest = self.diagnoses[-1] if self.diagnoses else None
        recent = len(self.estimates) > 0 and time.time_ns() - self.estimates.at[-1] < 50_000_000
        return recent and newest is not None and newest.at > since_ns and newest.message.startswith("estimating")

    def _answer(self, future: Any, timeout_s: float) -> Any:
        end = time.monotonic() + timeout_s
        while not future.done():
            if time.monotonic() > end:
                raise TimeoutError(f"{self._name} has not answered within {timeout_s:g} s")
            time.sleep(0.005)
        return future.result()

    def _on_model_status(self, status: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in status.values}
        if values["state"] in ("accepted", "refused", "overtaken"):
            self._outcomes[values["request"]] = values["state"] == "accepted", status.message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.time_ns()
        self.diagnoses += [
            ReceivedStatus(now, status.level[0], status.message, {pair.key: pair.value for pair in status.values})
            for status in message.status
            if status.name.startswith(self._name)
        ]

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()
