"""A topic as a data file or a bag's metadata has it."""

from __future__ import annotations

from dataclasses import dataclass

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

FORMATS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
}


@dataclass(frozen=True)
class StoredTopic:
    """A topic in a data file or in the bag's metadata: its number there, definition, encoding, number of messages."""

    id: int
    name: str
    type: str
    definition: MessageDefinition
    encoding: str
    count: int


def make_definition(kind: str, text: str) -> MessageDefinition:
    """Return the definition of a message in the format that storage files call `kind`; an unknown one is none."""
    return MessageDefinition(FORMATS.get(kind, MessageDefinitionFormat.NONE), text)
