"""Rests: how long the position has had exactly the same value, because the vehicle rests or the sensor is stuck.

The position alone cannot distinguish the two, so no force is withheld. At rest, a sensor whose noise is below its
resolution repeats its value; one with more noise does not for long.
"""

from __future__ import annotations


class Stillness:
    """Rests of at least `warn_s` [s] of the positions' stamps; with 0 there are none.

    `count` is the number of rests, `last_s` [s] the length of the last one, `resting` True during a rest.
    """

    def __init__(self, warn_s: float) -> None:
        self.warn_s = warn_s
        self._position_m: float | None = None
        self._since_ns = 0
        self.count = 0
        self.last_s = 0.0
        self.resting = False

    def take(self, stamp_ns: int, position_m: float) -> None:
        """Add a position sample [m]; NaN ends a rest."""
        if position_m != self._position_m or stamp_ns < self._since_ns:
            self._position_m, self._since_ns, self.resting = position_m, stamp_ns, False
        elif self.resting or 0.0 < self.warn_s * 1e9 <= stamp_ns - self._since_ns:
            self.count += not self.resting
            self.resting = True
            self.last_s = (stamp_ns - self._since_ns) * 1e-9
