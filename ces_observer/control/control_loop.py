"""The controller's loop over samples, and its health."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from math import inf, isfinite, nan

from ces_observer.control.force_controller import NO_ESTIMATE, NOT_FINITE, OK, STALE, ControllerCounts, ForceController
from ces_observer.health.diagnostics import (
    ACTIVE,
    INACTIVE_TASK,
    LEVEL_ERROR,
    LEVEL_OK,
    LEVEL_WARN,
    DiagnosticTask,
    Latencies,
    NodeFacts,
    Report,
    Values,
    find_change_remarks,
    make_statuses,
)

ESTIMATE, MEASURED, NONE = "estimate", "measured", "none"
FEEDBACKS = (ESTIMATE, MEASURED, NONE)


class ControlLoop:
    """A controller with its feedback, and a watch for estimates that stop or are stale.

    `feedback` is one of FEEDBACKS, `max_age_s` the largest difference between an estimate's stamp and the node's clock,
    in either direction (0: any). Estimates have stopped after `controller.tuning.timeout_s` of steady time.
    """

    def __init__(self, controller: ForceController, feedback: str, max_age_s: float) -> None:
        self.controller = controller
        self.feedback = feedback
        self.max_age_s = max_age_s
        self.estimates = 0
        self.age_s = 0.0  # of the last estimate, on arrival
        self._last_estimate_s = self._commanded_s = -inf
        self._measured_N, self._measured_s = nan, -inf

    def restart(self) -> None:
        """Begin anew after an unexpected error: `watch` commands the safe current until an estimate is used again."""
        self.controller.reset()
        self._last_estimate_s = -inf
        self._measured_N, self._measured_s = nan, -inf

    def take_measured_force(self, force_N: float, steady_s: float) -> None:
        """Store a measured force; it is fed back for at most `timeout_s`."""
        self._measured_N, self._measured_s = force_N, steady_s

    def take_estimate(self, stamp_ns: int, speed_m_s: float, force_N: float, now_ns: int, steady_s: float) -> float:
        """Return the current [A] to command for an estimate; `now_ns` is the node's clock, `steady_s` never jumps."""
        elapsed_s = self._measure_elapsed(steady_s)
        self.estimates += 1
        self._last_estimate_s = steady_s
        self.age_s = (now_ns - stamp_ns) * 1e-9
        if self.max_age_s > 0.0 and abs(self.age_s) > self.max_age_s:
            return self.controller.fail_safe(STALE, elapsed_s)
        if not isfinite(force_N):
            return self.controller.fail_safe(NOT_FINITE, elapsed_s)
        if self.feedback != ESTIMATE:
            fresh = steady_s - self._measured_s <= self.controller.tuning.timeout_s
            force_N = self._measured_N if self.feedback == MEASURED and fresh else nan
        return self.controller.step(stamp_ns, speed_m_s, force_N)

    def watch(self, steady_s: float, ahead_s: float = 0.0) -> float | None:
        """Return the current [A] to command without an estimate, or None; the next call is `ahead_s` later."""
        if steady_s - self._last_estimate_s + ahead_s <= self.controller.tuning.timeout_s:
            return None
        return self.controller.fail_safe(NO_ESTIMATE, self._measure_elapsed(steady_s))

    def _measure_elapsed(self, steady_s: float) -> float:
        """Return the time [s] since the last command, at most `timeout_s`, which limits the step of the command."""
        elapsed_s = min(steady_s - self._commanded_s, self.controller.tuning.timeout_s)
        self._commanded_s = steady_s
        return elapsed_s


SHARES = ("unreachable", "saturated", "rate_limited", "unfed")  # counts of ControllerCounts
KEYS: Mapping[str, Sequence[str]] = {  # of the tasks, at most 20 in all
    "health": ("reason", "state", "feedback", "command [A]", "desired force [N]",
               *(f"{name.replace('_', ' ')} share" for name in SHARES), "unexpected errors"),
    "frequency": ("estimates: rate [Hz]", "estimates: age of the last [ms]",
                  *(f"latency from stamp to command, {name} [ms]" for name in ("p50", "p99", "max"))),
    "model": ("model sha256", "last change of the model"),
}  # fmt: skip
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

    def set_facts(self, facts: Mapping[str, str]) -> None:
        """Set the key-value pairs that the status repeats."""
        self._facts = tuple(facts.items())

    def roll(self, elapsed_s: float) -> None:
        """Close a window of `elapsed_s` seconds."""
        now, before = self._loop.controller.count, self._before
        self._rate_Hz = (self._loop.estimates - self._estimates) / elapsed_s if elapsed_s > 0.0 else 0.0
        steps = now.steps - before.steps
        self._shares = {name: (getattr(now, name) - getattr(before, name)) / max(steps, 1) for name in SHARES}
        self.latency.roll()
        self._before, self._estimates = deepcopy(now), self._loop.estimates

    def report(self, detail: str, node: NodeFacts) -> Report:
        """Return the present report; `detail` is added to the reason."""
        reason, active = self._loop.controller.reason, node.state == ACTIVE
        values = {**dict(self._values()), "state": node.state, **dict(node.values)}
        tasks = {
            "health": self._health_task(detail, node.remarks) if active else INACTIVE_TASK,
            "frequency": DiagnosticTask(LEVEL_OK if self._rate_Hz else LEVEL_WARN, f"estimates {self._rate_Hz:.1f} Hz"),
            "model": DiagnosticTask(LEVEL_OK, values.get("model", ""), find_change_remarks(values)),
        }
        status, each = make_statuses(tasks, values, KEYS)
        interruptions = sum(self._loop.controller.count.interruptions.values())
        return Report(reason if active else node.state, status, each, interruptions)

    def _health_task(self, detail: str, remarks: Sequence[str]) -> DiagnosticTask:
        reason, unfed, remarks = self._loop.controller.reason, self._shares["unfed"], list(filter(None, remarks))
        if reason != OK:
            return DiagnosticTask(LEVEL_ERROR, f"safe current: {reason}" + (f": {detail}" if detail else ""), remarks)
        if self._loop.feedback == MEASURED and unfed > 0.0:
            remarks.insert(0, f"{unfed:.1%} {UNFED}")
        return DiagnosticTask(LEVEL_OK, "controlling", remarks)

    def _values(self) -> Values:
        loop, controller = self._loop, self._loop.controller
        yield "reason", controller.reason
        yield "feedback", loop.feedback
        yield "command [A]", f"{controller.command_A:.4f}"
        yield "desired force [N]", f"{controller.desired_N:.1f}"
        yield "trim in rebound [A]", f"{controller.trims_A[0]:+.4f}"
        yield "trim in compression [A]", f"{controller.trims_A[1]:+.4f}"
        yield "estimates: rate [Hz]", f"{self._rate_Hz:.1f}"
        yield "estimates: age of the last [ms]", f"{loop.age_s * 1e3:.3f}"
        yield from self.latency.figures.values("command")
        for name, share in self._shares.items():
            yield f"{name.replace('_', ' ')} share", f"{share:.4f}"
        for reason, count in sorted(controller.count.interruptions.items()):
            yield f"interruptions: {reason}", str(count)
        yield from self._facts
