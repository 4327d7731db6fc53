"""The band of a model: how far the measured force may lie from the estimate, tick by tick.

Position, speed, current and estimated force of each tick go in; the half-width [N] of the band comes out. Estimate plus
and minus half-width contain the measured force, sensor noise included, at `level` of the ticks. The half-width is

    growth * sum of weights * (low current, high current, slow, fast, |force|, |change of force|, recent reversal)

with growth^2 = share + (1 - share) * distance^2. The distance is that of position, speed, current and the recent
changes of speed and current from the recordings that the model was identified on (Mahalanobis, 1 in the root mean
square over them): an error that depends linearly on the state, by unknown amounts, grows like the distance.
`ces_identify.validation.band` finds the weights on held-out data.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from itertools import islice
from math import exp, sqrt
from typing import Any

from ces_observer.json_text import JsonObject

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


class BandRun:
    """The band along a run: `tick` for each tick, then `half_width` if it is wanted."""

    def __init__(self, band: Band, rate_Hz: float) -> None:
        self._band = band
        self._gain = 1.0 - exp(-1.0 / (band.change_s * rate_Hz))
        self._fade = exp(-1.0 / (band.reversal_s * rate_Hz))
        self._low_A = band.current_A[0]
        span = band.current_A[1] - band.current_A[0]
        self._per_A = 1.0 / span if span > 0.0 else 0.0
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._started = False
        self._position = self._speed = self._current = self._force = self._reversal = 0.0
        self._mean_speed = self._mean_current = self._mean_force = 0.0

    def tick(self, position: float, speed: float, current: float, force: float) -> None:
        """Take a tick's inputs [m, m/s, A] and estimated force [N]."""
        if self._started:
            gain = self._gain
            self._mean_speed += gain * (speed - self._mean_speed)
            self._mean_current += gain * (current - self._mean_current)
            self._mean_force += gain * (force - self._mean_force)
            self._reversal = 1.0 if speed * self._speed <= 0.0 else self._reversal * self._fade
        else:
            self._started, self._reversal = True, 1.0
            self._mean_speed, self._mean_current, self._mean_force = speed, current, force
        self._position, self._speed, self._current, self._force = position, speed, current, force

    def half_width(self) -> float:
        """Return the half-width [N] at the last tick; not finite only after inputs beyond any damper's."""
        band, current = self._band, self._current
        low_A, high_A, slow, fast, force, change, reversal = band.parts
        high = (current - self._low_A) * self._per_A
        high = 0.0 if high < 0.0 else 1.0 if high > 1.0 else high
        u = abs(self._speed) / band.speed_m_s
        width = (
            low_A * (1.0 - high)
            + high_A * high
            + slow / (1.0 + u)
            + fast * u
            + force * abs(self._force)
            + change * abs(self._force - self._mean_force)
            + reversal * self._reversal
        )
        return width * self._growth()

    def _growth(self) -> float:
        mean = self._band.mean
        (a0, a1, a2, a3, a4), (b1, b2, b3, b4), (c2, c3, c4), (d3, d4), (e4,) = self._band.whitening
        z0 = self._position - mean[0]
        z1 = self._speed - mean[1]
        z2 = self._current - mean[2]
        z3 = self._speed - self._mean_speed - mean[3]
        z4 = self._current - self._mean_current - mean[4]
        a = a0 * z0 + a1 * z1 + a2 * z2 + a3 * z3 + a4 * z4
        b = b1 * z1 + b2 * z2 + b3 * z3 + b4 * z4
        c = c2 * z2 + c3 * z3 + c4 * z4
        d = d3 * z3 + d4 * z4
        e = e4 * z4
        square = a * a + b * b + c * c + d * d + e * e
        limit, share = self._band.max_distance, self._band.constant_share
        return sqrt(share + (1.0 - share) * min(square, limit * limit))
