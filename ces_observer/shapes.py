"""Shapes of values that are no records: values by name, and plain values that a mapping may replace."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ces_observer.fields import Field, FieldError, Schema, ValueShape, missing, read_part
from ces_observer.json_text import quote


@dataclass(frozen=True, eq=False)
class ByName(ValueShape):
    """Values by name, each as `item` says: only those in `names`, if there are any, and all that are `needed`."""

    item: Field
    names: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()
    pattern: str = ""  # of any name

    def keys(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        """Return its keys in the mapping that it is in."""
        return self.names

    def read(self, value: Any, base: Any = None, complete: bool = False) -> dict[str, Any]:
        """Return the values by name; raises FieldError."""
        for name in value:
            if self.names and name not in self.names:
                raise FieldError(f": unknown key {quote(name)}; known are {', '.join(self.names)}")
            if self.pattern and not re.fullmatch(self.pattern, str(name)):
                raise FieldError(f": name {quote(name)}; expected one that matches {self.pattern}")
        for name in self.needed:
            if name not in value:
                raise missing(name, self.item)
        names = [name for name in self.names if name in value] if self.names else value
        return {str(name): read_part(str(name), self.item, value[name], None, complete) for name in names}

    def write(self, value: Any) -> Any:
        """Return the values by name."""
        return {name: self.item.write(one) for name, one in value.items()}

    @property
    def schema(self) -> Schema:
        """The JSON Schema of a mapping."""
        if not self.names:
            names = {"propertyNames": {"pattern": f"^{self.pattern}$"}} if self.pattern else {}
            return {"type": "object", "additionalProperties": self.item.schema, **names}
        properties = dict.fromkeys(self.names, self.item.schema)
        return {"type": "object", "properties": properties, "required": list(self.needed)}


@dataclass(frozen=True, eq=False)
class Either(ValueShape):
    """A `plain` value, or the mapping `shape`."""

    plain: Field
    shape: ValueShape

    @property
    def expected(self) -> str:  # type: ignore[override]  # of other shapes, it is always the same
        """A phrase for both."""
        return f"{self.plain.expected}, or {self.shape.expected}"

    def accepts(self, value: Any) -> bool:
        """Return whether it is one of both."""
        return isinstance(value, Mapping) or self.plain.takes(value)

    def read(self, value: Any, base: Any = None, complete: bool = False) -> Any:
        """Return the value, or what the mapping stands for; raises FieldError."""
        chosen = self.shape if isinstance(value, Mapping) else self.plain
        return chosen.read(value, base, complete)

    def write(self, value: Any) -> Any:
        """Return the value as a file has it."""
        return (self.plain if self.plain.takes(value) else self.shape).write(value)

    @property
    def schema(self) -> Schema:
        """The JSON Schema of both."""
        return {"anyOf": [self.plain.bare_schema, self.shape.schema]}
