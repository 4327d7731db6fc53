"""What a damper's status says: reason and counts in; level, one line and key-value pairs as in DiagnosticStatus out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ces_observer.damper_observer import NO_CURRENT, OFF_CLOCK, POSITION_NOT_FINITE, SILENT, DamperObserver
from ces_observer.estimator import UNBOUNDED
from ces_observer.tracker import OK

LEVEL_OK, LEVEL_WARN, LEVEL_ERROR = 0, 1, 2  # as in diagnostic_msgs/msg/DiagnosticStatus
ERRORS = frozenset({SILENT, POSITION_NOT_FINITE, NO_CURRENT, OFF_CLOCK, UNBOUNDED})
CLAMPED_WARN = 0.01  # share of forces with inputs outside the identified envelope from which it is worth a warning


@dataclass(frozen=True)
class Status:
    """One status: `level` as in DiagnosticStatus, `message` one line, `values` in the order they are shown."""

    level: int
    message: str
    values: tuple[tuple[str, str], ...]


class Health:
    """Status of one damper; rates and shares are those of the last window that `roll` closed."""

    def __init__(self, damper: DamperObserver, facts: Mapping[str, str]) -> None:
        self._damper = damper
        self._facts = tuple(facts.items())
        self._before = damper.tally.copy()
        self._rate_Hz = self._withheld = self._clamped = 0.0

    def roll(self, elapsed_s: float) -> None:
        """Close a window of `elapsed_s` seconds: its rate and shares are told until the next one closes."""
        now, before = self._damper.tally, self._before
        samples, estimates = now.samples - before.samples, now.estimates - before.estimates
        self._rate_Hz = samples / elapsed_s if elapsed_s > 0.0 else 0.0
        self._withheld = 1.0 - estimates / samples if samples else 0.0
        self._clamped = (now.clamped - before.clamped) / estimates if estimates else 0.0
        self._before = now.copy()

    def status(self, detail: str) -> Status:
        """Return the status now; `detail` adds to the reason."""
        reason = self._damper.reason
        if reason != OK:
            level = LEVEL_ERROR if reason in ERRORS else LEVEL_WARN
            return Status(level, f"withholding: {reason}" + (f": {detail}" if detail else ""), self._values())
        remarks = self._remarks()
        message = "estimating" + "".join(f"; {remark}" for remark in remarks)
        return Status(LEVEL_WARN if remarks else LEVEL_OK, message, self._values())

    def _remarks(self) -> list[str]:
        remarks = []
        if self._withheld > 0.0:
            remarks.append(f"{self._withheld:.1%} withheld in the last second")
        if self._clamped >= CLAMPED_WARN:
            remarks.append(f"{self._clamped:.1%} of the forces from inputs outside what the model was identified on")
        return remarks

    def _values(self) -> tuple[tuple[str, str], ...]:
        damper, tally = self._damper, self._damper.tally
        return (
            ("reason", damper.reason),
            ("rate [Hz]", f"{self._rate_Hz:.1f}"),
            ("age of the last position on arrival [s]", f"{damper.age_ns * 1e-9:.6f}"),
            ("extrapolated share", f"{self._clamped:.4f}"),
            ("position samples", str(tally.samples)),
            ("forces estimated", str(tally.estimates)),
            ("messages without the field", str(tally.unreadable)),
            *((f"withheld: {reason}", str(count)) for reason, count in sorted(tally.withheld.items())),
            *self._facts,
        )
