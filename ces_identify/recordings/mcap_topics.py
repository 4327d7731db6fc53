"""The topics of an MCAP file without a summary, found by reading its schemas and channels wherever they are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from ces_identify.recordings.bulk_decode import Index
from ces_identify.recordings.mcap_records import MESSAGE_HEADER, PREFIX, record_buffers, split_messages
from ces_identify.recordings.stored_topic import StoredTopic, make_definition


def list_topics(path: Path) -> tuple[StoredTopic, ...]:
    """Return the topics of a file up to its last whole record; raises RecordingError if it is damaged."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    counts: Counter[int] = Counter()
    for records in record_buffers(path, interrupted=True):
        messages, _ = split_messages(np.frombuffer(records, dtype=np.uint8))
        counts.update(messages[:, 0].tolist())
        for opcode, stream in _other_records(records, messages):
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                channels[channel.id] = channel
    return tuple(_stored_topic(channel, schemas.get(channel.schema_id), counts[i]) for i, channel in channels.items())


def _other_records(records: bytes, messages: Index) -> Iterator[tuple[int, ReadDataStream]]:
    """Yield opcode and content of each record between the messages."""
    begins = messages[:, 2] - MESSAGE_HEADER - PREFIX
    ends = messages[:, 2] + messages[:, 3]
    free_from, free_to = np.append(0, ends), np.append(begins, len(records))
    for i in np.flatnonzero(free_to > free_from):
        position = int(free_from[i])
        while position < free_to[i]:
            length = int.from_bytes(records[position + 1 : position + PREFIX], "little")
            start = position + PREFIX
            yield records[position], ReadDataStream(BytesIO(records[start : start + length]))
            position = start + length


def _stored_topic(channel: Channel, schema: Schema | None, count: int) -> StoredTopic:
    name = schema.name if schema else ""
    definition = make_definition(schema.encoding, schema.data.decode()) if schema else make_definition("", "")
    return StoredTopic(channel.id, channel.topic, name, definition, channel.message_encoding, count)
