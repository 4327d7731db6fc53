"""The controller's status: counts and reason in; level, message and key-value pairs out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy

from ces_observer.control.control_loop import MEASURED, ControlLoop
from ces_observer.control.force_controller import OK, ControllerCounts
from ces_observer.health.health import LEVEL_ERROR, LEVEL_OK, LEVEL_WARN, Status
from ces_observer.health.latencies import Latencies

SHARES = ("unreachable", "saturated", "rate_limited", "unfed")  # counts of ControllerCounts
UNFED = "of the time no measured force is fed back: feed-forward alone"


class ControllerHealth:
    """Status of one loop; rates, shares and latencies are of the last window that `roll` closed."""

    def __init__(self, loop: ControlLoop, facts: Mapping[str, str]) -> None:
        self.latency = Latencies()
        self._loop = loop
        self.set_facts(facts)
        self._before, self._estimates = ControllerCounts(), 0
        self._rate_Hz = 0.0
        self._shares = dict.fromkeys(SHARES, 0.0)
        self._latency = self.latency.roll()

    def set_facts(self, facts: Mapping[str, str]) -> None:
        """Set the key-value pairs that the status repeats."""
        self._facts = tuple(facts.items())

    def roll(self, elapsed_s: float) -> None:
        """Close a window of `elapsed_s` seconds."""
        now, before = self._loop.controller.count, self._before
        self._rate_Hz = (self._loop.estimates - self._estimates) / elapsed_s if elapsed_s > 0.0 else 0.0
        steps = now.steps - before.steps
        self._shares = {name: (getattr(now, name) - getattr(before, name)) / max(steps, 1) for name in SHARES}
        self._latency = self.latency.roll()
        self._before, self._estimates = deepcopy(now), self._loop.estimates

    def status(self, detail: str = "") -> Status:
        """Return the present status; `detail` is added to the reason."""
        reason, unfed = self._loop.controller.reason, self._shares["unfed"]
        level, message = LEVEL_OK, "controlling"
        if reason != OK:
            level, message = LEVEL_ERROR, f"safe current: {reason}" + (f": {detail}" if detail else "")
        elif self._loop.feedback == MEASURED and unfed > 0.0:
            level, message = LEVEL_WARN, f"controlling; {unfed:.1%} {UNFED}"
        return Status(level, message, tuple(self._values()))

    def _values(self) -> Iterator[tuple[str, str]]:
        loop, controller = self._loop, self._loop.controller
        yield "reason", controller.reason
        yield "feedback", loop.feedback
        yield "command [A]", f"{controller.command_A:.4f}"
        yield "desired force [N]", f"{controller.desired_N:.1f}"
        yield "trim in rebound [A]", f"{controller.trims_A[0]:+.4f}"
        yield "trim in compression [A]", f"{controller.trims_A[1]:+.4f}"
        yield "estimates: rate [Hz]", f"{self._rate_Hz:.1f}"
        yield "estimates: age of the last [ms]", f"{loop.age_s * 1e3:.3f}"
        for name, ns in (("p50", self._latency.p50_ns), ("p99", self._latency.p99_ns), ("max", self._latency.max_ns)):
            yield f"latency from stamp to command, {name} [ms]", f"{ns * 1e-6:.3f}" if self._latency.samples else "none"
        for name, share in self._shares.items():
            yield f"{name.replace('_', ' ')} share", f"{share:.4f}"
        for reason, count in sorted(controller.count.interruptions.items()):
            yield f"interruptions: {reason}", str(count)
        yield from self._facts
