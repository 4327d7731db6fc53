"""One control loop: estimates, measured forces and time in, the current to command out.

It does not use ROS: stamps are integers, and the times of the node's clock and of a steady clock are arguments.
"""

from __future__ import annotations

from math import inf, isfinite, nan

from ces_observer.control.force_controller import NO_ESTIMATE, NOT_FINITE, STALE, ForceController

ESTIMATE, MEASURED, NONE = "estimate", "measured", "none"
FEEDBACKS = (ESTIMATE, MEASURED, NONE)


class ControlLoop:
    """A controller with its feedback, and a watch for estimates that stop or are stale.

    `feedback` is one of FEEDBACKS, `max_age_s` the largest difference between an estimate's stamp and the node's clock,
    in either direction (0: any). Estimates have stopped after `controller.tuning.max_gap_s` of steady time.
    """

    def __init__(self, controller: ForceController, feedback: str, max_age_s: float) -> None:
        self.controller = controller
        self.feedback = feedback
        self.max_age_s = max_age_s
        self.estimates = 0
        self.age_s = 0.0  # of the last estimate, on arrival
        self._last_estimate_s = self._commanded_s = -inf
        self._measured_N, self._measured_s = nan, -inf

    def restart(self) -> None:
        """Begin anew after an unexpected error: `watch` commands the safe current until an estimate is used again."""
        self.controller.reset()
        self._last_estimate_s = -inf
        self._measured_N, self._measured_s = nan, -inf

    def take_measured_force(self, force_N: float, steady_s: float) -> None:
        """Store a measured force; it is fed back for at most `max_gap_s`."""
        self._measured_N, self._measured_s = force_N, steady_s

    def take_estimate(self, stamp_ns: int, speed_m_s: float, force_N: float, now_ns: int, steady_s: float) -> float:
        """Return the current [A] to command for an estimate; `now_ns` is the node's clock, `steady_s` never jumps."""
        elapsed_s = self._measure_elapsed(steady_s)
        self.estimates += 1
        self._last_estimate_s = steady_s
        self.age_s = (now_ns - stamp_ns) * 1e-9
        if self.max_age_s > 0.0 and abs(self.age_s) > self.max_age_s:
            return self.controller.fail_safe(STALE, elapsed_s)
        if not isfinite(force_N):
            return self.controller.fail_safe(NOT_FINITE, elapsed_s)
        return self.controller.step(stamp_ns, speed_m_s, self._choose_feedback(force_N, steady_s))

    def watch(self, steady_s: float, ahead_s: float = 0.0) -> float | None:
        """Return the current [A] to command without an estimate, or None; the next call is `ahead_s` later."""
        if steady_s - self._last_estimate_s + ahead_s <= self.controller.tuning.max_gap_s:
            return None
        return self.controller.fail_safe(NO_ESTIMATE, self._measure_elapsed(steady_s))

    def _choose_feedback(self, estimated_N: float, steady_s: float) -> float:
        if self.feedback == ESTIMATE:
            return estimated_N
        fresh = steady_s - self._measured_s <= self.controller.tuning.max_gap_s
        return self._measured_N if self.feedback == MEASURED and fresh else nan

    def _measure_elapsed(self, steady_s: float) -> float:
        """Return the time [s] since the last command, at most `max_gap_s`, which limits the step of the command."""
        elapsed_s = min(steady_s - self._commanded_s, self.controller.tuning.max_gap_s)
        self._commanded_s = steady_s
        return elapsed_s
