"""The commanded current as the valve's driver takes it: clipped, held, and safe when no command comes any more."""

from __future__ import annotations

from math import inf, isfinite


class Command:
    """Holds the last command inside `limits_A`; after `timeout_s` (0: never) without one the safe current holds."""

    def __init__(self, limits_A: tuple[float, float], safe_A: float, timeout_s: float) -> None:
        self._low, self._high = limits_A
        self.safe_A, self.timeout_s = safe_A, timeout_s
        self._value, self._since = 0.0, -inf
        self.refused = 0

    def set_current(self, current_A: float, time_s: float) -> None:
        """Take a command at a time of the rig; one that is no number is refused and counted."""
        if isfinite(current_A):
            self._value, self._since = current_A, time_s
        else:
            self.refused += 1

    def is_fresh(self, time_s: float) -> bool:
        """Tell whether a command holds."""
        age = time_s - self._since
        return age < inf and (self.timeout_s == 0.0 or age <= self.timeout_s)

    def at(self, time_s: float) -> float:
        """Return the current [A] that the driver sets."""
        current = self._value if self.is_fresh(time_s) else self.safe_A
        return min(max(current, self._low), self._high)
