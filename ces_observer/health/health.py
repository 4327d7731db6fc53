"""A damper's status: arrivals, latencies, costs and reasons in; level, message and key-value pairs out.

The node calls `take` of `position`, `current`, `force`, `stillness` and `latency` with each sample, `note_change` when
`damper.reason` changes, `roll` once a second, and `status` for each message that it publishes. Times are those of the
node's clock [ns].
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from ces_observer.damper_observer import NO_CURRENT, OFF_CLOCK, POSITION_NOT_FINITE, SILENT, DamperObserver
from ces_observer.estimator import UNBOUNDED
from ces_observer.health.episodes import Episodes
from ces_observer.health.latencies import Latencies, LatencyFigures
from ces_observer.health.running_cost import RunningCost
from ces_observer.health.status_values import (
    Load,
    Values,
    box_values,
    cost_values,
    describe_missing,
    episode_values,
    latency_values,
    load_values,
    rest_values,
    stream_values,
)
from ces_observer.health.stillness import Stillness
from ces_observer.health.streams import Arrivals
from ces_observer.recorder.black_box import BlackBox
from ces_observer.tracker import OK

LEVEL_OK, LEVEL_WARN, LEVEL_ERROR = 0, 1, 2  # as in diagnostic_msgs/msg/DiagnosticStatus
ERRORS = frozenset({SILENT, POSITION_NOT_FINITE, NO_CURRENT, OFF_CLOCK, UNBOUNDED})
OUTSIDE_WARN = 0.01  # share of forces from inputs outside the envelope that gives a warning
DROPPED_WARN = 0.01  # share of missing positions that gives a warning
STILL_WARN_S = 1.0  # time without any change of position that gives a warning


@dataclass(frozen=True)
class Status:
    """One status: `level` as in DiagnosticStatus, `message` in one line, `values` in the order of display."""

    level: int
    message: str
    values: tuple[tuple[str, str], ...]


class Health:
    """Status of one damper; rates, shares and latencies are of the last window that `roll` closed."""

    def __init__(
        self,
        damper: DamperObserver,
        facts: Mapping[str, str],
        *,
        cost: RunningCost | None = None,
        box: BlackBox | None = None,
        name: str = "damper",
    ) -> None:
        self.position, self.current, self.force = Arrivals(), Arrivals(), Arrivals()
        self.stillness = Stillness(STILL_WARN_S)
        self.latency = Latencies()
        self.episodes = Episodes()
        self.box = box
        self._name = name
        self._latency = LatencyFigures(0, 0, 0, 0)
        self._load = Load()
        self._reported_episodes = self._reported_rests = 0  # in a status message
        self.set_damper(damper, facts, cost)

    def set_damper(self, damper: DamperObserver, facts: Mapping[str, str], cost: RunningCost | None) -> None:
        """Report this damper and model from now on, and the key-value pairs `facts`."""
        self._damper, self.cost = damper, cost
        self._facts = tuple(facts.items())
        self._before = damper.tally.copy()
        self._paired = 0
        self._evaluated = self._recorded = False
        self._rate_Hz = self._withheld = self._outside = 0.0

    def note_change(self, now_ns: int) -> None:
        """Record a change of the damper's reason; an episode includes its first withheld sample."""
        tally, reason = self._damper.tally, self._damper.reason
        withheld = tally.samples - tally.estimates
        if reason == OK:
            self.episodes.end_episode(now_ns, withheld)
        else:
            self.episodes.add_withheld(reason, now_ns, withheld if reason == SILENT else withheld - 1)

    def roll(self, elapsed_s: float, now_ns: int, load: Load | None = None) -> None:
        """Close a window of `elapsed_s` seconds; if the model has drifted, start a recording."""
        now, before = self._damper.tally, self._before
        samples, estimates = now.samples - before.samples, now.estimates - before.estimates
        self._rate_Hz = samples / elapsed_s if elapsed_s > 0.0 else 0.0
        self._withheld = 1.0 - estimates / samples if samples else 0.0
        self._outside = (now.clamped - before.clamped) / estimates if estimates else 0.0
        self._before = now.copy()
        for stream in (self.position, self.current, self.force):
            stream.roll(elapsed_s)
        self._latency = self.latency.roll()
        self._load = load or Load()
        if self.cost is not None:
            self._roll_cost(self.cost, now_ns)

    def _roll_cost(self, cost: RunningCost, now_ns: int) -> None:
        self._evaluated, self._paired = cost.paired > self._paired, cost.paired
        if not cost.drifted:
            self._recorded = False
        elif self.box is not None and not self._recorded:
            notes = {"why": _describe_drift(cost), **dict(self._facts)}
            self._recorded = self.box.save(f"{self._name}_drift", now_ns, notes)

    def status(self, detail: str) -> Status:
        """Return the present status; `detail` is added to the reason. One message reports each ended episode."""
        reason = self._damper.reason
        remarks = list(self._remarks())
        self._reported_episodes, self._reported_rests = self.episodes.total, self.stillness.count
        if reason != OK:
            level = LEVEL_ERROR if reason in ERRORS else LEVEL_WARN
            words = [f"withholding: {reason}" + (f": {detail}" if detail else "")]
        else:
            level, words = LEVEL_WARN if remarks else LEVEL_OK, ["estimating"]
        return Status(level, "; ".join(words + remarks), tuple(self._values()))

    def _remarks(self) -> Iterator[str]:
        episodes, ok = self.episodes, self._damper.reason == OK
        if new := episodes.total - self._reported_episodes:
            last = episodes.last[-1]
            more = f" and {new - 1} more" if new > 1 else ""
            yield f"recovered from {last.reason} ({last.length_s:.2g} s){more}"
        if ok and self._withheld > 0.0:
            yield f"{self._withheld:.1%} withheld in the last second"
        if ok and self._outside >= OUTSIDE_WARN:
            yield f"{self._outside:.1%} {self._describe_outside()} outside what the model was identified on"
        if self.stillness.resting:
            yield f"the position has not changed for {self.stillness.last_s:.1f} s: at rest, or its sensor is stuck"
        elif self.stillness.count > self._reported_rests:
            yield f"the position has not changed for {self.stillness.last_s:.1f} s and does now"
        figures = self.position.figures
        if figures.dropped and figures.dropped >= DROPPED_WARN * (figures.samples + figures.dropped):
            share = figures.dropped / (figures.samples + figures.dropped)
            yield f"{share:.1%} of the positions {describe_missing(figures)}"
        if self.cost is not None and self.cost.drifted:
            yield f"re-identify: {_describe_drift(self.cost)}{self._describe_recording()}"

    def _describe_outside(self) -> str:
        extrapolates = self._damper.model.body.extrapolates
        return "of the forces extrapolated to inputs" if extrapolates else "of the forces from clamped inputs,"

    def _describe_recording(self) -> str:
        """Return the state of the recording of a drift."""
        if self.box is None:
            return ""
        if self.box.problem:
            return f"; {self.box.problem}"
        if self.box.busy:
            return "; it is being recorded"
        return f"; recorded in {self.box.saved}" if self._recorded and self.box.saved is not None else ""

    def _values(self) -> Values:
        damper, tally = self._damper, self._damper.tally
        yield "reason", damper.reason
        yield "rate [Hz]", f"{self._rate_Hz:.1f}"
        yield "age of the last position on arrival [s]", f"{damper.age_ns * 1e-9:.6f}"
        yield "share outside the envelope", f"{self._outside:.4f}"
        yield "inputs outside the envelope", f"are {damper.model.body.outside}"
        yield "position samples", str(tally.samples)
        yield "forces estimated", str(tally.estimates)
        yield "messages without the field", str(tally.unreadable)
        for reason, count in sorted(tally.withheld.items()):
            yield f"withheld: {reason}", str(count)
        yield from episode_values(self.episodes)
        yield from rest_values(self.stillness)
        yield from latency_values(self._latency)
        yield from load_values(self._load)
        for name, stream in (("position", self.position), ("current", self.current), ("measured force", self.force)):
            yield from stream_values(name, stream.figures)
        if self.cost is not None:
            yield from cost_values(self.cost, self._evaluated)
        if self.box is not None:
            yield from box_values(self.box)
        yield from self._facts


def _describe_drift(cost: RunningCost) -> str:
    """Return a sentence about a cost above its threshold."""
    known = "unknown" if cost.J is None else f"{cost.J:.1f}%"
    return f"the cost J against the measured force is {known}, expected below {cost.warn_J:.1f}%"
