"""The controller reg1 of the thesis, as a kind of current: it answers the damper's force."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import copysign

from ces_data.waveforms import currents
from ces_data.waveforms.currents import HIGH, LOW, require_range
from ces_data.waveforms.sequences import Current
from ces_observer.control.force_controller import CurveError, ForceCurve
from ces_observer.fields import Field
from ces_observer.records import OneOf, quantity
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
        require_range(self.low_A, self.high_A)
        try:
            self.reference  # noqa: B018
        except CurveError as error:
            raise RigError(str(error)) from None

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


KINDS = {**currents.KINDS, "reg1": Reg1}
CURRENT = Field(kind=OneOf(KINDS))


def make_current(description: object, where: str) -> Current | Reg1:
    """Return the current of the description `{kind: …, its parameters}`; raises RigError."""
    current: Current | Reg1 = CURRENT.check(description, where, RigError)
    return current
