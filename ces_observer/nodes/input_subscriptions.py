"""The node's subscriptions: one for each topic and type, with any number of signals and dampers.

Messages come in as bytes; stamped numbers go to the subscribers of their signals. Messages that cannot be read from the
bytes are deserialised by rclpy. A failure in one signal's subscriber does not keep the sample from the others.

After a stall the messages that have queued up are read in the order in which they were sent. The EventsExecutor does so
by itself. A SingleThreadedExecutor takes one message of each topic at a time and may be slower than they arrive, so
with it the first callback takes all waiting messages of all topics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from inspect import Parameter, Signature
from operator import itemgetter
from time import time_ns
from typing import Any

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from ces_observer.arrival_clock import ArrivalClock
from ces_observer.cdr.signal import RawSignal, Reading
from ces_observer.cdr.types import CdrUnsupportedError
from ces_observer.errors import SignalsError
from ces_observer.health.losses import Losses
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.message_types import fields_of, header_stamp_ns, is_stamped, message_class
from ces_observer.nodes.node_clock import NodeClock
from ces_observer.nodes.observer_table import INPUT_DEPTH
from ces_observer.signals import Signal

Deliver = Callable[[int, float, bytes, int], None]  # stamp [ns], value [SI], frame id, the node's time on arrival [ns]
Read = Callable[[bytes], Reading]
Taken = tuple[bytes, dict[str, Any]]  # a message and rclpy's information about it
MAX_ROUNDS = 100  # through all topics, before what was taken is read
_MESSAGE_AND_INFO = Signature([Parameter(name, Parameter.POSITIONAL_ONLY) for name in ("message", "info")])


class InputSubscriptions:
    """All subscriptions of the node, with queues of `depth` messages; `drain` for a SingleThreadedExecutor.

    `on_message`, if set, is called with topic number, arrival [ns] and bytes of each message, and must not raise;
    `topics` lists (name, type) by these numbers.
    """

    def __init__(self, node: GuardedNode, clock: NodeClock, *, depth: int = INPUT_DEPTH, drain: bool = False) -> None:
        self._node = node
        self._clock = clock
        self._depth = depth
        self._drain = drain
        self._topics: dict[tuple[str, str], _Topic] = {}
        self.on_message: Callable[[int, int, bytes], None] | None = None

    @property
    def topics(self) -> list[tuple[str, str]]:
        """Resolved name and type of each topic."""
        return list(self._topics)

    def reset(self) -> None:
        """Forget the delays of messages, as after a time jump."""
        for topic in self._topics.values():
            topic.reset()

    def losses_of(self, signal: Signal) -> Losses:
        """Return the losses on a subscribed signal's topic, as far as they are known."""
        return self._topics[self._resolve_topic(signal), signal.type].losses

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
            self._topics[key] = topic = _Topic(self, len(self._topics), self._depth)
            qos = QoSProfile(depth=self._depth, reliability=QoSReliabilityPolicy.BEST_EFFORT)
            topic.subscription = self._node.create_subscription(
                kind,
                signal.topic,
                topic,
                qos,
                raw=True,
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )
            topic.losses.depth = topic.subscription.qos_profile.depth
        slowly, guard = _make_slow_reader(signal, kind), self._node.guard
        guarded = guard.wrap(_move_stamps_back(deliver, signal), on_failure), guard.wrap(on_unreadable, on_failure)
        self._topics[key].readers.append((_make_raw_reader(signal) or slowly, slowly, *guarded))
        return is_stamped(kind)

    def take_all(self, topic: _Topic, first: Taken) -> None:
        """Read a message and all that wait on any topic, in the order in which they were sent."""
        taken = [(one.arrived_ns(message), one, message) for one, message in self._take_waiting(topic, first)]
        for _, one, message in sorted(taken, key=itemgetter(0)):
            self._node.guard.call(partial(one.read, *message))

    def _take_waiting(self, topic: _Topic, first: Taken) -> Iterator[tuple[_Topic, Taken]]:
        """Yield the messages of all topics until none waits: after a stall the middleware still hands them over."""
        yield topic, first
        for _ in range(MAX_ROUNDS):
            found = [(one, message) for one in self._topics.values() for message in one.take_waiting(self._depth)]
            if not found:
                return
            yield from found

    def _resolve_topic(self, signal: Signal) -> str:
        try:
            return str(self._node.resolve_topic_name(signal.topic))
        except (RuntimeError, ValueError):
            raise SignalsError(
                f"signal '{signal.name}': '{signal.topic}' is not a topic name; expected letters, digits, '_' and '/'"
            ) from None


class _Topic:
    """One topic's readers, each with its slow substitute and the callbacks for samples and for unreadable messages.

    It is the callback of the subscription, called with message and information.
    """

    __signature__ = _MESSAGE_AND_INFO  # rclpy counts the parameters

    def __init__(self, inputs: InputSubscriptions, number: int, depth: int) -> None:
        self._inputs = inputs
        self._number = number
        self._numbered = True  # the middleware numbers the messages, as far as is known
        self._drain = inputs._drain
        self._arrived_ns = 0
        self.subscription: Subscription | None = None
        self.arrivals = ArrivalClock()
        self.losses = Losses(depth)
        self.readers: list[tuple[Read, Read, Deliver, Callable[[str], None]]] = []

    def __call__(self, *taken: Any) -> None:
        message, info = taken if len(taken) == 2 else taken[0]  # EventsExecutors up to 7.1.11 pass one tuple
        if self._drain:
            self._inputs.take_all(self, (message, info))
        else:
            self.read(message, info)

    def reset(self) -> None:
        """Forget the delays of messages."""
        self.arrivals.reset()
        self._arrived_ns = 0

    def read(self, raw: bytes, info: dict[str, Any]) -> None:
        """Read a message; `info` has the time of sending, and its number where the middleware has one."""
        inputs = self._inputs
        now_ns = inputs._clock.now()
        if self._numbered:
            self._numbered = self.losses.take_number(info.get("publication_sequence_number"))
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
            if stamp_ns is None:
                stamp_ns = self._stamp_arrival(info, now_ns)
            deliver(stamp_ns, value, frame, now_ns)

    def take_waiting(self, most: int) -> Iterator[Taken]:
        """Take the messages that wait in the queue, at most `most`."""
        subscription = self.subscription
        if subscription is None:
            return
        handle = subscription.handle
        with handle:
            for _ in range(most):
                taken = handle.take_message(subscription.msg_type, True)
                if taken is None:
                    return
                yield taken

    def arrived_ns(self, taken: Taken) -> int:
        """Return the arrival of a message by the computer's clock [ns], never before that of the one before."""
        stamp_ns = self.arrivals.stamp(taken[1]["source_timestamp"], time_ns())
        self._arrived_ns = max(stamp_ns, self._arrived_ns)
        return self._arrived_ns

    def _stamp_arrival(self, info: dict[str, Any], now_ns: int) -> int:
        """Return the arrival [ns] of a message without a stamp; simulated time does not show when it was sent."""
        if self._inputs._clock.is_simulated:
            return now_ns
        return self.arrivals.stamp(info["source_timestamp"], now_ns)


def _move_stamps_back(deliver: Deliver, signal: Signal) -> Deliver:
    """Return a function that delivers samples with stamps moved back by the signal's delay."""
    delay_ns = signal.delay_ns
    if not delay_ns:
        return deliver

    def deliver_earlier(stamp_ns: int, value: float, frame: bytes, now_ns: int) -> None:
        deliver(stamp_ns - delay_ns, value, frame, now_ns)

    return deliver_earlier


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
