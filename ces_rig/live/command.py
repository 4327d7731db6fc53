"""The commanded current in the valve's driver: clipped, held, and replaced by a safe current when commands stop."""

from __future__ import annotations

from math import inf, isfinite


class Command:
    """Holds the last command inside `limits_A`; after `timeout_s` without a command (0: never) the safe current."""

    def __init__(self, limits_A: tuple[float, float], safe_A: float, timeout_s: float) -> None:
        self._low, self._high = limits_A
        self.safe_A, self.timeout_s = safe_A, timeout_s
        self._value, self._since = 0.0, -inf
        self.refused = 0

    def set_current(self, current_A: float, time_s: float) -> None:
        """Accept a command at a time of the rig; a command that is not finite is refused and counted."""
        if isfinite(current_A):
            self._value, self._since = current_A, time_s
        else:
            self.refused += 1

    def is_fresh(self, time_s: float) -> bool:
        """Return whether a command is in force."""
        age = time_s - self._since
        return age < inf and (self.timeout_s == 0.0 or age <= self.timeout_s)

    def at(self, time_s: float) -> float:
        """Return the current [A] that the driver sets."""
        current = self._value if self.is_fresh(time_s) else self.safe_A
        return min(max(current, self._low), self._high)
