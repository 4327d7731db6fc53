"""Lagged, scaled regressors of networks and fuzzy rules: their records, ranges and places in a layout."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

from ces_observer.errors import ModelError
from ces_observer.fields import REQUIRED
from ces_observer.flat import ArrayLayout
from ces_observer.limits import FileLimits, NumberLimits
from ces_observer.proof.intervals import Interval, add, down, product, up
from ces_observer.records import bounded, choice
from ces_observer.structures.structure import INPUTS, Ranges
from ces_observer.tick import lagged as tick

SIGNALS = ("force", "speed", "current", "position")
RINGS = ("position", "speed", "current", "force")


def weight() -> Any:
    """Declare a weight, a list of weights, or a mean."""
    return bounded(-NumberLimits.MAX_NUMBER, NumberLimits.MAX_NUMBER)


def spread(unit: str = "") -> Any:
    """Declare a scale above zero."""
    return bounded(NumberLimits.MIN_WIDTH, NumberLimits.MAX_NUMBER, unit=unit)


@dataclass(frozen=True)
class Regressor:
    """A signal `lag` ticks ago as (value - mean) / spread; mean and spread in the signal's unit (m, m/s, A, N).

    A `force` is the model's own past output (lag >= 1).
    """

    signal: str = choice(REQUIRED, "", SIGNALS)
    lag: int = bounded(0, FileLimits.MAX_LAG)
    mean: float = weight()
    spread: float = spread()

    def checked(self) -> Self:
        """Return it; raises ModelError for a force of the same tick."""
        if self.signal == "force" and self.lag == 0:
            raise ModelError(f"lag is 0; expected a whole number from 1 to {FileLimits.MAX_LAG} of a force")
        return self

    def interval(self, inputs: Ranges) -> Interval:
        """Return an interval that holds it for all inputs in their ranges, and past forces of zero."""
        low, high = inputs.get(self.signal, (0.0, 0.0))
        shifted = add((low, high), (-self.mean, -self.mean))
        return down(shifted[0] / self.spread), up(shifted[1] / self.spread)


class Lagged(Protocol):
    """A signal some ticks ago."""

    @property
    def signal(self) -> str:
        """The signal's name."""

    @property
    def lag(self) -> int:
        """Its lag in ticks."""


def affine(constant: float, slopes: Sequence[float], at: Sequence[Interval]) -> Interval:
    """Return an interval that holds constant + slopes . x for every x in the box `at`."""
    total = (constant, constant)
    for slope, interval in zip(slopes, at, strict=True):
        total = add(total, product((slope, slope), interval))
    return total


def longest_lags(signals: Iterable[Lagged]) -> tuple[int, int]:
    """Return the longest lags [ticks] of past forces and of inputs; 0 if there is none."""
    lags = [(one.signal == "force", one.lag) for one in signals]
    past, inputs = (max((lag for own, lag in lags if own is is_past), default=0) for is_past in (True, False))
    return past, inputs


def list_used(signals: Iterable[Lagged]) -> list[str]:
    """Return the names of the inputs among lagged signals."""
    names = {one.signal for one in signals}
    return [name for name in INPUTS if name in names]


def fill_lagged(layout: ArrayLayout, regressors: Sequence[Regressor]) -> None:
    """Write regressors and the rings of past ticks that they need into a layout, for `ces_observer.tick.lagged`."""
    depth = 1 + max(r.lag for r in regressors)
    rings = layout.state(len(RINGS) * depth)
    sources = [number for r in regressors for number in (rings + RINGS.index(r.signal) * depth, r.lag)]
    layout.n[tick.LAGGED_DEPTH] = depth
    layout.n[tick.LAGGED_COUNT] = len(regressors)
    layout.n[tick.LAGGED_PHI] = layout.state(len(regressors))
    layout.n[tick.LAGGED_RINGS] = rings
    layout.n[tick.LAGGED_SOURCES] = layout.indices(sources)
    layout.n[tick.LAGGED_SCALES] = layout.table(number for r in regressors for number in (r.mean, r.spread))
