"""The observer's inputs: subscriptions to the topics of signals, whose numbers are read from the bytes of messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from operator import itemgetter
from time import time_ns
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSPolicyKind, QoSProfile, QoSReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rosidl_runtime_py.utilities import get_message

from ces_observer.arrival_clock import ArrivalClock
from ces_observer.cdr.layout import CdrUnsupportedError
from ces_observer.cdr.signal import RawSignal, Reading
from ces_observer.errors import SignalsError
from ces_observer.health.streams import Losses
from ces_observer.nodes.executors import NodeClock
from ces_observer.nodes.guard import Guard
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.parameter_table import INPUT_DEPTH
from ces_observer.nodes.rclpy_gaps import MESSAGE_AND_INFO, Taken, split_message, take_waiting
from ces_observer.signals import Signal


def message_class(signal: Signal) -> Any:
    """Return the class of the signal's message type; raises SignalsError if it or the field is missing."""
    try:
        kind = get_message(signal.type)
    except (ImportError, AttributeError, ValueError):
        raise SignalsError(
            f"signal '{signal.name}': message type '{signal.type}' is not installed; check {signal.name}.type, or "
            "source the workspace that has it"
        ) from None
    _check_field(signal, kind())
    return kind


def fields_of(type_name: str) -> Mapping[str, str]:
    """Return the fields of a type (`package/Type` or `package/msg/Type`) with their types in rosidl's notation.

    Raises LookupError if the type is not installed.
    """
    package, *_, name = type_name.split("/")
    try:
        fields: Mapping[str, str] = get_message(f"{package}/msg/{name}").get_fields_and_field_types()
    except (ImportError, AttributeError, ValueError):
        raise LookupError(f"message type '{type_name}' is not installed") from None
    return fields


def is_stamped(kind: Any) -> bool:
    """Return whether messages of this class have a std_msgs/Header."""
    return bool(kind.get_fields_and_field_types().get("header") == "std_msgs/Header")


def header_stamp_ns(message: Any) -> int:
    """Return the header stamp of a stamped message [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


def _check_field(signal: Signal, message: Any) -> None:
    """Check the field path in an empty message, up to the first array."""
    where = f"signal '{signal.name}': field '{signal.field.text}' of {signal.type}"
    value = message
    for name, element in signal.field.steps:
        fields = value.get_fields_and_field_types() if hasattr(value, "get_fields_and_field_types") else {}
        if name not in fields:
            raise SignalsError(f"{where}: no '{name}'; known are {', '.join(fields) or 'no fields'}")
        value = getattr(value, name)
        if element is not None:
            if isinstance(value, str) or not hasattr(value, "__len__"):
                raise SignalsError(f"{where}: '{name}' is not an array; omit [{element}]")
            return
    if not isinstance(value, int | float):
        raise SignalsError(f"{where} is a {type(value).__name__}; expected the path to a number")


Deliver = Callable[[int, float, bytes, int], None]  # stamp [ns], value [SI], frame id, the node's time on arrival [ns]
Read = Callable[[bytes], Reading]
OVERRIDABLE = [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DEADLINE,
               QoSPolicyKind.LIVELINESS, QoSPolicyKind.LIVELINESS_LEASE_DURATION]  # fmt: skip
MAX_ROUNDS = 100  # through all topics, before what was taken is read


class InputSubscriptions:
    """All subscriptions of the node, with queues of `depth` messages; `drain` for a SingleThreadedExecutor.

    `on_silence` is called with a topic that has missed its deadline, or whose last publisher is gone, where the
    overrides of its quality of service have a deadline or a lease.
    """

    def __init__(
        self, node: GuardedNode, clock: NodeClock, *, depth: int = INPUT_DEPTH, drain: bool = False,
        on_silence: Callable[[str], None] = lambda topic: None,
    ) -> None:  # fmt: skip
        self._node, self.clock, self._depth, self.drain = node, clock, depth, drain
        self._on_silence = on_silence
        self._topics: dict[tuple[str, str], _Topic] = {}

    def reset(self) -> None:
        """Forget the delays of messages, as after a time jump."""
        for topic in self._topics.values():
            topic.reset()

    def close(self) -> None:
        """End all subscriptions."""
        for topic in self._topics.values():
            self._node.destroy_subscription(topic.subscription)
        self._topics.clear()

    def losses_of(self, signal: Signal) -> Losses:
        """Return the losses on a subscribed signal's topic, as far as they are known."""
        return self._topics[self._resolve_topic(signal), signal.type].losses

    def find_mismatch(self, signal: Signal) -> str:
        """Return a sentence on publishers of the signal's topic with other types, or too many; empty without any.

        Several may publish the same topic where the field names a joint.
        """
        topic = self._resolve_topic(signal)
        subscription = self._topics[topic, signal.type].subscription
        count = 0 if subscription is None else subscription.get_publisher_count()
        if count > 1 and not any(isinstance(element, str) for _, element in signal.field.steps):
            return f"{topic} has {count} publishers, whose samples mix; expected one"
        if subscription is None or self._node.count_publishers(topic) <= count:
            return ""
        types = {info.topic_type for info in self._node.get_publishers_info_by_topic(topic)}
        others = ", ".join(sorted(types - {signal.type}))
        text = f"{topic} also carries {others}, which is not read; {signal.name}.type is {signal.type}"
        return text if others else ""

    def subscribe(
        self,
        signal: Signal,
        deliver: Deliver,
        on_unreadable: Callable[[str], None],
        on_failure: Callable[[], None] | None = None,
    ) -> bool:
        """Deliver each sample of `signal`, or the error that makes a message unreadable; return whether it is stamped.

        `on_failure` is called when one of the two has failed. A sample without a stamp is stamped with its arrival
        (ArrivalClock). Signals in one message are delivered in the order of their subscriptions. Raises SignalsError if
        topic, type or field is wrong.
        """
        kind = message_class(signal)
        key = (self._resolve_topic(signal), signal.type)
        if key not in self._topics:
            self._topics[key] = topic = (_DrainedTopic if self.drain else _Topic)(self, self._node.guard, self._depth)
            qos = QoSProfile(depth=self._depth, reliability=QoSReliabilityPolicy.BEST_EFFORT)
            options: dict[str, Any] = {"qos_overriding_options": QoSOverridingOptions(OVERRIDABLE)}
            options["event_callbacks"] = self._make_event_callbacks(key[0])
            topic.subscription = self._node.create_subscription(kind, signal.topic, topic, qos, raw=True, **options)
            topic.losses.set_depth(topic.subscription.qos_profile.depth)
        read = slowly = _make_slow_reader(signal, kind)
        with suppress(CdrUnsupportedError):
            read = RawSignal(signal, fields_of).read
        on_unreadable = self._node.guard.wrap(on_unreadable, on_failure)
        self._topics[key].readers.append((read, slowly, signal.delay_ns, deliver, on_unreadable, on_failure))
        return is_stamped(kind)

    def _make_event_callbacks(self, topic: str) -> SubscriptionEventCallbacks:
        """Return callbacks of those events that were asked for: each costs a SingleThreadedExecutor some time."""

        def is_set(policy: str) -> bool:
            return bool(self._node.get_parameter_or(f"qos_overrides.{topic}.subscription.{policy}").value)

        def on_liveliness(change: Any) -> None:
            if change.alive_count == 0 and change.alive_count_change < 0:
                self._on_silence(topic)

        return SubscriptionEventCallbacks(
            deadline=self._node.guard.wrap(lambda _: self._on_silence(topic)) if is_set("deadline") else None,
            liveliness=self._node.guard.wrap(on_liveliness) if is_set("liveliness_lease_duration") else None,
        )

    def take_all(self, topic: _Topic, first: Taken) -> None:
        """Read a message and all that wait on any topic, in the order in which they were sent."""
        taken = [
            (from_topic.arrived_ns(message), from_topic, message)
            for from_topic, message in self._take_waiting(topic, first)
        ]
        for _, from_topic, message in sorted(taken, key=itemgetter(0)):
            self._node.guard.call(partial(_Topic.__call__, from_topic, *message))

    def _take_waiting(self, topic: _Topic, first: Taken) -> Iterator[tuple[_Topic, Taken]]:
        """Yield the messages of all topics until none waits: after a stall the middleware still hands them over."""
        yield topic, first
        for _ in range(MAX_ROUNDS):
            taken = [
                (waiting_topic, message)
                for waiting_topic in self._topics.values()
                if waiting_topic.subscription is not None
                for message in take_waiting(waiting_topic.subscription, self._depth)
            ]
            if not taken:
                return
            yield from taken

    def _resolve_topic(self, signal: Signal) -> str:
        try:
            return str(self._node.resolve_topic_name(signal.topic))
        except (RuntimeError, ValueError):
            raise SignalsError(
                f"signal '{signal.name}': '{signal.topic}' is not a topic name; expected letters, digits, '_' and '/'"
            ) from None


class _Topic:
    """One topic's readers, each with its slow substitute, delay [ns], and the callbacks for samples, errors, failures.

    It is the callback of the subscription, called with message and information.
    """

    __signature__ = MESSAGE_AND_INFO  # rclpy counts the parameters

    def __init__(self, inputs: InputSubscriptions, guard: Guard, depth: int) -> None:
        self._inputs, self._clock, self._guard = inputs, inputs.clock, guard
        self._numbered = True  # the middleware numbers the messages, as far as is known
        self._arrived_ns = 0
        self.subscription: Subscription | None = None
        self.arrivals = ArrivalClock()
        self.losses = Losses(depth)
        self.readers: list[tuple[Read, Read, int, Deliver, Callable[[str], None], Callable[[], None] | None]] = []

    def reset(self) -> None:
        """Forget the delays of messages."""
        self.arrivals.reset()
        self._arrived_ns = 0

    def __call__(self, raw: Any, info: Any = None) -> None:
        """Read a message; `info` has the time of sending, and its number where the middleware has one."""
        raw, info = split_message(raw, info)
        clock = self._clock
        now_ns = clock.now()
        if self._numbered:
            self._numbered = self.losses.take_number(info.get("publication_sequence_number"))
        for read, slowly, delay_ns, deliver, on_unreadable, on_failure in self.readers:
            try:
                try:
                    stamp_ns, value, frame = read(raw)
                except CdrUnsupportedError:
                    stamp_ns, value, frame = slowly(raw)
            except SignalsError as error:
                on_unreadable(str(error))
                continue
            if stamp_ns is None:  # simulated time does not show when the message was sent
                stamp_ns = now_ns if clock.is_simulated else self.arrivals.stamp(info["source_timestamp"], now_ns)
            try:
                deliver(stamp_ns - delay_ns, value, frame, now_ns)
            except Exception as error:
                self._guard.catch(error, on_failure)

    def arrived_ns(self, taken: Taken) -> int:
        """Return the arrival of a message by the computer's clock [ns], never before that of the one before."""
        stamp_ns = self.arrivals.stamp(taken[1]["source_timestamp"], time_ns())
        self._arrived_ns = max(stamp_ns, self._arrived_ns)
        return self._arrived_ns


class _DrainedTopic(_Topic):
    """A topic for an executor that takes one message of a topic at a time."""

    def __call__(self, raw: Any, info: Any = None) -> None:
        """Read this message and all that wait on any topic."""
        self._inputs.take_all(self, split_message(raw, info))


def _make_slow_reader(signal: Signal, kind: Any) -> Read:
    """Return a reader that lets rclpy deserialise the whole message."""
    value_of, stamped = signal.make_reader(), is_stamped(kind)

    def read(raw: bytes) -> Reading:
        try:
            message = deserialize_message(raw, kind)
        except RuntimeError as error:
            raise SignalsError(f"a message of {signal.topic} cannot be deserialised: {error}") from None
        value = value_of(message)
        return (header_stamp_ns(message), value, message.header.frame_id.encode()) if stamped else (None, value, b"")

    return read
