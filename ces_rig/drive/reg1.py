"""`reg1`, a controller closed over the damper: measured stroke and force go in, the valve's current comes out.

In the thesis reg1 is Öhlins' present control solution, connected to the damper during the experiments (section 3.3);
its reference is a curve of force over speed (fig. 5.1b), and it uses 0.29 to 0.7 A, a small segment of the allowed
range (section 5.1). Its law, curve and gains, and whether it measures the force, are not stated. Those here were chosen
for this rig: a PI controller of the measured force,

    i = middle + gain * (e + integral of e / reset),   e = sign(v) * (curve(v) - force),

limited to the range, its integral held at the limits. More current means more damping in both directions, hence the
sign of the speed v, which is the slope of the stroke behind a first-order filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import copysign

from ces_observer.control.force_curve import CurveError, ForceCurve
from ces_rig.descriptions import quantity
from ces_rig.drive.working_range import HIGH, LOW
from ces_rig.errors import RigError

SPEEDS_M_S = (-0.6, -0.4, -0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2, 0.4, 0.6)
FORCES_N = (-2150.0, -2000.0, -1750.0, -1400.0, -900.0, 0.0, 400.0, 600.0, 760.0, 900.0, 1000.0)


@dataclass(frozen=True)
class Reg1:
    """The controller's settings; raises RigError for a reference that is not a curve of a damper."""

    low_A: float = quantity(LOW, "A", "lower end", 0.0, 10.0)
    high_A: float = quantity(HIGH, "A", "upper end", 0.0, 10.0)
    speeds_m_s: tuple[float, ...] = quantity(SPEEDS_M_S, "m/s", "speeds of the reference's points")
    forces_N: tuple[float, ...] = quantity(FORCES_N, "N", "forces of the reference's points")
    gain_A_N: float = quantity(1.5e-4, "A/N", "proportional gain", 0.0, 1.0)
    reset_s: float = quantity(0.010, "s", "reset time of the integral", 1e-4, 1e3)
    filter_s: float = quantity(0.002, "s", "time constant of the speed's filter", 0.0, 1.0)

    def __post_init__(self) -> None:
        try:
            self.reference  # noqa: B018
        except CurveError as error:
            raise RigError(f"reg1: {error}") from None

    @cached_property
    def reference(self) -> ForceCurve:
        """The desired force over speed."""
        return ForceCurve(self.speeds_m_s, self.forces_N)


class SpeedForceLoop:
    """The controller at work, stepped every `interval_s`; it begins at rest in the middle of the range."""

    def __init__(self, settings: Reg1, interval_s: float, stroke_m: float) -> None:
        self.settings, self.interval_s = settings, interval_s
        self.speed_m_s = 0.0
        self.current_A = self._integral_A = (settings.low_A + settings.high_A) / 2
        self._stroke_m = stroke_m

    def step(self, stroke_m: float, force_N: float) -> float:
        """Return the current [A] that answers a sample of stroke and force."""
        reg1, step = self.settings, self.interval_s
        slope = (stroke_m - self._stroke_m) / step
        self._stroke_m = stroke_m
        self.speed_m_s += (slope - self.speed_m_s) * step / (step + reg1.filter_s)
        error = copysign(1.0, self.speed_m_s) * (reg1.reference.at(self.speed_m_s) - force_N)
        change = reg1.gain_A_N * error * step / reg1.reset_s
        wanted = self._integral_A + change + reg1.gain_A_N * error
        self.current_A = min(max(wanted, reg1.low_A), reg1.high_A)
        if wanted == self.current_A or (wanted - self.current_A) * change < 0.0:
            self._integral_A += change
        return self.current_A
