"""Lagged, scaled regressors of networks and fuzzy rules: their records, ranges and places in a layout."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

from ces_observer.flat import Layout
from ces_observer.json_text import JsonObject
from ces_observer.proof.intervals import Interval, add, down, product, up
from ces_observer.structures.structure import MAX_LAG, Ranges
from ces_observer.tick import lagged as tick

SIGNALS = ("force", "speed", "current", "position")
RINGS = ("position", "speed", "current", "force")
MAX_REGRESSORS = 64
MAX_NUMBER = 1e9  # weights and means: far beyond any fit, far below overflow
MIN_SPREAD = 1e-9


@dataclass(frozen=True)
class Regressor:
    """A signal `lag` ticks ago as (value - mean) / spread; mean and spread in the signal's unit (m, m/s, A, N).

    A `force` is the model's own past output (lag >= 1).
    """

    signal: str
    lag: int
    mean: float
    spread: float

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the model file."""
        return asdict(self)

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


def parse_regressor(node: JsonObject) -> Regressor:
    """Check one regressor of a model file; raises ModelError."""
    node.require_only_keys("signal", "lag", "mean", "spread")
    signal = node.choice("signal", SIGNALS)
    return Regressor(
        signal,
        node.integer("lag", 1 if signal == "force" else 0, MAX_LAG),
        node.number("mean", -MAX_NUMBER, MAX_NUMBER),
        node.number("spread", MIN_SPREAD, MAX_NUMBER),
    )


def parse_regressors(node: JsonObject) -> tuple[Regressor, ...]:
    """Check the list `regressors` of a model file; raises ModelError."""
    return tuple(parse_regressor(item) for item in node.items("regressors", 1, MAX_REGRESSORS))


def parse_number(node: JsonObject, key: str) -> float:
    """Return a weight from a model file; raises ModelError."""
    return node.number(key, -MAX_NUMBER, MAX_NUMBER)


def scale_from(node: JsonObject) -> float:
    """Return the scale of the output [N]; raises ModelError."""
    return node.number("scale_N", MIN_SPREAD, MAX_NUMBER)


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


def fill_lagged(layout: Layout, regressors: Sequence[Regressor]) -> None:
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
