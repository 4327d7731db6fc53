"""A filtered lead: it predicts a signal, to compensate a lag behind it."""

from __future__ import annotations

from math import exp


class Lead:
    """(1 + zero_s s) / (1 + filter_s s) for unevenly spaced samples; the first one after `reset` passes unchanged.

    With `zero_s` at or below `filter_s` all samples pass unchanged.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._filtered: float | None = None

    def step(self, value: float, elapsed_s: float, zero_s: float, filter_s: float) -> float:
        """Return the signal with its lead, `elapsed_s` after the last value."""
        if self._filtered is None or zero_s <= filter_s or elapsed_s <= 0.0:
            self._filtered = value
            return value
        behind = value - self._filtered
        self._filtered = value - behind * exp(-elapsed_s / filter_s) if filter_s > 0.0 else value
        return value + behind * (zero_s - filter_s) / max(filter_s, elapsed_s)
