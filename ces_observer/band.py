"""The band of a model: how far the measured force may lie from the estimate, tick by tick.

Position, speed, current and estimated force of each tick go in; the half-width [N] of the band comes out. Estimate plus
and minus half-width contain the measured force, sensor noise included, at `level` of the ticks.
`ces_observer.tick.band` has its equation. It grows with the distance of the state from the recordings that the model
was identified on (Mahalanobis, 1 in the root mean square over them): an error that depends linearly on the state, by
unknown amounts, grows like the distance. `ces_identify.validation.band` finds the weights on held-out data.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from itertools import chain, islice
from math import exp
from typing import Any

from ces_observer.flat import Layout
from ces_observer.json_text import JsonObject
from ces_observer.tick import band as tick
from ces_observer.tick.model import HAS_BAND

STATE = ("position", "speed", "current", "change of speed", "change of current")
PARTS = ("low_current_N", "high_current_N", "slow_N", "fast_N", "force", "change_of_force", "reversal_N")
LARGEST = 1e12  # of any number: far from where squares overflow
MAX_DISTANCE = 1e6


@dataclass(frozen=True)
class Band:
    """The half-width as a function of the state.

    A change is a signal minus its low-pass with time constant `change_s`. A reversal counts exp(-age / `reversal_s`).
    "Slow" is 1 / (1 + u) and "fast" is u = |speed| / `speed_m_s`; "high current" is the position of the current in its
    recorded range `current_A`, from 0 to 1, and "low current" 1 minus that. `parts` are the weights in the order of
    PARTS. The distance is the length of `whitening` (upper triangular, rows) times the state's deviation from `mean`,
    at most `max_distance`; `constant_share` is the share of the squared error that does not grow with it.
    """

    level: float
    change_s: float
    reversal_s: float
    speed_m_s: float
    current_A: tuple[float, float]
    parts: tuple[float, ...]
    mean: tuple[float, ...]
    whitening: tuple[tuple[float, ...], ...]
    max_distance: float
    constant_share: float

    def fill(self, layout: Layout, rate_Hz: float) -> None:
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

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the key `band` of a model file."""
        whitening = [number for row in self.whitening for number in row]
        return {**asdict(self), "parts": dict(zip(PARTS, self.parts, strict=True)), "whitening": whitening}

    @classmethod
    def from_json(cls, node: JsonObject) -> Band:
        """Check the key `band` of a model file; raises ModelError."""
        node.require_only_keys(*(one.name for one in fields(cls)))
        parts = node.at("parts")
        parts.require_only_keys(*PARTS)
        lengths = range(len(STATE), 0, -1)  # of the rows of an upper triangle, from the diagonal on
        triangle = iter(node.numbers("whitening", sum(lengths), LARGEST))
        return cls(
            level=node.number("level", 0.01, 0.9999),
            change_s=node.number("change_s", 1e-5, 1e3),
            reversal_s=node.number("reversal_s", 1e-5, 1e3),
            speed_m_s=node.number("speed_m_s", 1e-9, LARGEST),
            current_A=node.range("current_A", LARGEST),
            parts=tuple(parts.number(name, 0.0, LARGEST) for name in PARTS),
            mean=node.numbers("mean", len(STATE), LARGEST),
            whitening=tuple(tuple(islice(triangle, length)) for length in lengths),
            max_distance=node.number("max_distance", 0.0, MAX_DISTANCE),
            constant_share=node.number("constant_share", 0.0, 1.0),
        )
