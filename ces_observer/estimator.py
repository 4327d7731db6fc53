"""The estimator that rides on the vehicle: stamped position and current in, damping force out, or a reason why not.

It is driven by position samples alone, keeps no clock of its own, and gives the same forces in real time, in
simulated time and offline (`ces_identify.simulations.simulate.replayed_force` is its batch form).
"""

from __future__ import annotations

from math import inf, isfinite

from ces_observer.model import Model
from ces_observer.tracker import NOT_FINITE, OK, RESTARTED, UNSETTLED, Tracker

WARMING_UP = "warming up"
UNBOUNDED = "force left its envelope"


class Estimator:
    """Damping force of one damper, sample by sample.

    After `step`: `reason` is "ok" or why the force was withheld; `position` [m] and `speed` [m/s] are the filtered
    values at the last accepted sample, as the model used them; `clamped` tells whether the inputs lay outside what the
    model was identified on.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._tracker = Tracker(model.sampling)
        self._predictor = model.make_predictor()
        self._limits = model.force_envelope_N
        self._warm_up = round(model.sampling.warm_up_s * model.sampling.rate_Hz)
        self.reset()

    def reset(self) -> None:
        """Bring the estimator back to new."""
        self._tracker.reset()
        self._predictor.reset()
        self._wait = self._warm_up
        self._newest = self._previous = 0.0
        self.position = self.speed = 0.0
        self.reason = WARMING_UP

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the model's envelope and were clamped to it."""
        return self._predictor.clamped

    def step(self, stamp_ns: int, position_m: float, current_A: float) -> float | None:
        """Return the force [N] at `stamp_ns`, within the model's force envelope, or None with `reason` set.

        Bad samples count as missing.
        """
        if not isfinite(current_A):
            self.reason = NOT_FINITE
            return None
        outcome = self._tracker.advance(stamp_ns, position_m)
        if outcome == RESTARTED:
            self._predictor.reset()
            self._wait = self._warm_up
            self._newest = 0.0
        elif outcome not in (OK, UNSETTLED):
            self.reason = outcome
            return None
        force = self._run(current_A)
        if outcome == UNSETTLED and force is not None:
            self.reason = WARMING_UP
            return None
        return force

    def _run(self, current: float) -> float | None:
        tracker = self._tracker
        self.position, self.speed = tracker.position, tracker.speed
        for position, speed in tracker.ticks:
            self._wait -= 1
            force = self._predictor.tick(position, speed, current)
            if force == inf:
                self._give_up()
                return None
            self._previous, self._newest = self._newest, force
        if self._wait >= 0:
            self.reason = WARMING_UP
            return None
        self.reason = OK
        force = self._newest + (self._newest - self._previous) * tracker.ahead
        low, high = self._limits
        return low if force < low else high if force > high else force

    def _give_up(self) -> None:
        self._predictor.reset()
        self._wait = self._warm_up
        self._newest = self._previous = 0.0
        self.reason = UNBOUNDED
