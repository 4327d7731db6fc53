"""Constructed inputs: signals made at each tick from position, speed and current, to stand in terms as these do.

`stop` and `play` are the two halves of a signal with hysteresis (Brokate & Sprekels, Hysteresis and Phase Transitions,
1996, ch. 2; a weighted sum of stops is a Prandtl-Ishlinskii model): a stop follows its signal within +-half_width and
so tells the stroke since the last reversal, as compliance and presliding friction feel it; the play is what is left of
the signal. `lag` is a first-order lag, as a coil and a pilot valve put between current and force. `frequency` estimates
how fast the damper moves to and fro. `hat` is a triangular membership: hats over the same breakpoints add up to one, so
that terms times hats are sub-models blended over a signal, and hats over a stop are a look-up table of it. All are made
of inputs clamped to the model's envelope, so that their ranges are certain.

ces_observer.structures.constructed_runs runs them; ces_observer.structures.constructed_file reads them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp
from typing import Any

from ces_observer.proof.intervals import Interval, down, up
from ces_observer.structures.constructed_runs import (
    ConstructedRun,
    FrequencyRun,
    LagRun,
    MembershipRun,
    PlayRun,
    StopRun,
)
from ces_observer.structures.structure import Range, Ranges

BASE = ("position", "speed", "current")


@dataclass(frozen=True)
class Hysteresis:
    """The `stop` or `play` of the signal `of` with `half_width` in its unit (m, m/s or A).

    stop: h(k) = clip(h(k-1) + s(k) - s(k-1), -half_width, half_width), from 0; play: s - stop, from the first s.
    """

    name: str
    kind: str
    of: str
    half_width: float

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals it is made of."""
        return (self.of,)

    def range(self, ranges: Ranges) -> Range:
        """Return what bounds it, given the ranges of the inputs."""
        return (-self.half_width, self.half_width) if self.kind == "stop" else ranges[self.of]

    def make_run(self, columns: Mapping[str, int], rate_Hz: float) -> ConstructedRun:
        """Return it at its beginning; `columns` tells where each signal stands among the values."""
        return (StopRun if self.kind == "stop" else PlayRun)(columns[self.of], self.half_width)

    def to_json(self) -> dict[str, Any]:
        """Return what the model file keeps."""
        return {"name": self.name, "kind": self.kind, "of": self.of, "half_width": self.half_width}


@dataclass(frozen=True)
class Lag:
    """The signal `of` behind a first-order lag of `time_constant_s`, from its first value on.

    y(k) = y(k-1) + (1 - exp(-T / time_constant_s)) (s(k) - y(k-1)), T the tick.
    """

    name: str
    of: str
    time_constant_s: float

    @property
    def kind(self) -> str:
        """Its name among the kinds."""
        return "lag"

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals it is made of."""
        return (self.of,)

    def range(self, ranges: Ranges) -> Range:
        """Return what bounds it: the signal's own range, and roundings."""
        low, high = ranges[self.of]
        rounding = 4e-16 * max(abs(low), abs(high))  # of a difference, a product and a sum
        return down(low - rounding), up(high + rounding)

    def gain(self, rate_Hz: float) -> float:
        """Return the weight of a new tick."""
        return 1.0 - exp(-1.0 / (self.time_constant_s * rate_Hz))

    def make_run(self, columns: Mapping[str, int], rate_Hz: float) -> ConstructedRun:
        """Return it at its beginning."""
        return LagRun(columns[self.of], self.gain(rate_Hz))

    def to_json(self) -> dict[str, Any]:
        """Return what the model file keeps."""
        return {"name": self.name, "kind": self.kind, "of": self.of, "time_constant_s": self.time_constant_s}


@dataclass(frozen=True)
class Frequency:
    """Displacement frequency [Hz], f = sqrt(<v^2> / (<x^2> + floor^2)) / (2 pi), clamped to `range_Hz`.

    <> is an exponential window of `time_constant_s`. x and v are counted from their own means in such a window:
    both are filtered alike, which leaves their ratio as it is. `floor_m` [m] keeps the estimate low near standstill.
    """

    name: str
    time_constant_s: float
    range_Hz: Range
    floor_m: float

    @property
    def kind(self) -> str:
        """Its name among the kinds."""
        return "frequency"

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals it is made of."""
        return "position", "speed"

    def range(self, ranges: Ranges) -> Range:
        """Return what bounds it."""
        return self.range_Hz

    def gain(self, rate_Hz: float) -> float:
        """Return the weight of a new tick in the exponential windows."""
        return 1.0 - exp(-1.0 / (self.time_constant_s * rate_Hz))

    def make_run(self, columns: Mapping[str, int], rate_Hz: float) -> ConstructedRun:
        """Return it at its beginning."""
        return FrequencyRun(self.gain(rate_Hz), self.floor_m, self.range_Hz)

    def to_json(self) -> dict[str, Any]:
        """Return what the model file keeps."""
        settings = {"time_constant_s": self.time_constant_s, "range_Hz": self.range_Hz, "floor_m": self.floor_m}
        return {"name": self.name, "kind": self.kind, **settings}


@dataclass(frozen=True)
class TriangularMembership:
    """Membership of the signal `of` around `peak`: 1 there, falling to 0 at `low` and at `high`, all in its unit.

    Without `low` (None) it is 1 everywhere below the peak, without `high` everywhere above. `base` is the definition
    of `of` where that is constructed itself.
    """

    name: str
    of: str
    low: float | None
    peak: float
    high: float | None
    base: ConstructedInput | None = None

    @property
    def kind(self) -> str:
        """Its name among the kinds."""
        return "hat"

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals it is made of, at first or second hand."""
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
        """Return the range of the signal it is of."""
        return ranges[self.of] if self.base is None else self.base.range(ranges)

    def range(self, ranges: Ranges) -> Range:
        """Return what bounds it."""
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

    def make_run(self, columns: Mapping[str, int], rate_Hz: float) -> ConstructedRun:
        """Return it at its beginning."""
        return MembershipRun(columns[self.of], self.at)

    def to_json(self) -> dict[str, Any]:
        """Return what the model file keeps."""
        return {
            "name": self.name,
            "kind": self.kind,
            "of": self.of,
            "low": self.low,
            "peak": self.peak,
            "high": self.high,
        }


ConstructedInput = Hysteresis | Lag | Frequency | TriangularMembership


def make_memberships(
    name: str, of: str, peaks: Sequence[float], base: ConstructedInput | None = None
) -> tuple[TriangularMembership, ...]:
    """Return one hat for each of the ascending `peaks`, named NAME_1 and so on; they add up to one everywhere."""
    ends = [None, *peaks, None]
    return tuple(
        TriangularMembership(f"{name}_{i + 1}", of, ends[i], peak, ends[i + 2], base) for i, peak in enumerate(peaks)
    )


class InputConstructor:
    """Every constructed input of a model at work."""

    def __init__(self, constructed: Sequence[ConstructedInput], rate_Hz: float) -> None:
        """Expect each input after those it is made of."""
        columns = {name: i for i, name in enumerate((*BASE, *(one.name for one in constructed)))}
        self._runs = [one.make_run(columns, rate_Hz) for one in constructed]
        self._arrivals = [run.update for run in self._runs]

    def reset(self) -> None:
        """Forget the past."""
        for run in self._runs:
            run.reset()

    def update(self, values: Sequence[float]) -> list[float]:
        """Take a tick's position, speed and current, within their envelope; return these and each constructed input."""
        known = list(values)
        for arrive in self._arrivals:
            known.append(arrive(known))
        return known
