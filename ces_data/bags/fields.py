"""Every number in every topic of a bag, for programs that do not know yet which of them are signals.

A bag goes in; the series of each numeric field comes out, in the spelling of ROS 2 (`wrench.force.z`,
`position[rear_damper]`), with array elements by joint name where the message names its joints. Topics that hold no
signal of a damper (images, point clouds, logs, transforms) are passed over.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from ces_data.bags.clocks import compare_clocks, find_shift
from ces_data.bags.decode import DAMAGED, HEADER, Block, MessageDecoder, TopicSamples, undecodable
from ces_data.bags.storage import Bag, Topic, open_bag
from ces_data.recording import Stamps, Values
from ces_observer.errors import CesError, RecordingError
from ces_observer.signals import NAMES_BESIDE, FieldPath, names_beside

MAX_FIELDS = 64  # of one topic
MAX_ELEMENTS = 32  # of one array
MAX_SAMPLES = 200_000  # of one topic: 200 s at 1 kHz
MAX_MESSAGE = 20_000  # bytes; a larger message is an image or the like
MAX_FIRST = 8  # messages, and messages of different lengths, that say which numbers a topic has
MAX_LISTED = 20  # fields in an error
PASSED_OVER = (
    "rcl_interfaces/", "tf2_msgs/", "diagnostic_msgs/", "rosgraph_msgs/", "visualization_msgs/", "nav_msgs/msg/Path",
    "nav_msgs/msg/OccupancyGrid", "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/PointCloud", "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/CameraInfo",
)  # fmt: skip
JOINT = re.compile(r"(?!\s*\Z)(?!\d+\Z)[^\[\].]+")  # names that a field path can hold
NUMBERS = {"float32", "float64", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}


@dataclass(frozen=True)
class FieldSeries:
    """The numbers at one field of a topic: `stamps_ns` int64 and `values` float64, both (n,), as `read_recording`.

    `element` is what the messages call an element that the field takes by index.
    """

    topic: str
    type: str
    field: str
    stamps_ns: Stamps
    values: Values
    element: str = ""


@dataclass(frozen=True)
class BagFields:
    """All series of a bag, the number of messages of each topic, and why topics were not read."""

    series: tuple[FieldSeries, ...]
    topics: tuple[Topic, ...]
    skipped: Mapping[str, str]


def read_fields(path: Path) -> BagFields:
    """Read the numbers of every topic, up to 200,000 messages of each; raises RecordingError if the bag is damaged."""
    with open_bag(path) as bag:
        topics = {topic.name: topic for topic in bag.topics}
        passed = {name for name, topic in topics.items() if topic.type.startswith(PASSED_OVER) or not topic.count}
        skipped = {n: "not a sensor's type" if t.count else "no messages" for n, t in topics.items() if n in passed}
        samples: dict[str, TopicSamples] = {}
        for name, block in bag.blocks([name for name in topics if name not in skipped]):
            if name not in samples and name not in skipped:
                decoder = _make_decoder(bag, topics[name], block)
                if isinstance(decoder, str):
                    skipped[name] = decoder
                else:
                    samples[name] = TopicSamples(decoder)
            if name in samples and samples[name].count < MAX_SAMPLES:
                samples[name].add(block)
            if len(samples) + len(skipped) == len(topics) and all(s.count >= MAX_SAMPLES for s in samples.values()):
                break
        shift_ns = _shift_of(samples)
        skipped |= {f"{name} {field}": why for name in samples for field, why in samples[name].decoder.mixed()}
        series = tuple(one for name in samples for one in _list_series(topics[name], samples[name], shift_ns))
        return BagFields(series, bag.topics, skipped)


def format_fields(message: object, typename: str, typestore: Typestore) -> str:
    """Return the field paths of a message's numbers as text, of arrays without joint names the first element's."""
    paths = list(list_numbers(message, typename, typestore, max_elements=1))
    more = [f"{len(paths) - MAX_LISTED} more"] if len(paths) > MAX_LISTED else []
    return f"{typename} has {', '.join(paths[:MAX_LISTED] + more) or 'no numbers'}"


def list_numbers(
    message: Any, typename: str, typestore: Typestore, max_elements: int = MAX_ELEMENTS, before: str = ""
) -> Iterator[str]:
    """Yield the paths of a message's numbers, not headers'; elements by joint names, else `max_elements` indices."""
    fields = typestore.get_msgdef(typename).fields
    joints = names_beside(message)
    for name, description in fields:
        if description == HEADER or name in ("layout", *NAMES_BESIDE):
            continue
        values, elements, of = [getattr(message, name)], [f"{before}{name}"], description
        if description[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            values, of = values[0], description[1][0]
            named = len(joints) == len(values) and all(map(JOINT.fullmatch, joints))
            keys = joints[:MAX_ELEMENTS] if named else range(min(len(values), max_elements))
            elements = [f"{before}{name}[{key}]" for key in keys]
        for value, element in zip(values, elements, strict=False):
            if of[0] == Nodetype.NAME:
                yield from list_numbers(value, str(of[1]), typestore, max_elements, f"{element}.")
            elif of[1][0] in NUMBERS:
                yield element


def _make_decoder(bag: Bag, topic: Topic, block: Block) -> MessageDecoder | str:
    """Return the decoder of the first 64 numbers in a topic's first messages, or why the topic is passed over."""
    if int(block.lengths[0]) > MAX_MESSAGE:
        return f"messages of {int(block.lengths[0])} bytes"
    where = f"{bag.path}: topic {topic.name}"
    try:
        typestore = bag.typestore(topic)
        lengths = np.unique(block.lengths, return_index=True)[1].tolist()  # publishers may name other joints
        first = dict.fromkeys((*range(min(MAX_FIRST, len(block))), *lengths[:MAX_FIRST]))
        messages = [typestore.deserialize_cdr(block.payload(i), topic.type) for i in first]
        numbers = dict.fromkeys(text for message in messages for text in list_numbers(message, topic.type, typestore))
        paths = [FieldPath.parse(text) for text in islice(numbers, MAX_FIELDS)]
    except CesError as error:
        return str(error).removeprefix(f"{bag.path}: ")
    except DAMAGED as error:
        raise undecodable(where, topic.type, error) from None
    return MessageDecoder(topic.type, paths, typestore, where) if paths else "no numbers"


def _shift_of(samples: Mapping[str, TopicSamples]) -> int:
    """Return by how much log times are moved back to the headers' clock [ns], 0 where a reader would refuse."""
    joined = {name: own.join()[:2] for name, own in samples.items() if own.count}
    clocks = [clock for name, stamps in joined.items() if (clock := compare_clocks(name, *stamps))]
    with suppress(RecordingError):
        return find_shift(clocks, [name for name, (header_ns, _) in joined.items() if not header_ns.any()], "")[0]
    return 0


def _list_series(topic: Topic, samples: TopicSamples, shift_ns: int = 0) -> Iterator[FieldSeries]:
    """Yield the series of each field that some message has, log times moved back by `shift_ns`."""
    if not samples.count:
        return
    header_ns, log_ns, values, _ = samples.join()
    stamps = header_ns if header_ns.any() else log_ns - shift_ns
    mixed = dict(samples.decoder.mixed())
    for path, numbers, element in zip(samples.decoder.fields, values.T, samples.decoder.names, strict=True):
        present = np.isfinite(numbers)
        if present.any() and path.text not in mixed:
            yield FieldSeries(topic.name, topic.type, path.text, stamps[present], numbers[present], element)
