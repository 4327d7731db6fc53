"""The band of a model: how far the measured force may lie from the estimate, tick by tick.

Position, speed, current and estimated force of each tick go in; the half-width [N] of the band comes out. Estimate plus
and minus half-width contain the measured force, sensor noise included, at `level` of the ticks.
`ces_observer.tick.band` has its equation. It grows with the distance of the state from the recordings that the model
was identified on (Mahalanobis, 1 in the root mean square over them): an error that depends linearly on the state, by
unknown amounts, grows like the distance. `ces_identify.validation.band` finds the weights on held-out data.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain, islice
from math import exp

from ces_observer.fields import Field
from ces_observer.flat import ArrayLayout
from ces_observer.limits import NumberLimits
from ces_observer.records import bounded, declare
from ces_observer.shapes import ByName
from ces_observer.tick import band as tick
from ces_observer.tick.model import HAS_BAND

STATE = ("position", "speed", "current", "change of speed", "change of current")
PARTS = ("low_current_N", "high_current_N", "slow_N", "fast_N", "force", "change_of_force", "reversal_N")
ROWS = range(len(STATE), 0, -1)  # lengths of the rows of an upper triangle, from the diagonal on


def _as_rows(numbers: Iterable[float]) -> tuple[tuple[float, ...], ...]:
    triangle = iter(numbers)
    return tuple(tuple(islice(triangle, length)) for length in ROWS)


@dataclass(frozen=True, repr=False)
class Band:
    """The half-width as a function of the state.

    A change is a signal minus its low-pass with time constant `change_s`. A reversal counts exp(-age / `reversal_s`).
    "Slow" is 1 / (1 + u) and "fast" is u = |speed| / `speed_m_s`; "high current" is the position of the current in its
    recorded range `current_A`, from 0 to 1, and "low current" 1 minus that. `parts` are the weights in the order of
    PARTS. The distance is the length of `whitening` (upper triangular, rows) times the state's deviation from `mean`,
    at most `max_distance`; `constant_share` is the share of the squared error that does not grow with it.
    """

    level: float = bounded(0.01, 0.9999)
    change_s: float = bounded(1e-5, 1e3)
    reversal_s: float = bounded(1e-5, 1e3)
    speed_m_s: float = bounded(1e-9, NumberLimits.MAX_SQUARED)
    current_A: tuple[float, float] = bounded(-NumberLimits.MAX_SQUARED, NumberLimits.MAX_SQUARED)
    parts: tuple[float, ...] = declare(
        Field(
            kind=ByName(Field(kind=float, low=0.0, high=NumberLimits.MAX_SQUARED), PARTS, PARTS),
            make=lambda parts: tuple(parts.values()),
            text=lambda parts: dict(zip(PARTS, parts, strict=True)),
        )
    )
    mean: tuple[float, ...] = bounded(
        -NumberLimits.MAX_SQUARED, NumberLimits.MAX_SQUARED, min_count=len(STATE), max_count=len(STATE)
    )
    whitening: tuple[tuple[float, ...], ...] = bounded(
        -NumberLimits.MAX_SQUARED,
        NumberLimits.MAX_SQUARED,
        kind=float,
        many=True,
        min_count=sum(ROWS),
        max_count=sum(ROWS),
        make=_as_rows,
        text=lambda rows: list(chain.from_iterable(rows)),
    )
    max_distance: float = bounded(0.0, NumberLimits.MAX_INPUT)
    constant_share: float = bounded(0.0, 1.0)

    def __repr__(self) -> str:
        return f"Band: meant to hold {self.level:.0%} of the measured forces"

    def fill(self, layout: ArrayLayout, rate_Hz: float) -> None:
        """Write its numbers into the layout of a model, for `ces_observer.tick.band`."""
        low, high = self.current_A
        layout.n[HAS_BAND] = 1
        layout.p[tick.BAND_GAIN] = 1.0 - exp(-1.0 / (self.change_s * rate_Hz))
        layout.p[tick.BAND_FADE] = exp(-1.0 / (self.reversal_s * rate_Hz))
        layout.p[tick.BAND_LOW_A] = low
        layout.p[tick.BAND_PER_A] = 1.0 / (high - low) if high > low else 0.0
        layout.p[tick.BAND_SPEED] = self.speed_m_s
        layout.put(tick.LOW_CURRENT_WEIGHT, self.parts)
        layout.put(tick.BAND_MEAN, self.mean)
        layout.put(tick.BAND_WHITENING, chain.from_iterable(self.whitening))
        layout.p[tick.BAND_LIMIT] = self.max_distance * self.max_distance
        layout.p[tick.BAND_SHARE] = self.constant_share
