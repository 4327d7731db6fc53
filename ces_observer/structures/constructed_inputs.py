"""Constructed inputs: signals computed at each tick from position, speed and current, and used in terms like these.

`stop` and `play` are the two halves of a signal with hysteresis (Brokate & Sprekels, Hysteresis and Phase Transitions,
1996, ch. 2; a weighted sum of stops is a Prandtl-Ishlinskii model). The stop follows its signal within ±half_width: it
is the stroke since the last reversal, on which compliance and presliding friction depend. The play is the rest of the
signal. `lag` is a first-order lag, like that of coil and pilot valve between current and force. `frequency` estimates
the frequency of the damper's motion. `hat` is a triangular membership; memberships over the same breakpoints add up to
one, so that terms times memberships are sub-models blended over a signal. All are computed from inputs clamped to the
model's envelope, so their ranges are certain.

`ces_observer.structures.constructed_runs` runs them; `ces_observer.structures.constructed_file` reads them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import exp
from typing import Any

from ces_observer.proof.intervals import Interval, down, up
from ces_observer.structures import constructed_runs as runs
from ces_observer.structures.structure import Range, Ranges

BASE = ("position", "speed", "current")


class _Definition:
    """What the definitions of constructed inputs, all dataclasses, have in common."""

    name: str
    kind: str

    def to_json(self) -> dict[str, Any]:
        """Return the definition as in a model file."""
        settings = {key: value for key, value in asdict(self).items() if key != "base"}  # type: ignore[call-overload]
        return {"name": self.name, "kind": self.kind, **settings}


@dataclass(frozen=True)
class Hysteresis(_Definition):
    """The `stop` or `play` of the signal `of` with `half_width` in its unit (m, m/s or A).

    stop: h(k) = clip(h(k-1) + s(k) - s(k-1), -half_width, half_width), from 0; play: s - stop, from the first s.
    """

    name: str
    kind: str
    of: str
    half_width: float

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals from which it is computed."""
        return (self.of,)

    def range(self, ranges: Ranges) -> Range:
        """Return its range, given those of the inputs."""
        return (-self.half_width, self.half_width) if self.kind == "stop" else ranges[self.of]

    def make_run(self, columns: Mapping[str, int], rate_Hz: float) -> runs.ConstructedRun:
        """Return a new run; `columns` maps each signal to its place among the values."""
        make = runs.make_stop_run if self.kind == "stop" else runs.make_play_run
        return make(columns[self.of], self.half_width)


@dataclass(frozen=True)
class Lag(_Definition):
    """The signal `of` behind a first-order lag of `time_constant_s`, from its first value on.

    y(k) = y(k-1) + (1 - exp(-T / time_constant_s)) (s(k) - y(k-1)), T the tick.
    """

    name: str
    of: str
    time_constant_s: float
    kind: str = field(default="lag", init=False)

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals from which it is computed."""
        return (self.of,)

    def range(self, ranges: Ranges) -> Range:
        """Return its range: that of its signal, widened by rounding errors."""
        low, high = ranges[self.of]
        rounding = 4e-16 * max(abs(low), abs(high))  # of a difference, a product and a sum
        return down(low - rounding), up(high + rounding)

    def gain(self, rate_Hz: float) -> float:
        """Return the weight of a new tick."""
        return 1.0 - exp(-1.0 / (self.time_constant_s * rate_Hz))

    def make_run(self, columns: Mapping[str, int], rate_Hz: float) -> runs.ConstructedRun:
        """Return a new run."""
        return runs.make_lag_run(columns[self.of], self.gain(rate_Hz))


@dataclass(frozen=True)
class Frequency(_Definition):
    """Displacement frequency [Hz], f = sqrt(<v^2> / (<x^2> + floor^2)) / (2 pi), clamped to `range_Hz`.

    <> is an exponential window of `time_constant_s`. x and v are taken relative to their means in such a window: both
    are filtered alike, so their ratio stays the same. `floor_m` [m] keeps the estimate low near standstill.
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

    def gain(self, rate_Hz: float) -> float:
        """Return the weight of a new tick in the exponential windows."""
        return 1.0 - exp(-1.0 / (self.time_constant_s * rate_Hz))

    def make_run(self, columns: Mapping[str, int], rate_Hz: float) -> runs.ConstructedRun:
        """Return a new run."""
        return runs.make_frequency_run(self.gain(rate_Hz), self.floor_m, self.range_Hz)


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

    def at(self, value: float) -> float:
        """Return the membership of `value`, from 0 to 1."""
        end = self.low if value < self.peak else self.high
        return 1.0 if end is None else max(0.0, 1.0 - (value - self.peak) / (end - self.peak))

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

    def make_run(self, columns: Mapping[str, int], rate_Hz: float) -> runs.ConstructedRun:
        """Return a new run."""
        return runs.make_membership_run(columns[self.of], self.at)


ConstructedInput = Hysteresis | Lag | Frequency | TriangularMembership


def make_memberships(
    name: str, of: str, peaks: Sequence[float], base: ConstructedInput | None = None
) -> tuple[TriangularMembership, ...]:
    """Return a membership for each of the ascending `peaks`, named NAME_1 and so on; they add up to one everywhere."""
    ends = [None, *peaks, None]
    return tuple(
        TriangularMembership(f"{name}_{i + 1}", of, ends[i], peak, ends[i + 2], base) for i, peak in enumerate(peaks)
    )


class InputConstructor:
    """The runs of all constructed inputs of a model; each input follows those from which it is computed."""

    def __init__(self, constructed: Sequence[ConstructedInput], rate_Hz: float) -> None:
        self._constructed, self._rate_Hz = constructed, rate_Hz
        self._columns = {name: i for i, name in enumerate((*BASE, *(one.name for one in constructed)))}
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._runs = [one.make_run(self._columns, self._rate_Hz) for one in self._constructed]

    def update(self, values: Sequence[float]) -> list[float]:
        """Return a tick's position, speed and current, within their envelope, and after them each constructed input."""
        known = list(values)
        for run in self._runs:
            known.append(run(known))
        return known
