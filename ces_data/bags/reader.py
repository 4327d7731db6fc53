"""Bags into recordings: finds the signals' topics, reads their numbers, and scales them to SI units.

Stamps come from the message's header if its type has one; otherwise, or if the header was never filled in, from the
time at which the bag logged the message.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ces_data.bags.clocks import HeaderClock, compare_clocks, find_shift
from ces_data.bags.decode import MessageDecoder, TopicSamples
from ces_data.bags.fields import format_fields
from ces_data.bags.storage import ALONE, MEASURED, Bag, Topic, open_bag
from ces_data.limits import OrderLimits, RecordingLimits, StatisticLimits
from ces_data.recording import Channel, Recording, Stamps, Values
from ces_data.samples import INTEGRATED, velocity_beside
from ces_observer.errors import RecordingError, SignalsError
from ces_observer.signals import Constant, FieldPath, Signal, Signals

INPUTS = ("position", "current")
MAX_TOPICS_LISTED, MAX_OTHERS = 20, 3
# `ros2 bag record --compression-mode message` compresses on one thread for each core and stores a message when its
# thread is done (rosbag2's SequentialCompressionWriter), so a message may follow later ones. It fills a hole that it
# left. Where a clock was set back, or a bag was played again, time that was recorded already comes a second time.


class RecordingWarning(UserWarning):
    """A fact about a recording that the user should know; the program continues."""


class LogTimeWarning(RecordingWarning):
    """A signal is stamped with the times at which its messages were logged."""


def list_topics(path: Path) -> tuple[Topic, ...]:
    """Return the topics of a bag, by name; raises RecordingError if it cannot be opened."""
    with open_bag(path) as bag:
        return bag.topics


def read_recording(path: Path, signals: Signals, need: Collection[str] = INPUTS) -> Recording:
    """Read the described signals from a rosbag2 folder or an `.mcap` file.

    The signals named in `need` must be present, as a topic or a constant; the others may be absent. Raises
    RecordingError or SignalsError if the bag is damaged, truncated or empty, if a topic is missing or has another type,
    or if no message has a field. The speed that `ces import` wrote beside the position is
    read, too. Issues a LogTimeWarning for each signal stamped with log times (those in bags of
    `writer` are exact), and a RecordingWarning for samples that were stored late and are sorted in, and for a
    recorder that was killed.
    """
    with open_bag(path) as bag:
        if bag.warning:
            warnings.warn(bag.warning, RecordingWarning, stacklevel=2)
        if not any(topic.count for topic in bag.topics):
            expected = f"expected a recording of {', '.join(need) or 'signals'}"
            raise RecordingError(f"{path}: the bag holds no messages; {expected}")
        by_topic: dict[Topic, list[Signal]] = {}
        beside = velocity_beside(signals["position"]) if bag.speed and "speed" not in signals.by_name else None
        if beside is not None:
            signals = replace(signals, by_name={**signals.by_name, "speed": beside})
        if bag.speed == ALONE:
            warnings.warn(INTEGRATED, RecordingWarning, stacklevel=2)
        for signal in signals.list_topic_signals():
            topic = _find_topic(bag, signal, signals, signal.name in need)
            if topic is not None:
                by_topic.setdefault(topic, []).append(signal)
        readers = {topic.name: _TopicReader(bag, topic, mine) for topic, mine in by_topic.items()}
        for name, block in bag.blocks(readers):
            readers[name].add(block)
        by_name: dict[str, Channel] = {}
        shift_ns = _find_shift(bag, list(readers.values()))
        for name in list(readers):
            by_name |= readers.pop(name).channels(shift_ns)  # frees what it has read
        digest = bag.sha256()
    sorted_ = {name: sort_late_samples(by_name[name]) for name in signals.by_name if name in by_name}
    texts = [f"{name} {late}" for name, (_, late) in sorted_.items() if late]
    if texts:
        text = f"stored after later samples, and sorted by stamp: {', '.join(texts)}"
        warnings.warn(text, RecordingWarning, stacklevel=2)
    constants = {s.name: s.value for s in signals.by_name.values() if isinstance(s, Constant)}
    channels = {name: channel for name, (channel, _) in sorted_.items()}
    optional = frozenset({"speed"} if beside is not None and bag.speed == MEASURED else ())
    return Recording(path.name if path.is_dir() else path.stem, channels, constants, str(path), digest, optional)


def _find_shift(bag: Bag, readers: Sequence[_TopicReader]) -> int:
    """Return by how much the log times of topics without headers are moved back [ns]; warns of it."""
    if bag.exact_log_times:
        return 0
    clocks = [clock for reader in readers if (clock := reader.clock())]
    unstamped = [reader.topic.name for reader in readers if not reader.join()[0].any()]
    shift_ns, texts = find_shift(clocks, unstamped, str(bag.path))
    for text in texts:
        warnings.warn(text, RecordingWarning, stacklevel=3)
    return shift_ns


def _find_topic(bag: Bag, signal: Signal, signals: Signals, needed: bool) -> Topic | None:
    """Return the topic of a signal; None if it is not in the bag and not `needed`."""
    topics = [topic for topic in bag.topics if signal.matches(topic.name)]
    for topic in topics:
        if topic.type == signal.type:
            return topic
    advice = f"'ces signals {bag.path} --out my_signals.yaml' proposes a file for --signals"
    if signal.name in signals.assumed and len(signals.assumed) < len(signals.by_name):
        missing = f"{signals.source} has no key '{signal.name}', so its default was looked for"
        advice = f"{missing}: add it, with topic, type and field"
    if topics:
        raise SignalsError(
            f"{signals.source}: signal '{signal.name}': topic '{signal.topic}' is {topics[0].type} in {bag.path}, not"
            f" {signal.type}; correct type and field, or: {advice}"
        )
    if not needed:
        return None
    shown = [f"{topic.name} ({topic.type})" for topic in bag.topics[:MAX_TOPICS_LISTED]]
    more = [f"{len(bag.topics) - MAX_TOPICS_LISTED} more"] if len(bag.topics) > MAX_TOPICS_LISTED else []
    has = ", ".join(shown + more) or "none"
    raise RecordingError(f"{bag.path}: no topic '{signal.topic}' for {signal.name}; the bag has {has}; {advice}")


class _TopicReader(TopicSamples):
    """Collects the samples of all signals in one topic."""

    def __init__(self, bag: Bag, topic: Topic, signals: list[Signal]) -> None:
        self.topic, self.signals, self.exact_log_times = topic, signals, bag.exact_log_times
        self.publishers = max(stored.publishers for stored in bag.stored_topics if stored.name == topic.name)
        where = f"{bag.path}: topic {topic.name}"
        fields = [signal.field for signal in signals]
        super().__init__(MessageDecoder(topic.type, fields, bag.typestore(topic), where))

    def clock(self) -> HeaderClock | None:
        """Return the clock of the headers against the log's, None without."""
        return compare_clocks(self.topic.name, *self.join()[:2], self.signals[0].delay_ns)

    def channels(self, shift_ns: int) -> dict[str, Channel]:
        """Return the channels by signal, log times moved back by `shift_ns`; raises SignalsError without a field."""
        header_ns, log_ns, values, present = self.join()
        channels = {}
        for i, signal in enumerate(self.signals):
            rows = present[:, i]
            self._require_field(i, signal, int(rows.sum()))
            self._require_one_name(i, signal)
            stamped = bool(header_ns[rows].any())
            dated = stamped and header_ns.max() > 1e9 * RecordingLimits.BOOT_S  # else 0 may be the first time
            if empty := int((header_ns[rows] == 0).sum()) if dated else 0:
                text = f"{empty} of {rows.sum()} messages on {self.topic.name} have an empty header stamp"
                warnings.warn(f"{signal.name}: {text}; they are left out", RecordingWarning, stacklevel=2)
                rows = rows & (header_ns != 0)
            if rows.any() and not stamped and not self.exact_log_times:
                reason = "an empty header stamp" if self.decoder.stamp else "no header"
                text = f"{self.topic.type} on {self.topic.name} has {reason}; stamped with the bag's log time"
                warnings.warn(f"{signal.name}: {text}", LogTimeWarning, stacklevel=2)
            stamps = (header_ns if stamped else log_ns - shift_ns)[rows] - signal.delay_ns
            numbers = signal.scale * values[rows, i] + signal.offset
            by_name = any(isinstance(element, str) for _, element in signal.field.steps)
            if signal.name == "position" and is_interleaved(numbers):
                text = f"every other message on {self.topic.name} goes on another series (two publishers of one topic?)"
                warnings.warn(f"position: {text}; record one of them", RecordingWarning, stacklevel=2)
            elif self.publishers > 1 and not by_name:
                text = f"{self.topic.name} had {self.publishers} publishers when it was recorded, whose samples mix"
                warnings.warn(f"{signal.name}: {text}; record one of them", RecordingWarning, stacklevel=2)
            channels[signal.name] = Channel(signal.name, signal.unit, stamps, numbers)
        return channels

    def _require_one_name(self, i: int, signal: Signal) -> None:
        """Raise RecordingError if an index belongs to several joints; warn of, and leave out, fewer than 1 %."""
        first, others = self.decoder.names[i], self.decoder.others[i]
        if not others:
            return
        count, listed = others.total(), ", ".join(f"'{name}' in {n}" for name, n in others.most_common(MAX_OTHERS))
        text = f"{signal.field.text} on {self.topic.name} is '{first}' first, and {listed} of {self.count} messages"
        why = "several publishers, or an order that changes"
        if count >= RecordingLimits.CONTRADICTED_SHARE * self.count:
            remedy = f"take it by name: {first}" if _is_by_name(first) else "record one publisher, whose order stays"
            raise RecordingError(f"{self.decoder.where}: {signal.name}: {text} ({why}); {remedy}")
        warnings.warn(f"{signal.name}: {text} ({why}); these are left out", RecordingWarning, stacklevel=2)

    def _require_field(self, i: int, signal: Signal, count: int) -> None:
        """Raise SignalsError if no message has the field; warn if some have not."""
        reason = self.decoder.reasons[i]
        if self.count and not count:
            reason = re.sub(r"\b(\w+)__msg__(\w+)\b", r"\1/msg/\2", reason)  # as ROS 2 does
            reason = reason.replace("a ndarray", "an array")
            first = self.decoder.typestore.deserialize_cdr(self.first, self.topic.type)
            has = format_fields(first, self.topic.type, self.decoder.typestore)
            raise SignalsError(f"{self.decoder.where}: signal '{signal.name}': {reason}; {has}")
        if count + self.decoder.others[i].total() < self.count:
            missing = f"missing in {self.count - count} of {self.count} messages on {self.topic.name}"
            warnings.warn(f"{signal.name}: {missing}: {reason}", RecordingWarning, stacklevel=2)


def _is_by_name(text: str) -> bool:
    """Return whether a field path takes its elements by name: not all that messages may call them can be in one."""
    with suppress(SignalsError):
        return not any(isinstance(element, int) for _, element in FieldPath.parse(text).steps)
    return False


def is_interleaved(values: Values) -> bool:
    """Return whether each value is nearer to the last but one than to the last, in the median: two series in turn.

    Of a smooth series it is twice as far away, of noise as far.
    """
    if len(values) < StatisticLimits.ENOUGH:
        return False
    last, last_but_one = (float(np.nanmedian(np.abs(values[n:] - values[:-n]))) for n in (1, 2))
    return last_but_one < RecordingLimits.INTERLEAVED * last


@dataclass(frozen=True)
class LateSamples:
    """How many samples of how many were stored after later ones, and by how much at most [ns]."""

    count: int
    total: int
    max_late_ns: int

    def __str__(self) -> str:
        return f"{self.count} of {self.total} samples by at most {self.max_late_ns * 1e-6:.3f} ms"


def sort_late_samples(channel: Channel) -> tuple[Channel, LateSamples | None]:
    """Return the channel sorted stably by stamp and what was late; as it is and None if in order or time ran back."""
    stamps = channel.stamps_ns
    if not (stamps[1:] < stamps[:-1]).any():
        return channel, None
    latest = np.maximum.accumulate(stamps)
    late_ns = latest - stamps
    if late_ns.max() > OrderLimits.MAX_LATE_NS:
        return channel, None
    order = np.argsort(stamps, kind="stable")
    if _comes_twice(stamps, latest, stamps[order]):
        return channel, None
    lateness = LateSamples(int((late_ns > 0).sum()), len(stamps), int(late_ns.max()))
    return replace(channel, stamps_ns=stamps[order], values=channel.values[order]), lateness


def _comes_twice(stamps: Stamps, latest: Stamps, ordered: Stamps) -> bool:
    """Return whether a run of late samples repeats time that was recorded before, as after a jump of the clock."""
    late = np.flatnonzero(stamps < latest)
    starts = np.flatnonzero(np.diff(late, prepend=-2) > 1)
    lengths = np.diff(starts, append=len(late))
    stored_before = np.minimum.accumulate(stamps)[late[starts] - 1]
    first, last = np.maximum(np.minimum.reduceat(stamps[late], starts), stored_before), latest[late[starts]]
    inside = _count(ordered, first, last)
    before, after = (
        np.maximum(first - OrderLimits.AROUND_NS, ordered[0]),
        np.minimum(last + OrderLimits.AROUND_NS, ordered[-1]),
    )
    outside_ns = (first - before) + (after - last)
    expected = (last - first) * (_count(ordered, before, after) - inside) / np.maximum(outside_ns, 1)
    excess = inside - 1 > OrderLimits.MAX_DENSITY * expected + 1
    return bool((excess & (lengths >= OrderLimits.MIN_RUN) & (expected >= OrderLimits.MIN_RUN - 1)).any())


def _count(ordered: Stamps, first: Stamps, last: Stamps) -> Stamps:
    """Return the number of samples from each `first` to each `last`, both included."""
    return np.searchsorted(ordered, last, side="right") - np.searchsorted(ordered, first, side="left")
