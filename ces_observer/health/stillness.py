"""How long the position has read the very same number: a vehicle at rest, or a sensor that is stuck.

The position alone cannot tell the two apart, so nothing is withheld for it. A sensor whose noise is below its
resolution repeats itself at rest; one with more noise never does for long.
"""

from __future__ import annotations


class Stillness:
    """Rests of at least `warn_s` [s], by the positions' stamps; 0 stands for none.

    `count` and `last_s` [s] tell of the rests so far, `resting` whether one is under way.
    """

    def __init__(self, warn_s: float) -> None:
        self.warn_s = warn_s
        self._position_m: float | None = None
        self._since_ns = 0
        self.count = 0
        self.last_s = 0.0
        self.resting = False

    def take(self, stamp_ns: int, position_m: float) -> None:
        """Take a position sample [m]; one that is not a number ends a rest."""
        if position_m != self._position_m or stamp_ns < self._since_ns:
            self._position_m, self._since_ns, self.resting = position_m, stamp_ns, False
        elif self.resting or 0.0 < self.warn_s * 1e9 <= stamp_ns - self._since_ns:
            self.count += not self.resting
            self.resting = True
            self.last_s = (stamp_ns - self._since_ns) * 1e-9
