"""Constructed inputs: signals computed at each tick from position, speed and current, and used in terms like these.

Here are their definitions; `ces_observer.tick.constructed` computes them, and has their equations. The `stop` is the
stroke since the last reversal, on which compliance and presliding friction depend; the `play` is the rest of its
signal. A `lag` is like that of coil and pilot valve between current and force. Memberships (`hat`) over the same
breakpoints add up to one, so that terms times memberships are sub-models blended over a signal. All are computed from
inputs clamped to the model's envelope, so their ranges are certain.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import exp
from typing import Any, Self

from ces_observer.errors import ModelError
from ces_observer.fields import REQUIRED, Field
from ces_observer.flat import ArrayLayout
from ces_observer.limits import FileLimits, NumberLimits
from ces_observer.proof.intervals import Interval, down, up
from ces_observer.records import bounded, choice, declare, in_files, part
from ces_observer.structures.structure import Range, Ranges
from ces_observer.tick import constructed as tick

BASE = ("position", "speed", "current")
RESERVED = (*BASE, "force", "products", "constructed")
NAME = re.compile(r"(?!.*_(abs|p\d|lag\d))[a-z][a-z0-9_]{0,39}")
PEAKS = (-NumberLimits.MAX_INPUT, NumberLimits.MAX_INPUT)  # [m, m/s, A, Hz]


def require_name(name: str) -> None:
    """Raise ValueError unless `name` can be that of a constructed input."""
    if name in RESERVED or not NAME.fullmatch(name):
        raise ValueError(
            f"name {name[:60]!r}; expected up to 40 lower-case letters, digits and _, not a signal's name, "
            "and without the suffixes of powers and lags (_abs, _p2, _lag1)"
        )


def _name() -> Any:
    return declare(Field(check_text=require_name))


def _seconds() -> Any:
    return bounded(1e-4, 1e4, unit="s")


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


@dataclass(frozen=True)
class Hysteresis(_Definition):
    """The `stop` or `play` of the signal `of` with `half_width` in its unit (m, m/s or A)."""

    name: str = _name()
    kind: str = choice(REQUIRED, "", ("stop", "play"))
    of: str = choice(REQUIRED, "", BASE)
    half_width: float = bounded(NumberLimits.MIN_WIDTH, NumberLimits.MAX_INPUT)

    def range(self, ranges: Ranges) -> Range:
        """Return its range, given those of the inputs."""
        return (-self.half_width, self.half_width) if self.kind == "stop" else ranges[self.of]

    def numbers(self, rate_Hz: float) -> tuple[float, ...]:
        """Return its numbers for the tick."""
        return (self.half_width,)


@dataclass(frozen=True)
class Lag(_Definition):
    """The signal `of` behind a first-order lag of `time_constant_s`, from its first value on."""

    name: str = _name()
    kind: str = field(default="lag", init=False, metadata=in_files(Field(choices=("lag",))))
    of: str = choice(REQUIRED, "", BASE)
    time_constant_s: float = _seconds()

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

    name: str = _name()
    kind: str = field(default="frequency", init=False, metadata=in_files(Field(choices=("frequency",))))
    time_constant_s: float = _seconds()
    range_Hz: Range = bounded(*FileLimits.CONSTRUCTED_HZ, unit="Hz")
    floor_m: float = bounded(NumberLimits.MIN_WIDTH, NumberLimits.MAX_INPUT, unit="m")

    def checked(self) -> Self:
        """Return it; raises ModelError for an empty range."""
        low, high = self.range_Hz
        if low == high:
            raise ModelError(f"range_Hz is [{low:g}, {high:g}]; expected low < high")
        return self

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

    name: str = _name()
    kind: str = field(default="hat", init=False, metadata=in_files(Field(choices=("hat",))))
    of: str = part()
    low: float | None = bounded(*PEAKS)
    peak: float = bounded(*PEAKS)
    high: float | None = bounded(*PEAKS)
    base: ConstructedInput | None = field(default=None, metadata=in_files(None))

    def checked(self) -> Self:
        """Return it; raises ModelError unless it rises or falls, or both."""
        low, peak, high = self.low, self.peak, self.high
        falls = low is None or low <= peak - NumberLimits.MIN_WIDTH
        if not (falls and (high is None or high >= peak + NumberLimits.MIN_WIDTH)) or low is high is None:
            raise ModelError(f"low {low}, peak {peak:g}, high {high}; expected low < peak < high, one not null")
        return self

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
    layout: ArrayLayout, constructed: Sequence[ConstructedInput], rate_Hz: float, position: int
) -> tuple[int, dict[str, int]]:
    """Write the table of constructed inputs, each after those from which it is computed, for `constructed_update`.

    Position, speed and current stand at s[position] and behind it, where the state of the layout ends. Returns the
    place of the table in n, and the place in s of every signal.
    """
    places = {name: position + i for i, name in enumerate((*BASE, *(made.name for made in constructed)))}
    layout.state(len(constructed) * (1 + tick.CONSTRUCTED_STATES))
    rows = list[int]()
    for made in constructed:
        numbers = made.numbers(rate_Hz)
        padding = (0.0,) * (tick.CONSTRUCTED_NUMBERS - len(numbers))
        rows += [list(KINDS).index(made.kind), places[made.signals[0]], layout.table((*numbers, *padding))]
    return layout.indices(rows), places


KINDS = {  # in the order of their numbers in the tick
    "stop": Hysteresis,
    "play": Hysteresis,
    "lag": Lag,
    "frequency": Frequency,
    "hat": TriangularMembership,
}


def with_bases(definitions: Iterable[ConstructedInput]) -> dict[str, ConstructedInput]:
    """Return definitions by name, memberships with those before them that they are of; raises ModelError."""
    by_name: dict[str, ConstructedInput] = {}
    for i, made in enumerate(definitions):
        if made.name in by_name:
            raise ModelError(f"constructed[{i}]: name '{made.name}' occurs twice; expected a name for each input")
        by_name[made.name] = made
        if isinstance(made, TriangularMembership) and made.of not in BASE:
            smooth = {name: base for name, base in by_name.items() if not isinstance(base, TriangularMembership)}
            if made.of not in smooth:
                raise ModelError(f"constructed[{i}]: of is {made.of!r}; expected one of {', '.join((*BASE, *smooth))}")
            by_name[made.name] = replace(made, base=smooth[made.of])
    return by_name
