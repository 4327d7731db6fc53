"""The cost of thesis eq. 3.5, J = 100 ||y - y^|| / ||y - mean(y)||, on the scored ticks of a free run.

Ticks may have weights by region of stroke, speed and current, as the thesis proposes (section 6.3).

A weighting is read from words such as `zero_crossing=3`, `stroke_ends=2`, `speed:-0.1..0.1=4`, `current:0.5..0.7=2`;
the weights of overlapping regions multiply.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F, Mask
from ces_identify.limits import TickLimits, WeightLimits
from ces_identify.prepare.series import Series
from ces_observer.errors import CesError, OptionName, RecordingError
from ces_observer.structures.structure import Range


def cost(measured: NDArray[np.float64], simulated: NDArray[np.float64]) -> float:
    """Return J [%] of two arrays of shape (n,); infinite if `simulated` has a non-finite value."""
    if not np.isfinite(simulated).all():
        return float("inf")
    spread = np.linalg.norm(measured - measured.mean())
    return float(100.0 * np.linalg.norm(measured - simulated) / spread)


def weighted_cost(measured: NDArray[np.float64], simulated: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Return J [%] of two arrays of shape (n,) with a weight for each tick; equal weights give `cost`.

    Infinite if `simulated` has a non-finite value, NaN if the force does not vary on the weighted ticks.
    """
    if not np.isfinite(simulated).all():
        return float("inf")
    total = float(weights.sum())
    mean = float(weights @ measured) / total if total > 0.0 else 0.0
    spread = float(weights @ (measured - mean) ** 2)
    if spread <= 0.0:
        return float("nan")
    return float(100.0 * np.sqrt(float(weights @ (measured - simulated) ** 2) / spread))


def series_cost(series: Series, simulated: NDArray[np.float64]) -> float:
    """Return J [%] of a simulated force (ticks,) on the scored ticks of `series`."""
    scored = series.scored
    return cost(series.force[scored], simulated[scored])


def require_force(series: Series) -> None:
    """Raise RecordingError if the measured force of `series` is too short or constant."""
    count = int(series.scored.sum())
    if count < TickLimits.MIN_SCORED:
        text = f"{count} ticks with a measured force past warm-up; expected at least {TickLimits.MIN_SCORED}"
        raise RecordingError(f"{series.name}: {text}")
    if np.ptp(series.force[series.scored]) == 0.0:
        raise RecordingError(
            f"{series.name}: measured force is constant; check its topic and field in the signals file"
        )


ZERO_CROSSING, STROKE_ENDS = "zero_crossing", "stroke_ends"
SIGNALS = ("speed", "current", "position", STROKE_ENDS)
FORMS = "zero_crossing[:SPEED]=W, stroke_ends[:CENTRAL_SHARE]=W, or speed|current|position:FROM..TO=W"
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
WORD = re.compile(rf"(?P<region>\w+)(?::(?P<low>{NUMBER})(?:\.\.(?P<high>{NUMBER}))?)?=(?P<weight>{NUMBER})", re.ASCII)


@dataclass(frozen=True)
class Region:
    """Ticks whose `signal` lies in `span` count `weight` times.

    The signal is speed [m/s], current [A], position [m], or `stroke_ends`: then `span` is in shares of the stroke, from
    0 at the lower end to 1 at the upper, and the ticks outside it count.
    """

    signal: str
    span: Range
    weight: float
    text: str

    def ticks(self, series: Series, stroke: Range | None) -> Mask:
        """Return a mask (ticks,) of the ticks that count; `stroke` [m] is that of the series if None."""
        low, high = self.span
        if self.signal != STROKE_ENDS:
            values = getattr(series, self.signal)
            return np.asarray((values >= low) & (values <= high))
        start, end = stroke or _stroke_of(series)
        share = (series.position - start) / max(end - start, 1e-12)
        return np.asarray((share < low) | (share > high))


@dataclass(frozen=True)
class Weighting:
    """Weighted regions, and the stroke [m] to which `stroke_ends` refers (None: that of each series)."""

    regions: tuple[Region, ...] = ()
    stroke: Range | None = None

    def tick_weights(self, series: Series) -> F:
        """Return the weight of each tick (ticks,); 1 outside all regions."""
        weights = np.ones(len(series))
        for region in self.regions:
            weights[region.ticks(series, self.stroke)] *= region.weight
        return weights

    def with_common_stroke(self, series: Sequence[Series]) -> Weighting:
        """Return the weighting with the common stroke of a set of series."""
        lows, highs = zip(*(_stroke_of(s) for s in series), strict=True)
        return replace(self, stroke=(min(lows), max(highs)))

    def __bool__(self) -> bool:
        return bool(self.regions)

    def __str__(self) -> str:
        return " ".join(region.text for region in self.regions)


EQUAL = Weighting()


def parse_weighting(words: Sequence[str]) -> Weighting:
    """Return the weighting that `words` describe; raises CesError for an unknown word."""
    return Weighting(tuple(_parse_region(word) for word in words))


def _parse_region(word: str) -> Region:
    match = WORD.fullmatch(word)
    if match is not None:
        signal, weight = match["region"], float(match["weight"])
        low, high = (math.nan if match[end] is None else float(match[end]) for end in ("low", "high"))
        if signal == ZERO_CROSSING and match["high"] is None:
            width = WeightLimits.SLOW_M_S if match["low"] is None else low
            signal, low, high = "speed", -width, width
        elif signal == STROKE_ENDS and match["high"] is None:
            central = WeightLimits.CENTRAL if match["low"] is None else low
            low, high = 0.5 - central / 2, 0.5 + central / 2
        elif signal == STROKE_ENDS:
            low = math.nan
        least = 0.0 if signal == STROKE_ENDS else -math.inf
        if signal in SIGNALS and least < low < high < math.inf and 0.0 <= weight <= WeightLimits.MAX_WEIGHT:
            return Region(signal, (low, high), weight, word)
    raise CesError(
        OptionName("weight", word),
        f": expected {FORMS}, with SPEED above 0 m/s, CENTRAL_SHARE above 0 and below 1, FROM below TO (m/s, A or m), "
        f"and W from 0 to {WeightLimits.MAX_WEIGHT:g}",
    )


def _stroke_of(series: Series) -> Range:
    positions = series.position[series.scored]
    return float(positions.min()), float(positions.max())
