"""Where a recording leaves a model's envelope: the signals, each with the range used and the range known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.preparation.series import Series
from ces_observer.model import Model

UNITS = {"position": "m", "speed": "m/s", "current": "A"}
MIN_SHARE = 0.005  # of the ticks: a model's own recordings are outside for hardly as long
FIGURES = 4  # of the largest number of a range; the others have as many decimals


@dataclass(frozen=True)
class RangeUse:
    """One signal: the range `used` by a recording, the range `known` to the model, and the share of ticks outside."""

    signal: str
    used: tuple[float, float]
    known: tuple[float, float]
    outside_share: float

    def as_texts(self) -> tuple[str, str]:
        """Return the ranges used and known as text, without their unit."""
        used, known = (f"{low} to {high}" if low != high else low for low, high in _format_alike(self.used, self.known))
        return used, known

    def __str__(self) -> str:
        used, known = self.as_texts()
        return f"{self.signal} {used} {UNITS[self.signal]}, model knows {known}"


def outside_ranges(model: Model, series: Series) -> tuple[RangeUse, ...]:
    """Return the signals that leave the model's envelope on the scored ticks, the one that does so longest first.

    Without scored ticks (no measured force) all ticks count.
    """
    ticks = series.scored if series.scored.any() else np.ones(len(series), bool)
    return find_outside(model, {name: getattr(series, name)[ticks] for name in UNITS})


def find_outside(model: Model, signals: Mapping[str, F]) -> tuple[RangeUse, ...]:
    """Return the same for arrays (n,) of position [m], speed [m/s] and current [A] by name."""
    uses = []
    for name, values in signals.items():
        low, high = model.envelope.by_signal[name]
        share = float(np.mean((values < low) | (values > high))) if len(values) else 0.0
        if share > MIN_SHARE:
            uses.append(RangeUse(name, (float(values.min()), float(values.max())), (low, high), share))
    return tuple(sorted(uses, key=lambda use: -use.outside_share))


def describe_outside(name: str, share: float, uses: Sequence[RangeUse]) -> str:
    """Return as text that recording `name` is outside for a share of the time, with the ranges of its signals."""
    return f"{name} is outside the model's envelope for {100.0 * share:.1f} % of the time: {'; '.join(map(str, uses))}"


def _format_alike(*ranges: tuple[float, float]) -> list[tuple[str, str]]:
    """Return the numbers of all ranges with the same number of decimals."""
    largest = max(abs(value) for pair in ranges for value in pair)
    power = int(np.floor(np.log10(largest))) if largest > 0.0 else 0
    decimals = min(max(0, FIGURES - 1 - power), 9)
    return [(_plain(low, decimals), _plain(high, decimals)) for low, high in ranges]


def _plain(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text
