"""The tick's tracker and bank as objects, for tests: samples in; positions [m] and speeds [m/s] of ticks out."""

from __future__ import annotations

from functools import partial

from ces_observer.bank_design import ACCELERATION, ORDER, BankSettings
from ces_observer.core import bind, floats, ints
from ces_observer.estimator import fill_bank, layout_of
from ces_observer.flat import ArrayLayout
from ces_observer.model import Sampling
from ces_observer.reasons import REASONS
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


class Bank:
    """A bank alone; `size` is the number of states of a mode."""

    def __init__(self, stroke: BankSettings, delay: int = 0) -> None:
        layout = ArrayLayout(bank.P_TRACKER, bank.N_TRACKER, bank.S_TRACKER, bank.K_TRACKER)
        fill_bank(layout, stroke, delay)
        arrays = layout.arrays()
        _, self.n, self.s, self.k = arrays
        self.size = ORDER + (stroke.motion == ACCELERATION)
        self.coast = partial(bank.bank_coast, *arrays)
        self._reset, self._update = partial(bank.bank_reset, *arrays), partial(bank.bank_update, *arrays)
        self.save, self.restore = (partial(f, *arrays[1:]) for f in (bank.bank_save, bank.bank_restore))
        self.reset(0.0)

    def reset(self, position: float, speed: float = 0.0) -> None:
        """Restart at a position with a constant speed."""
        self._reset(position, speed)

    def update(self, ticks: int, position: float, shift: float, motion: float = 0.0) -> None:
        """Advance to the next tick, `ticks` after the last measured one, and take its measurement."""
        self._update(ticks, position, shift, motion)

    @property
    def modes(self) -> list[list[float]]:
        """The states of all modes."""
        begins = (self.n[bank.MODE_STATES] + i * bank.MODE_WIDTH for i in range(self.n[bank.MODES]))
        return [list(self.s[begin : begin + self.size]) for begin in begins]

    def set_mode(self, states: list[float]) -> None:
        """Set the states of the first mode."""
        begin = self.n[bank.MODE_STATES]
        self.s[begin : begin + self.size] = states

    @property
    def mean(self) -> tuple[float, float, float, float]:
        """Position and speed at the newest tick, and as predicted for the next one."""
        return tuple(self.s[bank.BANK_POSITION : bank.NEXT_SPEED + 1])

    @property
    def position(self) -> float:
        """The position at the newest tick."""
        return self.s[bank.BANK_POSITION]

    @property
    def speed(self) -> float:
        """The speed at the newest tick."""
        return self.s[bank.BANK_SPEED]

    @property
    def late(self) -> Tick | None:
        """Position and speed a delay ago as they are known now; None until the bank has run for so long."""
        known = 0 < self.n[bank.DELAY] <= self.k[bank.BANK_TICKS]
        return (self.s[bank.LATE_POSITION], self.s[bank.LATE_SPEED]) if known else None
