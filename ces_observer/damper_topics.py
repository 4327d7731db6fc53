"""The topics of one damper: its position and current come in, its estimates go out."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState

from ces_observer.current_hold import ConstantCurrent, CurrentHold
from ces_observer.damper_observer import NO_CURRENT, SILENT, DamperObserver
from ces_observer.errors import SignalsError
from ces_observer.message_types import header_stamp_ns, is_stamped, message_class
from ces_observer.observer_parameters import Settings
from ces_observer.signals import Signal

INPUT_DEPTH = 100  # a tenth of a second at 1 kHz
OUTPUT_DEPTH = 10
LEAST_SILENCE_S = 0.2


class DamperTopics:
    """Subscriptions, publisher and estimator of one damper; `on_change` is called when its reason becomes another."""

    def __init__(self, node: Node, settings: Settings, on_change: Callable[[], None]) -> None:
        self.settings = settings
        self.damper = DamperObserver(settings.model, _current(settings), settings.max_age_s)
        self._node = node
        self._clock = node.get_clock()
        self._on_change = on_change
        self._told = self.damper.reason
        self._seen = 0
        self._quiet_s = 0.0
        self._estimate = _empty_estimate(settings.name)
        self._publisher = node.create_publisher(
            JointState, "~/estimate", QoSProfile(depth=OUTPUT_DEPTH), qos_overriding_options=_overridable()
        )
        if isinstance(settings.current, Signal):
            self._read_current = settings.current.reader()
            self._current_stamped = self._subscribe(settings.current, self._on_current)
        self._read_position = settings.position.reader()
        self._position_stamped = self._subscribe(settings.position, self._on_position)

    def watch(self, elapsed_s: float) -> None:
        """Look, `elapsed_s` after the last look, whether position samples still arrive."""
        samples = self.damper.tally.samples
        self._quiet_s = 0.0 if samples != self._seen else self._quiet_s + elapsed_s
        self._seen = samples
        if self._quiet_s >= max(LEAST_SILENCE_S, self.settings.model.sampling.max_gap_s):
            self.damper.silence()
            self._tell_change()

    def detail(self) -> str:
        """Return what there is to add to the damper's reason, the state of a silent topic included."""
        known = self.damper.explain()
        if known or self.damper.reason not in (SILENT, NO_CURRENT):
            return known
        silent = self.settings.position if self.damper.reason == SILENT else self.settings.current
        return self._topic_state(silent) if isinstance(silent, Signal) else ""

    def _subscribe(self, signal: Signal, callback: Callable[[Any], None]) -> bool:
        """Subscribe to the signal's topic; returns whether its messages are stamped."""
        kind = message_class(signal)
        qos = QoSProfile(depth=INPUT_DEPTH, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._node.create_subscription(kind, signal.topic, callback, qos, qos_overriding_options=_overridable())
        stamped = is_stamped(kind)
        if not stamped:
            self._node.get_logger().warning(
                f"signal '{signal.name}': {signal.type} has no header, so its samples are stamped when they arrive"
            )
        return stamped

    def _on_current(self, message: Any) -> None:
        stamp_ns = header_stamp_ns(message) if self._current_stamped else self._clock.now().nanoseconds
        try:
            self.damper.take_current(stamp_ns, self._read_current(message))
        except SignalsError as error:
            self.damper.unreadable_current(str(error))

    def _on_position(self, message: Any) -> None:
        now_ns = self._clock.now().nanoseconds
        stamp_ns = header_stamp_ns(message) if self._position_stamped else now_ns
        try:
            position = self._read_position(message)
        except SignalsError as error:
            self.damper.unreadable_position(str(error))
            return
        force = self.damper.step(stamp_ns, position, now_ns)
        if force is not None:
            self._publish(stamp_ns, message.header.frame_id if self._position_stamped else "", force)
        self._tell_change()

    def _publish(self, stamp_ns: int, frame_id: str, force: float) -> None:
        """Publish from the one message that is kept for it."""
        estimate = self._estimate
        header = estimate.header
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        header.frame_id = frame_id
        estimate.position[0] = self.damper.position
        estimate.velocity[0] = self.damper.speed
        estimate.effort[0] = force
        self._publisher.publish(estimate)

    def _tell_change(self) -> None:
        if self.damper.reason != self._told:
            self._told = self.damper.reason
            self._on_change()

    def _topic_state(self, signal: Signal) -> str:
        topic = self._node.resolve_topic_name(signal.topic)
        types = sorted({info.topic_type for info in self._node.get_publishers_info_by_topic(topic)})
        if not types:
            return f"nothing publishes {topic}"
        if signal.type not in types:
            return f"{topic} carries {', '.join(types)}; {signal.name}.type is {signal.type}"
        return f"{topic} has a publisher that is silent"


def _current(settings: Settings) -> CurrentHold | ConstantCurrent:
    if isinstance(settings.current, Signal):
        return CurrentHold(settings.model.sampling.max_current_age_s)
    return ConstantCurrent(settings.current.value)


def _empty_estimate(name: str) -> JointState:
    estimate = JointState(name=[name])
    for one in ("position", "velocity", "effort"):
        setattr(estimate, one, array("d", [0.0]))
    return estimate


def _overridable() -> QoSOverridingOptions:
    return QoSOverridingOptions.with_default_policies()
