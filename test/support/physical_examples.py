"""A valve path of the size that identification gives, with round numbers."""

from ces_observer.structures.curves import IncreasingCurve
from ces_observer.structures.hydraulic import ValvePath

CHARACTERISTIC = IncreasingCurve((0.1, 0.25, 0.4, 0.55, 0.7, 0.9), (0.0, 0.1, 0.25, 0.5, 0.75, 1.0))


def make_valve(delay_ticks: float = 0.0, hysteresis_A: float = 0.02) -> ValvePath:
    return ValvePath(CHARACTERISTIC, delay_ticks, hysteresis_A, rise_s=8e-3, fall_s=5e-3)
