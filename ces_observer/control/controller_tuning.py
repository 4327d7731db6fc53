"""The settings of the force controller that may change while it runs: current limits, gains and times."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from ces_observer.errors import CesError


@dataclass(frozen=True)
class Tuning:
    """Settings of a ForceController, which explains them; raises CesError for values that cannot be used."""

    low_A: float  # [A] of every command
    high_A: float  # [A] of every command
    safe_A: float  # [A] commanded without a usable estimate; within the limits
    rate_A_s: float = 100.0  # [A/s] fastest change of the command
    loop_gain_1_s: float = 4.0  # [1/s] of the feedback; 0: feed-forward alone
    settle_m: float = 0.003  # [m] stroke after a reversal from which the force is fed back
    valve_lag_s: float = 0.008  # [s] of the force behind the current; 0: no lead
    preview_s: float = 0.006  # [s] by which the feed-forward predicts the speed; 0: no prediction
    lead_filter_s: float = 0.003  # [s] of both leads
    recovery_s: float = 0.2  # [s] of fading in, at the start and after an interruption
    max_gap_s: float = 0.05  # [s] between stamps; a longer gap is an interruption

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isfinite(value):
                raise CesError(f"{name} is {value}; expected a finite number")
            if value < 0.0 and name not in ("low_A", "high_A", "safe_A"):
                raise CesError(f"{name} is {value:g}; expected at least 0")
        if not self.low_A < self.high_A:
            raise CesError(f"low_A is {self.low_A:g} and high_A {self.high_A:g}; expected the lower limit first")
        if not self.low_A <= self.safe_A <= self.high_A:
            raise CesError(f"safe_A is {self.safe_A:g}; expected it within {self.low_A:g} to {self.high_A:g} A")
        if self.rate_A_s == 0.0 or self.max_gap_s == 0.0:
            raise CesError("rate_A_s or max_gap_s is 0; expected numbers above 0")

    @staticmethod
    def lead_s(model_lag_s: float, preview_s: float) -> float:
        """Return the `valve_lag_s` [s] for a model with this lag of force behind current: the lag minus the preview.

        A lead by the whole lag gains little: the limits clip it unevenly, which shifts the mean current.
        """
        return max(model_lag_s - preview_s, 0.0)

    def clip_current(self, current_A: float) -> float:
        """Return the current [A] within the limits."""
        return min(max(current_A, self.low_A), self.high_A)
