"""The estimator: stamped position and current in; damping force, or the reason why there is none, out.

It is driven by position samples alone and has no clock, so its forces are the same in real time, in simulated time and
offline (`ces_identify.simulations.simulate.replayed_force` is its batch form).
"""

from __future__ import annotations

from math import inf, isfinite

from ces_observer.band import BandRun
from ces_observer.model import Model
from ces_observer.tracker import NOT_FINITE, OK, RESTARTED, UNSETTLED, Tracker

WARMING_UP = "warming up"
UNBOUNDED = "force left its envelope"


class Estimator:
    """Estimates the force of one damper, sample by sample.

    After `step`: `reason` is "ok" or why the force was withheld; `position` [m] and `speed` [m/s] are the filtered
    values at the last accepted sample, as the model used them.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._tracker = Tracker(model.sampling)
        self._predictor = model.make_predictor()
        self._band = None if model.band is None else BandRun(model.band, model.sampling.rate_Hz)
        self._limits = model.force_envelope_N
        self._warm_up = round(model.sampling.warm_up_s * model.sampling.rate_Hz)
        self.reset()

    def reset(self) -> None:
        """Bring the estimator back to new."""
        self._tracker.reset()
        self._restart_model()
        self.position = self.speed = 0.0
        self.reason = WARMING_UP

    def _restart_model(self) -> None:
        self._predictor.reset()
        if self._band is not None:
            self._band.reset()
        self._wait = self._warm_up
        self._newest = self._previous = 0.0

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the envelope; they were clamped, unless the structure extrapolates."""
        return self._predictor.clamped

    def half_width(self) -> float | None:
        """Return the half-width [N] of the band around the force that `step` has just returned.

        None if the model has no band or the inputs are beyond any damper's.
        """
        width = inf if self._band is None else self._band.half_width()
        return width if isfinite(width) else None

    def step(self, stamp_ns: int, position_m: float, current_A: float, motion: float = 0.0) -> float | None:
        """Return the force [N] at `stamp_ns`, within the model's force envelope, or None with `reason` set.

        `motion` is the signal `model.sampling.motion_signal`, if the model needs one. Bad samples count as missing.
        """
        if not isfinite(current_A):
            self.reason = NOT_FINITE
            return None
        outcome = self._tracker.advance(stamp_ns, position_m, motion)
        if outcome == RESTARTED:
            self._restart_model()
        elif outcome not in (OK, UNSETTLED):
            self.reason = outcome
            return None
        force = self._run(current_A)
        if outcome == UNSETTLED and force is not None:
            self.reason = WARMING_UP
            return None
        return force

    def _run(self, current: float) -> float | None:
        tracker, band = self._tracker, self._band
        self.position, self.speed = tracker.position, tracker.speed
        for position, speed in tracker.ticks:
            self._wait -= 1
            force = self._predictor.tick(position, speed, current)
            if force == inf:
                self._restart_model()
                self.reason = UNBOUNDED
                return None
            self._previous, self._newest = self._newest, force
            if band is not None:
                band.tick(position, speed, current, force)
        if self._wait >= 0:
            self.reason = WARMING_UP
            return None
        self.reason = OK
        force = self._newest + (self._newest - self._previous) * tracker.ahead
        low, high = self._limits
        return low if force < low else high if force > high else force
