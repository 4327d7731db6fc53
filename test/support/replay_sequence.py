"""Sequences of samples, and what the observer in Python makes of them, for the program `replay` in C++.

`ReplaySequence` feeds a `DamperObserver` as the node does. It records each event as a line for `replay`, and each
answer as `replay` prints it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, nan, pi, sin
from pathlib import Path
from random import Random

from ces_observer.current_hold import CurrentHold
from ces_observer.damper_observer import DamperObserver
from ces_observer.intake import Intake
from ces_observer.model import Model
from ces_observer.signals import MOTIONS

START_NS = 1_000_000_000_000
MS = 1_000_000
CURRENT_EVERY = 5  # positions
MAX_SAMPLES = 6000
WAIT_S = 0.02
MAX_AGE_S = 0.5
NO_WIDTH = -1.0
FAR_M = (0.03, 100.0)  # of a position that is an outlier or beyond the stroke
OFF_CLOCK_NS = round(1.2e9 * MAX_AGE_S)
KINDS = {"speed": "v", "acceleration": "a"}  # of an event


class ReplaySequence:
    """Events and answers; positions wait for their current at most `wait_s`, `max_age_s` is as in the node."""

    def __init__(self, model: Model, wait_s: float = WAIT_S, max_age_s: float = MAX_AGE_S) -> None:
        current = CurrentHold(model.sampling.max_current_age_s)
        self.damper = DamperObserver(model, current, max_age_s, {name: CurrentHold(1.0) for name in MOTIONS})
        self._intake = Intake(self.damper, self._on_estimate)
        self._intake.set_wait(wait_s)
        self.events = [f"settings {wait_s!r} {max_age_s!r}"]
        self.answers: list[str] = []

    def load(self, model: Model, path: Path, now_ns: int) -> None:
        """Let another model take over, which is in a flat file."""
        self.damper.load(model)
        self.events.append(f"n 0 0 {now_ns} {path}")

    def take_current(self, stamp_ns: int, current_A: float, now_ns: int) -> None:
        """Add a current."""
        self._record("c", stamp_ns, current_A, now_ns)
        self._intake.take_current(stamp_ns, current_A, now_ns)

    def take_motion(self, stamp_ns: int, value: float, now_ns: int) -> None:
        """Add the speed or acceleration, if the running model needs one."""
        if motion := self.damper.motion_name:
            self._record(KINDS[motion], stamp_ns, value, now_ns)
            self._intake.take_motion(motion, stamp_ns, value, now_ns)

    def take_position(self, stamp_ns: int, position_m: float, now_ns: int) -> None:
        """Add a position."""
        self._record("p", stamp_ns, position_m, now_ns)
        self._intake.take_position(stamp_ns, position_m, b"", now_ns)

    def watch(self, now_ns: int) -> None:
        """Release positions that have waited for long enough."""
        self._record("w", 0, 0.0, now_ns)
        self._intake.release(now_ns)

    def reset(self, now_ns: int) -> None:
        """Restart, as after a time jump."""
        self._record("r", 0, 0.0, now_ns)
        self._intake.reset(now_ns)

    def report_silence(self, now_ns: int) -> None:
        """Report that no position has come for too long."""
        self._record("s", 0, 0.0, now_ns)
        self.damper.report_silence()

    def explain(self) -> None:
        """Record the present reason with its details."""
        self._record("d", 0, 0.0, 0)
        self.answers.append(f"d {self.damper.reason}: {self.damper.explain()}")

    def _record(self, kind: str, stamp_ns: int, value: float, now_ns: int) -> None:
        self.events.append(f"{kind} {stamp_ns} {value!r} {now_ns}")

    def _on_estimate(self, stamp_ns: int, frame: bytes, force: float | None) -> None:
        damper = self.damper
        if force is not None:
            self._answer("e", stamp_ns, damper.position, damper.speed, force, damper.half_width())
        for one in damper.late:
            self._answer("l", *one)
        counts, digest = damper.tally, damper.model.digest()[:8]
        self.answers.append(f"x {counts.clamped} {counts.held} {counts.late} {digest} {damper.reason}")

    def _answer(self, kind: str, stamp_ns: int, *numbers: float | None) -> None:
        texts = (f"{NO_WIDTH if number is None else number:.17g}" for number in numbers)
        self.answers.append(f"{kind} {stamp_ns} {' '.join(texts)}")


@dataclass(frozen=True)
class _Ride:
    """A stroke through most of a model's envelope, and its current, as functions of the time [s]."""

    model: Model

    def position(self, time_s: float) -> float:
        (low, high), amplitude = self.model.envelope.position_m, self._amplitude
        return 0.5 * (low + high) + amplitude * (0.8 * sin(self._rate * time_s) + 0.2 * sin(3.7 * self._rate * time_s))

    def current(self, time_s: float) -> float:
        low, high = self.model.envelope.current_A
        return 0.5 * (low + high) + 0.5 * (high - low) * sin(3.0 * time_s)

    def motion(self, time_s: float) -> float:
        """Return the speed [m/s] or acceleration [m/s2]."""
        step = 1e-4
        before, at, after = (self.position(time_s + k * step) for k in (-1, 0, 1))
        if self.model.sampling.motion == "speed":
            return (after - before) / (2.0 * step)
        return (after - 2.0 * at + before) / step**2

    @property
    def _amplitude(self) -> float:
        low, high = self.model.envelope.position_m
        return 0.4 * (high - low)

    @property
    def _rate(self) -> float:
        """Angular frequency [rad/s] at which the speed uses its envelope, at most 5 Hz."""
        low, high = self.model.envelope.speed_m_s
        return min(0.4 * (high - low) / max(self._amplitude, 1e-9), 10.0 * pi)


def record_faults(model: Model) -> ReplaySequence:
    """Return a sequence with jitter, losses, wrong stamps and numbers, late currents and restarts."""
    sequence, ride, chance = ReplaySequence(model), _Ride(model), Random(1)
    sampling = model.sampling
    warm_up_s = sampling.warm_up_s + 0.1
    restarts_s = (warm_up_s + 0.8, 2.0 * warm_up_s + 1.2)
    pause_s = (0.4 + warm_up_s, min(0.5 + warm_up_s + sampling.max_current_age_s, restarts_s[0]))  # of the current
    period_ns = round(1e9 / sampling.rate_Hz)
    count = min(MAX_SAMPLES, round((restarts_s[1] + warm_up_s + 0.2) * sampling.rate_Hz))
    gap_ns = round(sampling.max_gap_s * 1e9) + 2 * period_ns
    shift_ns, reset = 0, False
    for k in range(count):
        time_s = k / sampling.rate_Hz
        if shift_ns == 0 and time_s >= restarts_s[0]:
            shift_ns = gap_ns
            sequence.report_silence(START_NS)
        if not reset and time_s >= restarts_s[1]:
            reset = True
            sequence.reset(START_NS + k * period_ns + shift_ns)
        stamp_ns = START_NS + k * period_ns + shift_ns + chance.randrange(-period_ns // 3, period_ns // 3)
        _feed(sequence, ride, chance, k, time_s, stamp_ns, pauses=pause_s[0] <= time_s < pause_s[1])
    sequence.watch(START_NS + count * period_ns + shift_ns + 10**9)
    sequence.explain()
    return sequence


def _feed(
    sequence: ReplaySequence, ride: _Ride, chance: Random, k: int, time_s: float, stamp_ns: int, *, pauses: bool
) -> None:
    """Feed the samples of one period, some of them wrong."""
    now_ns = stamp_ns + chance.randrange(MS)
    if k % 40 == 39:
        sequence.watch(now_ns)
    currents = chance.random() >= 0.03 and not pauses
    late = chance.random() < 0.2
    if currents and k % CURRENT_EVERY == 0 and not late:
        sequence.take_current(stamp_ns, _spoil(ride.current(time_s), chance), now_ns)
    if chance.random() < 0.98:
        sequence.take_motion(stamp_ns, ride.motion(time_s), now_ns)
    for stamp, position, now in _positions(ride.position(time_s), chance, stamp_ns, now_ns):
        sequence.take_position(stamp, position, now)
    if currents and k % CURRENT_EVERY == 0 and late:
        sequence.take_current(stamp_ns + MS // 2, ride.current(time_s), now_ns + MS)
    if sequence.damper.reason != "ok" and chance.random() < 0.1:
        sequence.explain()


def _positions(position_m: float, chance: Random, stamp_ns: int, now_ns: int) -> Iterator[tuple[int, float, int]]:
    """Yield the positions that arrive for one: mostly itself; or none, a repeated, late, spoilt or old one."""
    dice = chance.random()
    if dice < 0.005:
        return
    if dice < 0.01:
        position_m += chance.choice(FAR_M)
    elif dice < 0.02:
        now_ns += OFF_CLOCK_NS
    yield stamp_ns, _spoil(position_m, chance), now_ns
    if dice > 0.99:
        yield stamp_ns, position_m, now_ns
    elif dice > 0.98:
        yield stamp_ns - 3 * MS, position_m, now_ns


def _spoil(value: float, chance: Random) -> float:
    """Return the value, rarely one that is not finite."""
    return chance.choice((nan, inf, -inf)) if chance.random() < 0.003 else value
