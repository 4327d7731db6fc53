"""A rig behind ROS 2 topics: publishes set points of stroke and current, records position, current and force.

Every run begins with a slow move from where the piston is to the experiment's first stroke, and ends with one to its
last stroke. Whatever happens, Ctrl-C included, the safe current is set first; that move begins where the piston is.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64

from ces_data.arrays import F
from ces_data.findings import require_usable
from ces_data.recording import Channel, Recording
from ces_observer.nodes.inputs import header_stamp_ns, is_stamped, message_class
from ces_observer.signals import Constant, Signal, Signals
from ces_rig.errors import RigError
from ces_rig.experiments.commands import NEED, RigCommands
from ces_rig.limits import LiveLimits
from ces_rig.loop.rigs import RosRigSettings, RunWatch, smooth_move

AFTER_S = 0.2  # recorded after the last set point, and before the first
QOS = QoSProfile(depth=2000, reliability=QoSReliabilityPolicy.BEST_EFFORT)


class TopicRig:
    """The rig that `settings` and `signals` describe; each run has a node of its own."""

    def __init__(self, settings: RosRigSettings, signals: Signals) -> None:
        self._settings, self._signals = settings, signals

    def run(self, commands: RigCommands, folder: Path) -> Recording:
        """Run the commands and return the recording; raises RigError if the rig is silent or does not follow."""
        with _spinning_node() as node:
            return _TopicRun(node, self._settings, self._signals, commands).record()


class _TopicRun:
    """One run on a spinning node."""

    def __init__(self, node: Node, settings: RosRigSettings, signals: Signals, commands: RigCommands) -> None:
        self._node, self._settings, self._commands = node, settings, commands
        self._heard: dict[str, list[tuple[int, float]]] = {}
        self._newest: tuple[float, float] | None = None
        self._records = False
        self._constants = {n: s.value for n in NEED if isinstance(s := signals[n], Constant)}
        self._stroke = node.create_publisher(Float64, settings.stroke_topic, 10)
        self._current = node.create_publisher(Float64, settings.current_topic, 10)
        self._topics = {name: s.topic for name in NEED if isinstance(s := signals[name], Signal)}
        for name in self._topics:
            self._subscribe(signals[name])  # type: ignore[arg-type]
        self._last_m: float | None = None  # the newest set point of the stroke

    def record(self) -> Recording:
        """Approach, rest, run and return; the safe current comes last, whatever happens."""
        settings, commands = self._settings, self._commands
        first, last = float(commands.stroke_m[0]), float(commands.stroke_m[-1])
        self._wait_for_rig()
        try:
            self._move_to(first)
            self._move(first, first, commands.rest_s + AFTER_S)
            self._records = True
            self._move(first, first, AFTER_S)
            watch = RunWatch(settings, commands.name, time.monotonic())
            self._follow(*commands.at(1.0 / settings.rate_hz), watch.check)
            self._move(last, last, AFTER_S)
        finally:
            self._records = False
            self._stop(last)
        return self._recording()

    def _subscribe(self, signal: Signal) -> None:
        kind = message_class(signal)
        read, stamped, samples = signal.make_reader(), is_stamped(kind), self._heard.setdefault(signal.name, [])

        def hear(message: Any) -> None:
            value = read(message)
            stamp = header_stamp_ns(message) if stamped else 0
            if signal.name == "position":
                self._newest = (time.monotonic(), value)
            if self._records:
                samples.append((stamp or self._node.get_clock().now().nanoseconds, value))

        self._node.create_subscription(kind, signal.topic, hear, QOS)

    def _wait_for_rig(self) -> None:
        deadline = time.monotonic() + LiveLimits.FIND_S
        while missing := self._find_missing():
            if time.monotonic() > deadline:
                raise RigError(f"rig: {missing} after {LiveLimits.FIND_S:g} s; is it running, in this ROS_DOMAIN_ID?")
            time.sleep(0.05)

    def _find_missing(self) -> str:
        publishers = {self._settings.stroke_topic: self._stroke, self._settings.current_topic: self._current}
        for topic, publisher in publishers.items():
            if not publisher.get_subscription_count():
                return f"nobody subscribes to {topic}"
        for topic in self._topics.values():
            if not self._node.count_publishers(topic):
                return f"nobody publishes {topic}"
        return "" if self._newest or "position" not in self._topics else f"no message on {self._topics['position']}"

    def _move_to(self, stroke_m: float) -> None:
        """Move slowly from where the piston is; if positions have stopped, from the newest set point."""
        newest, begin = self._newest, stroke_m if self._last_m is None else self._last_m
        if newest is not None and time.monotonic() - newest[0] <= self._settings.silence_s:
            begin = newest[1]
        self._move(begin, stroke_m, self._settings.approach_s)

    def _move(self, begin_m: float, end_m: float, duration_s: float) -> None:
        """Move smoothly under the safe current, or hold still between equal ends."""
        stroke_m = smooth_move(begin_m, end_m, duration_s, self._settings.rate_hz)
        self._follow(stroke_m, np.full(len(stroke_m), self._settings.safe_current_A))

    def _follow(self, stroke_m: F, current_A: F, check: Callable[..., None] | None = None) -> None:
        """Publish the set points (n,) at their times; late ones follow at once."""
        begin, message = time.monotonic(), Float64()
        for k, (stroke, current) in enumerate(zip(stroke_m.tolist(), current_A.tolist(), strict=True)):
            ahead = begin + k / self._settings.rate_hz - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
            if check is not None:
                check(time.monotonic(), stroke, self._newest)
            message.data = stroke
            self._stroke.publish(message)
            self._last_m = stroke
            message.data = current
            self._current.publish(message)

    def _stop(self, stroke_m: float) -> None:
        """Set the safe current, then move slowly to the end of the experiment, unless it is there already."""
        safe = Float64(data=self._settings.safe_current_A)
        for _ in range(LiveLimits.SAFE_TIMES):
            self._current.publish(safe)
            time.sleep(1.0 / self._settings.rate_hz)
        if self._last_m is not None and abs(self._last_m - stroke_m) > 1e-6:
            self._move_to(stroke_m)

    def _recording(self) -> Recording:
        channels = {}
        for name, samples in self._heard.items():
            if len(samples) < 2:
                topic = self._topics[name]
                raise RigError(f"{self._commands.name}: {len(samples)} messages on {topic}; check the rig")
            stamps, values = zip(*samples, strict=True)
            unit = {"position": "m", "current": "A", "force": "N"}[name]
            channels[name] = Channel(name, unit, np.array(stamps, np.int64), np.array(values, np.float64))
        for name, value in self._constants.items():
            stamps_ns = channels["position"].stamps_ns
            channels[name] = Channel(name, "A", stamps_ns, np.full(len(stamps_ns), value))
        recording = Recording(self._commands.name, channels)
        require_usable(recording)
        return recording


@contextmanager
def _spinning_node() -> Iterator[Node]:
    """Yield a node that a thread spins; Ctrl-C stays with the program."""
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("ces_iterate", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def spin() -> None:
        with suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    try:
        yield node
    finally:
        executor.shutdown()
        thread.join(5.0)
        node.destroy_node()
        context.try_shutdown()
