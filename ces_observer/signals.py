"""The signals file: it maps each signal to its topic, message type and field.

A nested mapping, from a node's parameters or a YAML file, goes in; `Signals` come out. Node and offline programs share
it, so both read the same number from the same message.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ces_observer.errors import SignalsError
from ces_observer.fields import REQUIRED, Field, require_known_keys
from ces_observer.json_text import quote
from ces_observer.limits import NumberLimits
from ces_observer.records import bounded, part, read_record, record_fields

NAMES = ("position", "current", "force", "sim_force", "temperature", "speed", "acceleration")
MOTIONS = ("speed", "acceleration")  # what may be measured beside the position, so that the speed is better known
UNITS = {
    "position": "m",
    "current": "A",
    "force": "N",
    "sim_force": "N",
    "temperature": "degC",
    "speed": "m/s",
    "acceleration": "m/s2",
}
DEFAULTS: dict[str, dict[str, Any]] = {
    "position": {"topic": "joint_states", "type": "sensor_msgs/msg/JointState", "field": "position[rear_damper]"},
    "current": {"topic": "valve_current", "type": "std_msgs/msg/Float64", "field": "data"},
    "force": {"topic": "measured_force", "type": "geometry_msgs/msg/WrenchStamped", "field": "wrench.force.z"},
}

NAMES_BESIDE = ("name", "joint_names", "interface_groups", "interface_names")  # arrays that name the others' elements
LONGEST = 255  # characters of a topic, type or field path
MAX_DELAY_S = 1.0  # either way
_STEP = re.compile(r"([A-Za-z]\w*)(?:\[ *([^\[\] ][^\[\]]*)\])?\Z", re.ASCII)
_INDEX = re.compile(r"[0-9]{1,9}", re.ASCII)
_TYPE = re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*\Z", re.ASCII)
_SOURCE = ("topic", "type", "field")
_SCALED = "value in SI units = scale * number + offset"


def _require_printable(text: str) -> None:
    if len(text) > LONGEST or not text.isprintable():
        raise ValueError(f"found {quote(text)}; expected at most {LONGEST} printable characters")


def _require_type(text: str) -> None:
    _require_printable(text)
    if not _TYPE.match(text):
        raise ValueError(f"'{text}' is not of the form package/msg/Type")


def _source(meaning: str, check_text: Callable[[str], object] = _require_printable, **settings: Any) -> Any:
    """Declare where a signal is found."""
    return part(meaning=meaning, check_text=check_text, remedy="set topic, type and field", **settings)


def _number(default: Any, meaning: str, **settings: Any) -> Any:
    """Declare a number of a signal: one beyond any unit is a mistake."""
    largest = NumberLimits.MAX_COEFFICIENT
    return bounded(-largest, largest, meaning, default, **settings)


@dataclass(frozen=True)
class FieldPath:
    """Path to one number in a message, such as `wrench.force.z`, `position[2]`, `position[rear_damper]` or
    `interface_values[rear_damper].values[effort]`.
    """

    text: str
    steps: tuple[tuple[str, int | str | None], ...]

    @classmethod
    def parse(cls, text: str) -> FieldPath:
        """Parse dotted field names, each with an optional [index or joint name]; raises SignalsError."""
        steps: list[tuple[str, int | str | None]] = []
        for step in str(text).split("."):
            match = _STEP.match(step.strip())
            if match is None:
                raise SignalsError(
                    f"field path {quote(text)}: {quote(step)} is not a field name with an optional [index] or "
                    "[joint name]"
                )
            name, element = match.group(1), match.group(2)
            element = element.strip() if element else None
            steps.append((name, int(element) if element and _INDEX.fullmatch(element) else element))
        return cls(str(text), tuple(steps))

    def named(self, spelt: Sequence[str]) -> str:
        """Return the path of steps that may have names in place of indices; '' if they have none."""
        own = [name if element is None else f"{name}[{element}]" for name, element in self.steps]
        return "" if spelt == own else ".".join(spelt)

    def read(self, message: object) -> float:
        """Return the number at this path of `message`; raises SignalsError naming the missing part."""
        return self.read_named(message)[0]

    def read_named(self, message: object) -> tuple[float, str]:
        """Return the number, and the path with names in place of indices, as `named` does; raises SignalsError."""
        value: Any = message
        spelt: list[str] = []
        for name, element in self.steps:
            parent, value, at = value, getattr(value, name, None), name
            if value is None:
                raise SignalsError(f"field '{self.text}': no '{name}' in {type(parent).__name__}")
            if element is not None:
                names = names_beside(parent)
                index = self._index(names, value, element)
                value, at = value[index], f"{name}[{(names[index] if index < len(names) else '') or element}]"
            spelt.append(at)
        try:
            return float(value), self.named(spelt)
        except (TypeError, ValueError):
            raise SignalsError(f"field '{self.text}' is a {type(value).__name__}, not a number") from None

    def _index(self, names: Sequence[str], array: Any, element: int | str) -> int:
        if not hasattr(array, "__len__"):
            raise SignalsError(f"field '{self.text}': a {type(array).__name__} is no array; remove [{element}]")
        if isinstance(element, str):
            if element not in names:
                raise SignalsError(f"field '{self.text}': no joint '{element}'; the message has {names or 'no names'}")
            element = names.index(element)
        if element >= len(array):
            raise SignalsError(f"field '{self.text}': index {element} is outside an array of {len(array)}")
        return element


def names_beside(message: object) -> list[str]:
    """Return what a message calls the elements of its arrays, such as joints; empty without names."""
    listed = (getattr(message, key, None) for key in NAMES_BESIDE)
    return next(
        (list(names) for names in listed if names is not None and len(names) and not isinstance(names, str)), []
    )


class ElementNames:
    """What messages call the elements that a field takes by index: the first message that names them decides."""

    def __init__(self, path: FieldPath) -> None:
        self._text, self._first = path.text, ""

    def require(self, by_names: str) -> None:
        """Raise SignalsError if a message, whose path is `by_names`, has another element there than the first one."""
        self._first = self._first or by_names
        if by_names and by_names != self._first:
            text = f"is {self._first} in the first message and {by_names} in another; take it by name"
            raise SignalsError(f"field '{self._text}' {text}")


@dataclass(frozen=True)
class Signal:
    """One signal in a topic; its value in SI units is `scale * number + offset`.

    `delay` [s] is how much later than it was measured a number is stamped; readers move the stamps back by it.
    """

    name: str
    topic: str = _source("topic; a relative name is resolved in the node's namespace")
    type: str = _source(
        "message type, such as sensor_msgs/msg/JointState",
        _require_type,
        rules={"pattern": r"^[A-Za-z]\w*/msg/[A-Za-z]\w*$"},
    )
    field: FieldPath = _source(
        "path to the number in the message, as data, wrench.force.z or position[rear_damper]", make=FieldPath.parse
    )
    scale: float = _number(1.0, _SCALED, rules={"not": {"const": 0}})
    offset: float = _number(0.0, _SCALED)
    delay: float = bounded(
        -MAX_DELAY_S,
        MAX_DELAY_S,
        "[s] by how much later than measured the numbers are stamped; stamps are moved back by it",
        0.0,
    )

    def checked(self) -> Signal:
        """Return the signal; raises SignalsError if all its values are 0."""
        if self.scale == 0.0:
            raise SignalsError("scale is 0; expected the factor from the logged unit to SI")
        return self

    @property
    def delay_ns(self) -> int:
        """The delay in nanoseconds."""
        return round(self.delay * 1e9)

    @property
    def unit(self) -> str:
        """Unit of the scaled value."""
        return UNITS[self.name]

    def matches(self, topic: str) -> bool:
        """True if `topic` (fully resolved) is this signal's topic; a relative name resolves in the root namespace."""
        return topic.lstrip("/") == self.topic.lstrip("/")

    def make_reader(self) -> Callable[[object], float]:
        """Return a function message -> SI value, which raises SignalsError as `FieldPath` and `ElementNames` do."""
        names = ElementNames(self.field)

        def read_value(message: object) -> float:
            number, by_names = self.field.read_named(message)
            names.require(by_names)
            return self.scale * number + self.offset

        return read_value


@dataclass(frozen=True)
class Constant:
    """A signal with a known constant value, such as the current of a passive damper (0 A)."""

    name: str
    value: float = _number(REQUIRED, "known value in SI units instead of a topic", key="constant")


FIELDS: Mapping[str, Field] = {  # of a signal in a file, by their keys there
    one.key: replace(one, name=one.key)
    for one in (*record_fields(Signal).values(), *record_fields(Constant).values())
    if one.name != "name"
}
NUMBERS = {name: one.default for name, one in FIELDS.items() if one.default is not REQUIRED}


@dataclass(frozen=True)
class Signals:
    """All signals by name; `position` and `current` are always present.

    `assumed` are those that the source does not describe, which have their defaults.
    """

    by_name: Mapping[str, Signal | Constant]
    source: str = "defaults"
    assumed: frozenset[str] = field(default=frozenset(), compare=False)

    def __getitem__(self, name: str) -> Signal | Constant:
        """Return the signal `name`; raises SignalsError if it is missing."""
        if name not in self.by_name:
            raise SignalsError(f"{self.source}: no signal '{name}'; known are {', '.join(self.by_name)}")
        return self.by_name[name]

    def list_topic_signals(self) -> tuple[Signal, ...]:
        """Return the signals that are read from topics."""
        return tuple(s for s in self.by_name.values() if isinstance(s, Signal))

    def without_delays(self) -> Signals:
        """Return the signals with stamps as they are."""
        kept = {n: replace(s, delay=0.0) if isinstance(s, Signal) else s for n, s in self.by_name.items()}
        return replace(self, by_name=kept)

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], source: str) -> Signals:
        """Build from `{signal: {topic, type, field, scale, offset, delay} | {constant}}`; defaults for missing keys.

        Other keys are ignored: they are a node's other parameters. Raises SignalsError.
        """
        names = [name for name in NAMES if name in mapping or name in DEFAULTS]
        signals = {name: _signal(name, mapping.get(name, {}), source) for name in names}
        return cls(signals, source, frozenset(names) - mapping.keys())


def override(common: Any, own: Any) -> Any:
    """Return one damper's signal: the `common` settings of all dampers, overridden by its `own`.

    A topic of its own replaces a common constant, and a constant of its own a common topic.
    """
    if not isinstance(common, Mapping) or not isinstance(own, Mapping):
        return common if own is None else own
    if "constant" in common and "constant" not in own and not own.keys().isdisjoint(_SOURCE):
        common = {key: value for key, value in common.items() if key != "constant"}
    return {**common, **own}


def _signal(name: str, description: object, source: str) -> Signal | Constant:
    where = f"{source}: signal '{name}'"
    if not isinstance(description, Mapping):
        raise SignalsError(
            f"{where} is {quote(description)}; expected a mapping with topic, type and field, or constant"
        )
    require_known_keys(description, FIELDS, where, SignalsError)
    if "constant" in description:
        values = {"name": name, "constant": description["constant"]}
        return read_record(Constant, values, where, SignalsError)
    values = {**DEFAULTS.get(name, {}), **description}
    given = {key: value for key, value in values.items() if value or key not in _SOURCE}
    return read_record(Signal, {**given, "name": name}, where, SignalsError)
