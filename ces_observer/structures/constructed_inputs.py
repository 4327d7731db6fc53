"""Constructed inputs: signals computed at each tick from position, speed and current, and used in terms like these.

Here are their definitions; `ces_observer.tick.constructed` computes them, and has their equations. The `stop` is the
stroke since the last reversal, on which compliance and presliding friction depend; the `play` is the rest of its
signal. A `lag` is like that of coil and pilot valve between current and force. Memberships (`hat`) over the same
breakpoints add up to one, so that terms times memberships are sub-models blended over a signal. All are computed from
inputs clamped to the model's envelope, so their ranges are certain.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import exp
from typing import Any

from ces_observer.errors import ModelError
from ces_observer.flat import Layout
from ces_observer.json_text import JsonObject
from ces_observer.proof.intervals import Interval, down, up
from ces_observer.structures.structure import Range, Ranges
from ces_observer.tick import constructed as tick

BASE = ("position", "speed", "current")


class _Definition:
    """What the definitions of constructed inputs, all dataclasses, have in common; not all have each of its fields."""

    name: str
    kind: str
    of: str
    time_constant_s: float

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals from which it is computed."""
        return (self.of,)

    def gain(self, rate_Hz: float) -> float:
        """Return the weight of a new tick in an exponential window of `time_constant_s`."""
        return 1.0 - exp(-1.0 / (self.time_constant_s * rate_Hz))

    def to_json(self) -> dict[str, Any]:
        """Return the definition as in a model file."""
        settings = {key: value for key, value in asdict(self).items() if key != "base"}  # type: ignore[call-overload]
        return {"name": self.name, "kind": self.kind, **settings}


@dataclass(frozen=True)
class Hysteresis(_Definition):
    """The `stop` or `play` of the signal `of` with `half_width` in its unit (m, m/s or A)."""

    name: str
    kind: str
    of: str
    half_width: float

    def range(self, ranges: Ranges) -> Range:
        """Return its range, given those of the inputs."""
        return (-self.half_width, self.half_width) if self.kind == "stop" else ranges[self.of]

    def numbers(self, rate_Hz: float) -> tuple[float, ...]:
        """Return its numbers for the tick."""
        return (self.half_width,)


@dataclass(frozen=True)
class Lag(_Definition):
    """The signal `of` behind a first-order lag of `time_constant_s`, from its first value on."""

    name: str
    of: str
    time_constant_s: float
    kind: str = field(default="lag", init=False)

    def range(self, ranges: Ranges) -> Range:
        """Return its range: that of its signal, widened by rounding errors."""
        low, high = ranges[self.of]
        rounding = 4e-16 * max(abs(low), abs(high))  # of a difference, a product and a sum
        return down(low - rounding), up(high + rounding)

    def numbers(self, rate_Hz: float) -> tuple[float, ...]:
        """Return its numbers for the tick."""
        return (self.gain(rate_Hz),)


@dataclass(frozen=True)
class Frequency(_Definition):
    """Displacement frequency [Hz] in an exponential window of `time_constant_s`, clamped to `range_Hz`.

    `floor_m` [m] keeps the estimate low near standstill.
    """

    name: str
    time_constant_s: float
    range_Hz: Range
    floor_m: float
    kind: str = field(default="frequency", init=False)

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals from which it is computed."""
        return "position", "speed"

    def range(self, ranges: Ranges) -> Range:
        """Return its range."""
        return self.range_Hz

    def numbers(self, rate_Hz: float) -> tuple[float, ...]:
        """Return its numbers for the tick."""
        return self.gain(rate_Hz), self.floor_m * self.floor_m, *self.range_Hz


@dataclass(frozen=True)
class TriangularMembership(_Definition):
    """Membership of the signal `of` around `peak`: 1 there, falling to 0 at `low` and at `high`, all in its unit.

    Without `low` (None) it is 1 everywhere below the peak, without `high` everywhere above. `base` is the definition
    of `of` if that is a constructed input too.
    """

    name: str
    of: str
    low: float | None
    peak: float
    high: float | None
    base: ConstructedInput | None = None
    kind: str = field(default="hat", init=False)

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals from which it is computed, directly or through `base`."""
        return (self.of,) if self.base is None else (self.of, *self.base.signals)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Where its slope jumps."""
        return tuple(at for at in (self.low, self.peak, self.high) if at is not None)

    @property
    def ends(self) -> tuple[float, float, float]:
        """The values `low`, `peak` and `high`; a side without an end has it at the peak."""
        low = self.peak if self.low is None else self.low
        return low, self.peak, self.peak if self.high is None else self.high

    def at(self, value: float) -> float:
        """Return the membership of `value`, from 0 to 1."""
        return tick.membership(value, *self.ends)

    def base_range(self, ranges: Ranges) -> Range:
        """Return the range of the signal `of`."""
        return ranges[self.of] if self.base is None else self.base.range(ranges)

    def range(self, ranges: Ranges) -> Range:
        """Return its range."""
        return 0.0, 1.0

    def interval(self, at: Interval) -> Interval:
        """Return an interval that holds the membership of every value in `at`."""
        ends = self.at(at[0]), self.at(at[1])
        highest = 1.0 if at[0] <= self.peak <= at[1] else max(ends)
        return max(0.0, down(down(down(min(ends))))), min(1.0, up(up(up(highest))))

    def slope_interval(self, at: Interval) -> Interval:
        """Return an interval that holds the slope between any two values in `at`: the hull of slopes there."""
        rise = 0.0 if self.low is None else 1.0 / (self.peak - self.low)
        fall = 0.0 if self.high is None else 1.0 / (self.peak - self.high)
        slopes = [rise] if at[0] < self.peak and (self.low is None or at[1] > self.low) else []
        slopes += [fall] if at[1] > self.peak and (self.high is None or at[0] < self.high) else []
        outside = (self.low is not None and at[0] < self.low) or (self.high is not None and at[1] > self.high)
        slopes += [0.0] if outside or not slopes else []
        return down(down(down(min(slopes)))), up(up(up(max(slopes))))

    def numbers(self, rate_Hz: float) -> tuple[float, ...]:
        """Return its numbers for the tick."""
        return self.ends


ConstructedInput = Hysteresis | Lag | Frequency | TriangularMembership


def make_memberships(
    name: str, of: str, peaks: Sequence[float], base: ConstructedInput | None = None
) -> tuple[TriangularMembership, ...]:
    """Return a membership for each of the ascending `peaks`, named NAME_1 and so on; they add up to one everywhere."""
    ends = [None, *peaks, None]
    return tuple(
        TriangularMembership(f"{name}_{i + 1}", of, ends[i], peak, ends[i + 2], base) for i, peak in enumerate(peaks)
    )


def lay_out_constructed(
    layout: Layout, constructed: Sequence[ConstructedInput], rate_Hz: float, position: int
) -> tuple[int, dict[str, int]]:
    """Write the table of constructed inputs, each after those from which it is computed, for `constructed_update`.

    Position, speed and current stand at s[position] and behind it, where the state of the layout ends. Returns the
    place of the table in n, and the place in s of every signal.
    """
    places = {name: position + i for i, name in enumerate((*BASE, *(one.name for one in constructed)))}
    layout.state(len(constructed) * (1 + tick.CONSTRUCTED_STATES))
    rows = list[int]()
    for one in constructed:
        numbers = one.numbers(rate_Hz)
        padding = (0.0,) * (tick.CONSTRUCTED_NUMBERS - len(numbers))
        rows += [KINDS.index(one.kind), places[one.signals[0]], layout.table((*numbers, *padding))]
    return layout.indices(rows), places


RESERVED = (*BASE, "force", "products", "constructed")
NAME = re.compile(r"(?!.*_(abs|p\d|lag\d))[a-z][a-z0-9_]{0,39}")
SETTINGS = {
    "stop": ("of", "half_width"),
    "play": ("of", "half_width"),
    "lag": ("of", "time_constant_s"),
    "frequency": ("time_constant_s", "range_Hz", "floor_m"),
    "hat": ("of", "low", "peak", "high"),
}
KINDS = tuple(SETTINGS)  # in the order of their numbers in the tick
MAX_CONSTRUCTED = 64
MAX_WIDTH = 1e6  # [m, m/s, A]
MIN_WIDTH = 1e-9  # so that no slope overflows
MIN_HZ, MAX_HZ = 1e-3, 1e5


def parse_constructed(nodes: Iterable[JsonObject]) -> dict[str, ConstructedInput]:
    """Check the list `constructed` of a model file, and return its inputs by name; raises ModelError."""
    known: dict[str, ConstructedInput] = {}
    for node in nodes:
        one = _parse_one(node, known)
        if one.name in known:
            raise ModelError(f"{node.where}: name '{one.name}' occurs twice; expected a name for each input")
        known[one.name] = one
    return known


def require_name(name: str, where: str) -> str:
    """Return `name`; raises ModelError if it cannot be the name of a constructed input."""
    if name in RESERVED or not NAME.fullmatch(name):
        raise ModelError(
            f"{where}: name {name[:60]!r}; expected up to 40 lower-case letters, digits and _, not a signal's name, "
            "and without the suffixes of powers and lags (_abs, _p2, _lag1)"
        )
    return name


def _parse_one(node: JsonObject, known: Mapping[str, ConstructedInput]) -> ConstructedInput:
    name, kind = require_name(node.text("name"), node.where), node.choice("kind", KINDS)
    node.require_only_keys("name", "kind", *SETTINGS[kind])
    if kind == "frequency":
        return _parse_frequency(node, name)
    if kind == "hat":
        smooth = [one.name for one in known.values() if not isinstance(one, TriangularMembership)]
        return _parse_membership(node, name, node.choice("of", (*BASE, *smooth)), known)
    if kind == "lag":
        return Lag(name, node.choice("of", BASE), node.number("time_constant_s", 1e-4, 1e4))
    return Hysteresis(name, kind, node.choice("of", BASE), node.number("half_width", MIN_WIDTH, MAX_WIDTH))


def _parse_frequency(node: JsonObject, name: str) -> Frequency:
    low, high = node.range("range_Hz", MAX_HZ)
    if not MIN_HZ <= low < high:
        raise ModelError(f"{node.where}: range_Hz is [{low:g}, {high:g}]; expected {MIN_HZ:g} <= low < high")
    return Frequency(
        name, node.number("time_constant_s", 1e-4, 1e4), (low, high), node.number("floor_m", MIN_WIDTH, MAX_WIDTH)
    )


def _parse_membership(
    node: JsonObject, name: str, of: str, known: Mapping[str, ConstructedInput]
) -> TriangularMembership:
    low, high = (None if node.value.get(key) is None else node.number(key, -1e6, 1e6) for key in ("low", "high"))
    peak = node.number("peak", -1e6, 1e6)
    falls = low is None or low <= peak - MIN_WIDTH
    if not (falls and (high is None or high >= peak + MIN_WIDTH)) or low is high is None:
        raise ModelError(
            f"{node.where}: low {low}, peak {peak:g}, high {high}; expected low < peak < high, one not null"
        )
    return TriangularMembership(name, of, low, peak, high, known.get(of))
