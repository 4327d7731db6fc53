"""The ride of the reliability test: stroke and current over time, and the force of an undisturbed observer.

Stroke and current repeat every two seconds of the stamps' clock, and stamps are whole milliseconds, so that the force
at a stamp is known in advance, whatever happened before.
"""

from __future__ import annotations

from math import pi, sin

from ces_observer.estimator import Estimator
from ces_observer.model import Model

MS = 1_000_000  # [ns]
PERIOD_MS = 2000
RATE_HZ = 1000


def stroke_m(stamp_ns: int) -> float:
    """Return the position: 20 mm at 2 Hz and 1 mm at 12.5 Hz, at most 0.33 m/s."""
    time_s = stamp_ns % (PERIOD_MS * MS) * 1e-9
    return 0.02 * sin(2.0 * pi * 2.0 * time_s) + 0.001 * sin(2.0 * pi * 12.5 * time_s)


def current_A(stamp_ns: int) -> float:
    """Return the current, which is slow because its samples have no stamps and vary in age by a millisecond."""
    return 0.5 + 0.05 * sin(2.0 * pi * 0.5 * (stamp_ns % (PERIOD_MS * MS)) * 1e-9)


class TrueForce:
    """The force [N] by stamp of an estimator that received every sample."""

    def __init__(self, model: Model) -> None:
        estimator = Estimator(model)
        beginning = PERIOD_MS * (1 + int(model.sampling.warm_up_s * 1000 / PERIOD_MS))
        forces = [estimator.step(k * MS, stroke_m(k * MS), current_A(k * MS)) for k in range(beginning + 2 * PERIOD_MS)]
        self._forces = [force or 0.0 for force in forces[-PERIOD_MS:]]
        self.max_force_N = max(map(abs, self._forces))

    def force(self, stamp_ns: int) -> float:
        """Return the force at a stamp, between two milliseconds by interpolation."""
        position = stamp_ns % (PERIOD_MS * MS) / MS
        before = int(position)
        share = position - before
        return (1.0 - share) * self._forces[before] + share * self._forces[(before + 1) % PERIOD_MS]
