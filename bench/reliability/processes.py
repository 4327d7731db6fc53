"""The processes of a campaign: the observer as a user starts it, its monitor, and the replaceable source of the ride.

The monitor receives all estimates and diagnoses of the observer with their times of arrival, and sends it requests.
Its memory stays small enough for an hour at 1 kHz: estimates are kept in arrays.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from array import array
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
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
from std_srvs.srv import Trigger

from bench.reliability.ride import read_estimate
from ces_observer.nodes.outputs import LATCHED
from ces_observer.nodes.rclpy_gaps import EventsExecutor

ROOT = Path(__file__).resolve().parents[2]


class ObserverProcess:
    """The node in its own process, with its log in a file."""

    def __init__(self, namespace: str, parameters: Mapping[str, object], log: Path) -> None:
        self._log = log
        words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        with log.open("w", encoding="utf-8") as out:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "ces_observer.nodes.observer", *ros_args(namespace), *words],
                cwd=ROOT,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def is_running(self) -> bool:
        return self.process.poll() is None

    def log(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace")

    def end(self, timeout_s: float = 15.0) -> list[str]:
        """Interrupt the observer like Ctrl-C; return the violations at its end."""
        if self.is_running():
            self.process.send_signal(signal.SIGCONT)
            self.process.send_signal(signal.SIGINT)
        try:
            status = self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return [f"the observer did not end within {timeout_s:g} s of SIGINT"]
        wrong = [f"the observer ended with status {status}"] if status else []
        return wrong + (["its log contains a traceback"] if "Traceback" in self.log() else [])


class SourceProcess:
    """The source's process; `restart` kills it and starts another."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        self._start()

    def wait_for_event(self, event: str, timeout_s: float = 20.0) -> dict[str, Any]:
        """Wait for an event of the source and return it; earlier events are dropped. Raises TimeoutError."""
        end = time.monotonic() + timeout_s
        while True:
            try:
                received = self._events.get(timeout=max(0.0, end - time.monotonic()))
            except queue.Empty:
                raise TimeoutError(f"the source did not report '{event}' within {timeout_s:g} s") from None
            if received["event"] == event:
                return dict(received)

    def send(self, **command: object) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(command) + "\n")
        self.process.stdin.flush()

    def stamp_now(self) -> int:
        """Return the stamp [ns] of the sample that is due now."""
        return self._began["good_ns"] + time.time_ns() - self._began["at_ns"]

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()

    def restart(self) -> dict[str, Any]:
        """Start another source and return its event `running`."""
        self._start()
        return self._began

    def _start(self) -> None:
        words = [sys.executable, "-m", "bench.reliability.source", *ros_args(self._namespace)]
        paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        self.process = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": paths},
            start_new_session=True,
        )
        self._events: queue.Queue[dict[str, Any]] = queue.Queue()
        threading.Thread(target=_listen, args=(self.process, self._events), daemon=True).start()
        self._began = self.wait_for_event("running")


def _listen(process: subprocess.Popen[str], events: queue.Queue[dict[str, Any]]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        events.put(json.loads(line))


def ros_args(namespace: str) -> list[str]:
    """Return the ROS arguments: the campaign's own namespace."""
    return ["--ros-args", "-r", f"__ns:={namespace}"]


NODE = "observer"
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
    """The observer's tasks in one line, the newest of all its values, and the time of arrival [ns]."""

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
        self._values: dict[str, str] = {}
        for topic in ("/diagnostics", f"{NODE}/details"):
            self._node.create_subscription(DiagnosticArray, topic, self._on_diagnostics, DEEP)
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
        own = [status for status in message.status if status.name.startswith(self._name)]
        if own:
            self._values = self._values | {pair.key: pair.value for status in own for pair in status.values}
            level, words = max(status.level[0] for status in own), "; ".join(status.message for status in own)
            self.diagnoses.append(ReceivedStatus(time.time_ns(), level, words, self._values))

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()
