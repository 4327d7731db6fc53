"""The kinds of current: a description goes in, commands on a grid come out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, pi
from typing import Any, Self

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter, max_len_seq

from ces_data.arrays import F
from ces_data.waveforms.strokes import KIND, MAX_PARTS, Current, duration, filtered_noise, find_spans
from ces_observer.errors import CesError
from ces_observer.fields import REQUIRED
from ces_observer.records import OneOf, items, part, quantity

LOW, HIGH = 0.29, 0.70  # [A] what the controller reg1 of the thesis used (section 5.1)


def require_range(low_A: float, high_A: float) -> None:
    """Raise CesError for an empty range of currents."""
    if high_A <= low_A:
        raise CesError("high_A is not above low_A")


def _current(default: Any, what: str) -> Any:
    return quantity(default, "A", what, 0.0, 10.0)


@dataclass(frozen=True)
class ConstantLevel:
    """One value."""

    current_A: float = _current(REQUIRED, "the current")

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return a constant."""
        return np.full_like(time_s, self.current_A)


@dataclass(frozen=True)
class Ramp:
    """A straight line from start to end."""

    from_A: float = _current(LOW, "current at the start")
    to_A: float = _current(HIGH, "current at the end")

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the line."""
        return np.linspace(self.from_A, self.to_A, len(time_s))


@dataclass(frozen=True)
class Steps:
    """Levels one after the other, each held, repeated."""

    levels_A: tuple[float, ...] = _current(REQUIRED, "the levels")
    hold_s: float = quantity(1.0, "s", "hold time of each level", 1e-3, 1e4)

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the steps."""
        step = np.floor((time_s - time_s[0]) / self.hold_s + 1e-9).astype(int)
        levels = np.asarray(self.levels_A)
        return np.asarray(levels[step % len(levels)])


@dataclass(frozen=True)
class CurrentRange:
    """The range of a current."""

    low_A: float = _current(LOW, "lower end")
    high_A: float = _current(HIGH, "upper end")

    def checked(self) -> Self:
        """Return it; raises CesError for an empty range."""
        require_range(self.low_A, self.high_A)
        return self

    def at(self, share: F) -> F:
        """Return the currents [A] (n,) for shares of half the range, -1 to 1, from its middle."""
        middle, half = (self.high_A + self.low_A) / 2, (self.high_A - self.low_A) / 2
        return np.asarray(middle + half * share)


@dataclass(frozen=True)
class Prbs(CurrentRange):
    """Pseudo-random binary sequence between two levels, from a seeded start in a maximum-length sequence."""

    hold_s: float = quantity(0.1, "s", "shortest time between switches", 1e-3, 1e3)

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the sequence (order 15: repeats after 32,767 holds)."""
        sequence = max_len_seq(15)[0].astype(bool)
        index = np.floor((time_s - time_s[0]) / self.hold_s + 1e-9).astype(int) + int(rng.integers(len(sequence)))
        return np.where(sequence[index % len(sequence)], self.high_A, self.low_A)


@dataclass(frozen=True)
class Binary(CurrentRange):
    """Two levels, switched after random times (exponential beyond the shortest)."""

    shortest_s: float = quantity(0.05, "s", "shortest time between switches", 1e-3, 1e3)
    mean_s: float = quantity(0.3, "s", "mean time between switches", 1e-3, 1e3)

    def __post_init__(self) -> None:
        if self.mean_s <= self.shortest_s:
            raise CesError(f"mean_s {self.mean_s:g} is not above shortest_s {self.shortest_s:g}")

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the switched current."""
        count = int((time_s[-1] - time_s[0]) / self.shortest_s) + 2
        gaps = self.shortest_s + rng.exponential(self.mean_s - self.shortest_s, count)
        switched = np.searchsorted(np.cumsum(gaps), time_s - time_s[0])
        return np.where(switched % 2 == 1, self.high_A, self.low_A)


@dataclass(frozen=True)
class FilteredNoise(CurrentRange):
    """Low-pass filtered white noise, softly limited to a range."""

    cutoff_Hz: float = quantity(3.0, "Hz", "cutoff of the 4th-order Butterworth filter", 0.0, 100.0, above=True)
    spread: float = quantity(0.6, "1", "standard deviation before limiting, relative to half the range", 0.0, 10.0)

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the noise; the filter starts 3 s earlier."""
        noise = filtered_noise(len(time_s), 1.0 / (time_s[1] - time_s[0]), 4, self.cutoff_Hz, 3.0, rng)
        return self.at(np.tanh(self.spread * noise / noise.std()))


@dataclass(frozen=True)
class StrokeFollowing(CurrentRange):
    """A current tied to the stroke: more when compressed, less when extended, inside a range.

    current = middle + half range · tanh(s), where s is the stroke over `stroke_m` after a first-order lag.
    """

    stroke_m: float = quantity(0.012, "m", "stroke that moves the current 76 % of the way to an end", 1e-4, 1.0)
    lag_s: float = quantity(0.010, "s", "time constant of the lag", 0.0, 10.0)

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the current."""
        step = time_s[1] - time_s[0]
        pole = exp(-step / self.lag_s) if self.lag_s > 0.0 else 0.0
        start = np.asarray([pole * stroke_m[0]])
        followed, _ = lfilter([1.0 - pole], [1.0, -pole], stroke_m, zi=start)
        return self.at(np.tanh(followed / self.stroke_m))


@dataclass(frozen=True)
class SineCurrent(CurrentRange):
    """A sine inside a range."""

    frequency_Hz: float = quantity(1.0, "Hz", "frequency", 0.0, 100.0, above=True)

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the sine, starting in the middle."""
        return self.at(np.sin(2 * pi * self.frequency_Hz * time_s))


@dataclass(frozen=True)
class CurrentPart:
    """A current in a sequence; it is known before the damper moves."""

    duration_s: float = duration()
    current: Current = part(kind=OneOf(lambda: SINGLE), inline=True)


@dataclass(frozen=True)
class CurrentSequence:
    """Currents one after the other."""

    parts: tuple[CurrentPart, ...] = items(1, MAX_PARTS)

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the commanded current [A] at the uniform times (n,)."""
        current = np.empty_like(time_s)
        for one, span in find_spans([(one.duration_s, one.current) for one in self.parts], time_s):
            current[span] = one.samples(time_s[span] - time_s[span.start], stroke_m[span], rng)
        return current


SINGLE: Mapping[str, type[Any]] = {
    "constant": ConstantLevel, "ramp": Ramp, "steps": Steps, "prbs": Prbs, "binary": Binary,
    "filtered_noise": FilteredNoise, "sine": SineCurrent, "stroke_following": StrokeFollowing,
}  # fmt: skip
KINDS: Mapping[str, type[Any]] = {**SINGLE, KIND: CurrentSequence}  # known before the damper moves
