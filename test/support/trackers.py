"""The tick's tracker as an object, for tests: samples in; its ticks as pairs of position [m] and speed [m/s], out."""

from __future__ import annotations

from ces_observer.core import bind, floats, ints
from ces_observer.model import Sampling
from ces_observer.reasons import REASONS
from ces_observer.sampling_layout import layout_of
from ces_observer.tick import bank, tracker

Tick = tuple[float, float]


class Tracker:
    """Uniform ticks from position samples; `arrays` are its p, n, s and k."""

    def __init__(self, sampling: Sampling) -> None:
        p, n, s, k = layout_of(sampling).arrays()
        self.arrays = floats(p), ints(n), floats(s), ints(k)
        _, self.n, self.s, self.k = self.arrays
        self.reset = bind(tracker.tracker_reset, *self.arrays)
        self._advance = bind(tracker.tracker_advance, *self.arrays)
        self.reset()

    def advance(self, stamp_ns: int, position: float, motion: float = 0.0) -> str:
        """Process a sample; return OK or a reason."""
        return REASONS[self._advance(stamp_ns, position, motion)]

    @property
    def ticks(self) -> list[Tick]:
        """The ticks that the last sample has completed."""
        s, count = self.s, self.k[tracker.TICKS]
        x, v = s[tracker.OLD_POSITION], s[tracker.OLD_SPEED]
        new = s[bank.BANK_POSITION], s[bank.BANK_SPEED]
        between = [(x + i / count * (new[0] - x), v + i / count * (new[1] - v)) for i in range(1, count)]
        return [*between, new] if count else []

    @property
    def late_ticks(self) -> list[Tick | None]:
        """What is known now of the ticks a delay before them; None before the first tick."""
        at, known = self.n[tracker.LATE_AT], self.n[tracker.LATE_KNOWN]
        return [
            (self.s[at + 2 * i], self.s[at + 2 * i + 1]) if self.k[known + i] else None
            for i in range(self.k[tracker.LATE_TICKS])
        ]

    @property
    def ahead(self) -> float:
        """The last accepted sample's time after the last tick [ticks]."""
        return self.s[tracker.AHEAD]

    @property
    def position(self) -> float:
        """The position [m] at the last accepted sample."""
        return self.s[tracker.TRACK_POSITION]

    @property
    def speed(self) -> float:
        """The speed [m/s] at the last accepted sample."""
        return self.s[tracker.TRACK_SPEED]
