"""The node's subscriptions: one for each topic and type, with any number of signals and dampers.

Messages come in as bytes; stamped numbers go to the subscribers of their signals. Messages that cannot be read from the
bytes are deserialised by rclpy. A failure in one signal's subscriber does not keep the sample from the others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message

from ces_observer.cdr.signal import RawSignal, Reading
from ces_observer.cdr.types import CdrUnsupportedError
from ces_observer.errors import SignalsError
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.message_types import fields_of, header_stamp_ns, is_stamped, message_class
from ces_observer.nodes.node_clock import NodeClock
from ces_observer.signals import Signal

INPUT_DEPTH = 1000  # a second at 1 kHz

Deliver = Callable[[int, float, bytes, int], None]  # stamp [ns], value [SI], frame id, the node's time on arrival [ns]
Read = Callable[[bytes], Reading]


class InputSubscriptions:
    """All subscriptions of the node.

    `on_message`, if set, is called with topic number, arrival [ns] and bytes of each message, and must not raise;
    `topics` lists (name, type) by these numbers.
    """

    def __init__(self, node: GuardedNode, clock: NodeClock) -> None:
        self._node = node
        self._clock = clock
        self._topics: dict[tuple[str, str], _Topic] = {}
        self.on_message: Callable[[int, int, bytes], None] | None = None

    @property
    def topics(self) -> list[tuple[str, str]]:
        """Resolved name and type of each topic."""
        return list(self._topics)

    def subscribe(
        self,
        signal: Signal,
        deliver: Deliver,
        on_unreadable: Callable[[str], None],
        on_failure: Callable[[], None] | None = None,
    ) -> bool:
        """Deliver each sample of `signal`, or the error that makes a message unreadable; return whether it is stamped.

        `on_failure` is called when one of the two has failed. A sample without a stamp is stamped on arrival. Signals
        in one message are delivered in the order of their subscriptions. Raises SignalsError if topic, type or field
        is wrong.
        """
        kind = message_class(signal)
        key = (self._resolve_topic(signal), signal.type)
        if key not in self._topics:
            self._topics[key] = _Topic(self, len(self._topics))
            qos = QoSProfile(depth=INPUT_DEPTH, reliability=QoSReliabilityPolicy.BEST_EFFORT)
            self._node.create_subscription(
                kind,
                signal.topic,
                self._topics[key].take,
                qos,
                raw=True,
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )
        slowly, guard = _make_slow_reader(signal, kind), self._node.guard
        guarded = guard.wrap(deliver, on_failure), guard.wrap(on_unreadable, on_failure)
        self._topics[key].readers.append((_make_raw_reader(signal) or slowly, slowly, *guarded))
        return is_stamped(kind)

    def _resolve_topic(self, signal: Signal) -> str:
        try:
            return str(self._node.resolve_topic_name(signal.topic))
        except (RuntimeError, ValueError):
            raise SignalsError(
                f"signal '{signal.name}': '{signal.topic}' is not a topic name; expected letters, digits, '_' and '/'"
            ) from None


class _Topic:
    """One topic's readers, each with its slow substitute and the callbacks for samples and for unreadable messages."""

    def __init__(self, inputs: InputSubscriptions, number: int) -> None:
        self._inputs = inputs
        self._number = number
        self.readers: list[tuple[Read, Read, Deliver, Callable[[str], None]]] = []

    def take(self, raw: bytes) -> None:
        """Read a message; the callback of the subscription."""
        inputs = self._inputs
        now_ns = inputs._clock.now()
        if inputs.on_message is not None:
            inputs.on_message(self._number, now_ns, raw)
        for read, slowly, deliver, unreadable in self.readers:
            try:
                try:
                    stamp_ns, value, frame = read(raw)
                except CdrUnsupportedError:
                    stamp_ns, value, frame = slowly(raw)
            except SignalsError as error:
                unreadable(str(error))
                continue
            deliver(now_ns if stamp_ns is None else stamp_ns, value, frame, now_ns)


def _make_raw_reader(signal: Signal) -> Read | None:
    try:
        return RawSignal(signal, fields_of).read
    except CdrUnsupportedError:
        return None


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
