"""Bags into recordings: finds the signals' topics, reads their numbers, and scales them to SI units.

Stamps come from the message's header if its type has one; otherwise, or if the header was never filled in, from the
time at which the bag logged the message.
"""

from __future__ import annotations

import struct
import warnings
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from ces_identify.recordings.bag_field_names import format_fields, spell_as_ros
from ces_identify.recordings.bag_layout import describe_layout
from ces_identify.recordings.bag_opening import open_bag
from ces_identify.recordings.bag_storage import Bag, Topic
from ces_identify.recordings.bulk_decode import Block, BulkDecoder, Floats, Index
from ces_identify.recordings.recording import Channel, Recording
from ces_identify.recordings.stamp_order import LateSamples, sort_late_samples
from ces_observer.errors import RecordingError, SignalsError
from ces_observer.signals import Constant, FieldPath, Signal, Signals

HEADER = (Nodetype.NAME, "std_msgs/msg/Header")
STAMP = (FieldPath.parse("header.stamp.sec"), FieldPath.parse("header.stamp.nanosec"))
INPUTS = ("position", "current")
MAX_TOPICS_LISTED = 20
DAMAGED = (SerdeError, struct.error, ValueError, IndexError, AssertionError)  # rosbags before 0.11.9 raises others
T = TypeVar("T")
Kind = TypeVar("Kind", bound=np.generic)


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
    or if no message has a field. Issues a LogTimeWarning for each signal stamped with log times (those in bags of
    `bag_writer` are exact), and a RecordingWarning for samples that were stored late and are sorted in, and for a
    recorder that was killed.
    """
    with open_bag(path) as bag:
        if bag.warning:
            warnings.warn(bag.warning, RecordingWarning, stacklevel=2)
        if not any(topic.count for topic in bag.topics):
            raise RecordingError(
                f"{path}: the bag holds no messages; expected a recording of {', '.join(need) or 'signals'}"
            )
        readers = _readers(bag, signals, need)
        for name, block in bag.blocks(readers):
            readers[name].add(block)
        by_name = {name: channel for reader in readers.values() for name, channel in reader.channels().items()}
        digest = bag.sha256()
    channels = _sort_channels({name: by_name[name] for name in signals.by_name if name in by_name})
    constants = {s.name: s.value for s in signals.by_name.values() if isinstance(s, Constant)}
    return Recording(path.name if path.is_dir() else path.stem, channels, constants, str(path), digest)


def _sort_channels(channels: dict[str, Channel]) -> dict[str, Channel]:
    """Return the channels with late samples sorted in; one warning says how many, and by how much they were late."""
    results = {name: sort_late_samples(channel) for name, channel in channels.items()}
    texts = [f"{name} {_format_late(late)}" for name, (_, late) in results.items() if late]
    if texts:
        text = f"stored after later samples, and sorted by stamp: {', '.join(texts)}"
        warnings.warn(text, RecordingWarning, stacklevel=3)
    return {name: channel for name, (channel, _) in results.items()}


def _format_late(late: LateSamples) -> str:
    return f"{late.count} of {late.total} samples by at most {late.max_late_ns * 1e-6:.3f} ms"


def _readers(bag: Bag, signals: Signals, need: Collection[str]) -> dict[str, _TopicReader]:
    """Return a reader for each topic that carries a signal, by the topic's name."""
    by_topic: dict[Topic, list[Signal]] = {}
    for signal in signals.list_topic_signals():
        topic = _topic(bag, signal, signals, signal.name in need)
        if topic is not None:
            by_topic.setdefault(topic, []).append(signal)
    return {topic.name: _TopicReader(bag, topic, mine) for topic, mine in by_topic.items()}


def _topic(bag: Bag, signal: Signal, signals: Signals, needed: bool) -> Topic | None:
    """Return the topic of a signal; None if it is not in the bag and not `needed`."""
    topics = [topic for topic in bag.topics if signal.matches(topic.name)]
    if not topics and not needed:
        return None
    if not topics:
        raise RecordingError(
            f"{bag.path}: no topic '{signal.topic}' for {signal.name}; the bag has {_format_topics(bag.topics)}; "
            f"{_advice(bag.path, signal, signals)}"
        )
    for topic in topics:
        if topic.type == signal.type:
            return topic
    raise SignalsError(
        f"{signals.source}: signal '{signal.name}': topic '{signal.topic}' is {topics[0].type} in {bag.path}, not"
        f" {signal.type}; correct type and field, or: {_advice(bag.path, signal, signals)}"
    )


def _advice(path: Path, signal: Signal, signals: Signals) -> str:
    """Return what to do about a topic that is not found: complete the signals file, or let a program propose one."""
    if signal.name in signals.assumed and len(signals.assumed) < len(signals.by_name):
        return (
            f"{signals.source} has no key '{signal.name}', so its default was looked for: add it, with topic, type and "
            "field"
        )
    return f"'ces signals {path} --out my_signals.yaml' proposes a file for --signals"


def _format_topics(topics: tuple[Topic, ...]) -> str:
    shown = [f"{topic.name} ({topic.type})" for topic in topics[:MAX_TOPICS_LISTED]]
    more = [f"{len(topics) - MAX_TOPICS_LISTED} more"] if len(topics) > MAX_TOPICS_LISTED else []
    return ", ".join(shown + more) or "none"


class _TopicReader:
    """Collects the samples of all signals in one topic, block by block."""

    def __init__(self, bag: Bag, topic: Topic, signals: list[Signal]) -> None:
        self.typestore = typestore = bag.typestore(topic)
        self.first = b""
        fields = dict(typestore.get_msgdef(topic.type).fields)
        self.stamp = STAMP if fields.get("header") == HEADER else ()
        paths = (*self.stamp, *(signal.field for signal in signals))
        where = f"{bag.path}: topic {topic.name}"
        self.decoder = make_decoder(topic.type, paths, typestore, where)
        self.where, self.topic, self.signals = where, topic, signals
        self.exact_log_times = bag.exact_log_times
        self.samples = {signal.name: _Samples() for signal in signals}

    def add(self, block: Block) -> None:
        """Decode a block of this topic's messages."""
        self.first = self.first or block.payload(0)
        values, present = self.decoder.decode(block)
        header_ns = np.zeros(len(block), dtype=np.int64)
        if self.stamp:
            header_ns += values[:, 0].astype(np.int64) * 1_000_000_000 + values[:, 1].astype(np.int64)
        for i, signal in enumerate(self.signals, start=len(self.stamp)):
            rows = present[:, i]
            numbers = signal.scale * values[rows, i] + signal.offset
            self.samples[signal.name].add(header_ns[rows], block.log_ns[rows], numbers, len(block))

    def channels(self) -> dict[str, Channel]:
        """Return the channels by signal; raises SignalsError if no message has a field."""
        return {signal.name: self._channel(i, signal) for i, signal in enumerate(self.signals, start=len(self.stamp))}

    def _channel(self, i: int, signal: Signal) -> Channel:
        samples = self.samples[signal.name]
        count = sum(map(len, samples.values))
        if samples.messages and not count:
            reason = spell_as_ros(str(self.decoder.reasons[i]))
            raise SignalsError(f"{self.where}: signal '{signal.name}': {reason}; {self._format_fields()}")
        if count < samples.messages:
            missing = f"missing in {samples.messages - count} of {samples.messages} messages on {self.topic.name}"
            warnings.warn(f"{signal.name}: {missing}: {self.decoder.reasons[i]}", RecordingWarning, stacklevel=2)
        if count and not samples.stamped and not self.exact_log_times:
            reason = "an empty header stamp" if self.stamp else "no header"
            text = f"{self.topic.type} on {self.topic.name} has {reason}; stamped with the bag's log time"
            warnings.warn(f"{signal.name}: {text}", LogTimeWarning, stacklevel=2)
        stamps_ns = samples.stamps() - signal.delay_ns
        return Channel(signal.name, signal.unit, stamps_ns, _concatenate(samples.values, np.float64))

    def _format_fields(self) -> str:
        """Return the fields that the first message has."""
        return format_fields(
            self.typestore.deserialize_cdr(self.first, self.topic.type), self.topic.type, self.typestore
        )


class _Samples:
    """Growing columns of one signal; log times are dropped at the first nonzero header stamp."""

    def __init__(self) -> None:
        self.messages = 0
        self.stamped = False
        self.header_ns: list[Index] = []
        self.log_ns: list[Index] = []
        self.values: list[Floats] = []

    def add(self, header_ns: Index, log_ns: Index, values: Floats, messages: int) -> None:
        self.messages += messages
        self.stamped = self.stamped or bool(header_ns.any())
        if self.stamped:
            self.log_ns.clear()
        else:
            self.log_ns.append(log_ns)
        self.header_ns.append(header_ns)
        self.values.append(values)

    def stamps(self) -> Index:
        return _concatenate(self.header_ns if self.stamped else self.log_ns, np.int64)


def make_decoder(kind: str, paths: tuple[FieldPath, ...], typestore: Typestore, where: str) -> BulkDecoder:
    """Return the decoder of the numbers at `paths`; its errors are RecordingErrors that begin with `where`."""

    def read_one(raw: bytes) -> list[float | str]:
        message = typestore.deserialize_cdr(raw, kind)
        return [_read(path, message) for path in paths]

    def wrap_errors(read: Callable[[bytes], T]) -> Callable[[bytes], T]:
        def read_or_raise(raw: bytes) -> T:
            try:
                return read(raw)
            except DAMAGED as error:
                raise RecordingError(f"{where}: a message cannot be decoded as {kind}: {error}") from None

        return read_or_raise

    describe = partial(describe_layout, typename=kind, paths=paths, typestore=typestore)
    return BulkDecoder(len(paths), wrap_errors(describe), wrap_errors(read_one))


def _read(path: FieldPath, message: object) -> float | str:
    try:
        return path.read(message)
    except SignalsError as error:
        return str(error)


def _concatenate(parts: list[NDArray[Kind]], kind: type[Kind]) -> NDArray[Kind]:
    return np.concatenate(parts) if parts else np.empty(0, dtype=kind)
