"""The estimator: stamped position and current in; damping force, or the reason why there is none, out.

It is driven by position samples alone and has no clock, so its forces are the same in real time, in simulated time and
offline (`ces_identify.simulations.simulate.sample_run` is its batch form).

A model with a delay estimates the force of a sample when the speed is known better, so many ticks later. Its estimates
come out in `late`, each with the stamp of the sample that it belongs to: the first sample of every tick. A model file
may hold a model without a delay and one with; both share the tracker.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from math import inf, isfinite
from typing import NamedTuple

from ces_observer.band import BandRun
from ces_observer.model import Model
from ces_observer.tracker import NOT_FINITE, OK, RESTARTED, UNSETTLED, Tick, Tracker

WARMING_UP = "warming up"
UNBOUNDED = "force is not finite"


class LateEstimate(NamedTuple):
    """The estimate of an earlier sample, now that its speed is known; `half_width` [N] is None without a band."""

    stamp_ns: int
    position: float
    speed: float
    force: float
    half_width: float | None


class ForceRun:
    """The free run of a model with its band and warm-up; `reason` is "ok" or why it has no force."""

    def __init__(self, model: Model) -> None:
        self.predictor = model.make_predictor()
        self._tick = self.predictor.tick
        self._band = None if model.band is None else BandRun(model.band, model.sampling.rate_Hz)
        self._low, self._high = model.force_envelope_N
        self._warm_up = round(model.sampling.warm_up_s * model.sampling.rate_Hz)
        self.restart()

    def restart(self) -> None:
        """Forget the past, and warm up."""
        self.predictor.reset()
        if self._band is not None:
            self._band.reset()
        self._wait = self._warm_up
        self._newest = self._previous = 0.0
        self.reason = WARMING_UP

    def advance(self, ticks: Iterable[Tick], current: float, ahead: float) -> float | None:
        """Run ticks and return the force [N] `ahead` ticks after the last, within the force envelope.

        None in the warm-up, or after a force that is not finite: then the run restarts. Without ticks, nothing changes.
        """
        for position, speed in ticks:
            self._wait -= 1
            force = self._tick(position, speed, current)
            if force == inf:
                self.restart()
                self.reason = UNBOUNDED
                return None
            self._previous, self._newest = self._newest, force
            if self._band is not None:
                self._band.tick(position, speed, current, force)
        if self._wait >= 0:
            self.reason = WARMING_UP
            return None
        self.reason = OK
        force = self._newest + (self._newest - self._previous) * ahead
        return self._low if force < self._low else self._high if force > self._high else force

    def half_width(self) -> float | None:
        """Return the half-width [N] of the band at the last tick; None without one, or if it is not finite."""
        if self._band is None:
            return None
        width = self._band.half_width()
        return width if isfinite(width) else None


class Estimator:
    """Estimates the force of one damper, sample by sample.

    After `step`: `reason` is "ok" or why the force was withheld, and `cause` what a warm-up is for; `position` [m] and
    `speed` [m/s] are those at the last accepted sample; `late` holds the estimates that have become known.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        delay = model.best.sampling.delay_ticks
        self._own = ForceRun(model)
        self.predictor = self._own.predictor
        self._now = None if model.sampling.delay_ticks else self._own
        self._late = None if delay == 0 else ForceRun(model.delayed) if model.delayed else self._own
        self._tracker = Tracker(model.best.sampling)
        self._waiting: deque[tuple[int | None, float, float]] = deque(
            maxlen=delay + 1
        )  # stamp, current, ahead of ticks
        self._tick_s = 1.0 / model.sampling.rate_Hz
        self.delay_ns = round(delay * self._tick_s * 1e9)
        self.reset()

    def reset(self) -> None:
        """Bring the estimator back to new."""
        self._tracker.reset()
        self._restart_models()
        self.late: list[LateEstimate] = []
        self.position = self.speed = 0.0
        self.reason, self.cause = WARMING_UP, ""

    def _restart_models(self) -> None:
        self._waiting.clear()
        for run in (self._now, self._late):
            if run is not None:
                run.restart()

    @property
    def is_warm(self) -> bool:
        """True if `step` has just given all forces that the model estimates."""
        return self.reason == OK and (self._late is None or bool(self.late))

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the envelope; they were clamped, unless the structure extrapolates."""
        return self._own.predictor.clamped

    @property
    def held(self) -> bool:
        """True if the last force lay outside the force envelope and was held at its end."""
        return self._own.predictor.held

    def half_width(self) -> float | None:
        """Return the half-width [N] of the band around the force that `step` has just returned, None without one."""
        return None if self._now is None else self._now.half_width()

    def skip_late(self, until_ns: int) -> None:
        """Give no estimates in `late` up to this stamp: another estimator has given them."""
        self.late = [one for one in self.late if one.stamp_ns > until_ns]
        for i, (stamp_ns, current, ahead) in enumerate(self._waiting):
            if stamp_ns is not None and stamp_ns <= until_ns:
                self._waiting[i] = None, current, ahead

    def step(self, stamp_ns: int, position_m: float, current_A: float, motion: float = 0.0) -> float | None:
        """Return the force [N] at `stamp_ns`, within the model's force envelope, or None with `reason` set.

        `motion` is the signal `model.sampling.motion`, if the model needs one. Bad samples count as missing. With only
        a delayed model there is no force at once: the reason is "ok" while `late` has those of earlier samples.
        """
        if self.late:
            self.late = []
        if not isfinite(current_A):
            self.reason = NOT_FINITE
            return None
        tracker = self._tracker
        outcome = tracker.advance(stamp_ns, position_m, motion)
        if outcome != OK:
            if outcome not in (RESTARTED, UNSETTLED):
                self.reason = outcome
                return None
            self.cause = outcome
            if outcome == RESTARTED:
                self._restart_models()
        self.position, self.speed = tracker.position, tracker.speed
        if self._late is not None and tracker.late_ticks:
            for known in tracker.late_ticks[:-1]:  # lost
                self._run_late(self._late, known, None, current_A)
            self._run_late(self._late, tracker.late_ticks[-1], None if outcome == UNSETTLED else stamp_ns, current_A)
        force = None if self._now is None else self._now.advance(tracker.ticks, current_A, tracker.ahead)
        self.reason = self._own.reason
        if outcome == UNSETTLED and self.reason == OK:
            self.reason, force = WARMING_UP, None
        elif self.reason == UNBOUNDED:
            self.cause = UNBOUNDED
        return force

    def _run_late(self, run: ForceRun, known: Tick | None, stamp_ns: int | None, current: float) -> None:
        """Run the tick that is known now, when a newer one with this stamp and current begins."""
        self._waiting.append((stamp_ns, current, self._tracker.ahead))
        if known is None:
            return
        stamp, its_current, ahead = self._waiting[0]
        force = run.advance((known,), its_current, ahead)
        if force is not None and stamp is not None:
            position, speed = known
            position += ahead * self._tick_s * speed
            self.late.append(LateEstimate(stamp, position, speed, force, run.half_width()))
