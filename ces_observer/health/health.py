"""The health of an observed damper: what happens to its samples goes in, a status for diagnostics comes out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from ces_observer.current_hold import ConstantCurrent
from ces_observer.damper_observer import SILENT, DamperObserver
from ces_observer.health.diagnostics import (
    ACTIVE,
    ERRORS,
    INACTIVE_TASK,
    LEVEL_ERROR,
    LEVEL_OK,
    LEVEL_WARN,
    DiagnosticTask,
    Figures,
    Latencies,
    NodeFacts,
    Remarks,
    Report,
    Values,
    find_change_remarks,
    make_statuses,
)
from ces_observer.health.episodes import Episodes, Stillness
from ces_observer.health.process import Load
from ces_observer.health.running_cost import RunningCost
from ces_observer.health.streams import Arrivals, StreamFigures
from ces_observer.limits import ClockLimits, HealthLimits
from ces_observer.reasons import OK


class DriftRecorder(Protocol):
    """What keeps the seconds around a drift; `state` says how the last time went."""

    state: str

    def note_drift(self, drift: str) -> bool:
        """Take note of a drift; return whether it will be recorded."""


LATENCY_KEYS = tuple(Figures.LATENCY.key.format("publish", name) for name in ("p50", "p99", "max"))
KEYS: Mapping[str, Sequence[str]] = {  # of the tasks, at most 20 in all
    "health": (Figures.REASON.key, "state", Figures.WITHHELD_SHARE.key, Figures.OUTSIDE_SHARE.key,
               Figures.LAST_EPISODE.key, "unexpected errors"),
    "frequency": (*(Figures.STREAM_RATE.key.format(name) for name in ("position", "current")),
                  Figures.ALL_DROPPED.key, Figures.ESTIMATED.key),
    "time stamps": (Figures.AGE.key, *LATENCY_KEYS, Figures.JUMPS.key),
    "model": ("model sha256", "computed by", "last change of the model", Figures.COST.key, Figures.COST_LIMIT.key),
}  # fmt: skip


class Health:
    """Report on one damper; rates, shares and latencies are of the last window that `roll` closed.

    `mismatch` names publishers that its subscriptions cannot hear, beside those that they do.
    """

    def __init__(
        self, damper: DamperObserver, facts: Mapping[str, str], *,
        cost: RunningCost | None = None, snapshots: DriftRecorder | None = None, name: str = "damper",
    ) -> None:  # fmt: skip
        self.position, self.current, self.force = Arrivals(), Arrivals(), Arrivals()
        self.stillness = Stillness(HealthLimits.STILL_S)
        self.latency = Latencies()
        self.episodes = Episodes()
        self.snapshots = snapshots
        self._name = name
        self._load = Load()
        self._reported_episodes = self._reported_rests = self._changes = 0
        self._jumps = self._rolled_jumps = 0
        self._jump, self._recent_jump = "none", ""
        self._position_before, self._is_rolled = StreamFigures(), False
        self.mismatch = ""
        self.set_damper(damper, facts, cost)

    def set_damper(self, damper: DamperObserver, facts: Mapping[str, str], cost: RunningCost | None) -> None:
        """Report this damper and model from now on, and the key-value pairs `facts`."""
        self._damper, self.cost = damper, cost
        self._facts = tuple(facts.items())
        self._before = damper.tally.copy()
        self._paired = 0
        self._evaluated = self._recorded = False
        self._rate_Hz = self._withheld = self._outside = self._held = 0.0

    def note_change(self, now_ns: int) -> None:
        """Record a change of the damper's reason; an episode includes its first withheld sample."""
        self._changes += 1
        tally, reason = self._damper.tally, self._damper.reason
        withheld = tally.samples - tally.estimates
        if reason == OK:
            self.episodes.end_episode(now_ns, withheld)
        else:
            self.episodes.add_withheld(reason, now_ns, withheld if reason == SILENT else withheld - 1)

    def roll(self, elapsed_s: float, now_ns: int, load: Load | None = None) -> None:
        """Close a window of `elapsed_s` seconds; if the model has drifted, ask for a snapshot."""
        now, before = self._damper.tally, self._before
        samples, estimates = now.samples - before.samples, now.estimates - before.estimates
        self._rate_Hz = samples / elapsed_s if elapsed_s > 0.0 else 0.0
        self._withheld = 1.0 - estimates / samples if samples else 0.0
        self._outside = (now.clamped - before.clamped) / estimates if estimates else 0.0
        self._held = (now.held - before.held) / estimates if estimates else 0.0
        self._before, self._position_before, self._is_rolled = now.copy(), self.position.figures, True
        self._recent_jump = self._jump if self._jumps > self._rolled_jumps else ""
        self._rolled_jumps = self._jumps
        for stream in (self.position, self.current, self.force):
            stream.roll(elapsed_s)
        self.latency.roll()
        self._load = load or Load()
        if self.cost is None:
            return
        self._evaluated, self._paired = self.cost.paired > self._paired, self.cost.paired
        if not self.cost.drifted:
            self._recorded = False
        elif self.snapshots is not None and not self._recorded:
            self._recorded = self.snapshots.note_drift(f"{self._name}: {self.cost.describe_drift()}")

    def note_jump(self, what: str) -> None:
        """Count a jump of the node's time."""
        self._jumps, self._jump = self._jumps + 1, what
        for stream in (self.position, self.current, self.force):
            stream.restart_ages()

    def report(self, detail: str, node: NodeFacts) -> Report:
        """Return the present report; `detail` is added to the reason. One message reports each ended episode."""
        tally, active = self._damper.tally, node.state == ACTIVE
        values = {**dict(self._values()), "state": node.state, **dict(node.values)}
        tasks = {
            "health": self._health_task(detail, node.remarks) if active else INACTIVE_TASK,
            "frequency": self._frequency_task(),
            "time stamps": self._stamps_task(),
            "model": DiagnosticTask(
                LEVEL_OK, self._damper.model.size, [*self._model_remarks(), *find_change_remarks(values)]
            ),
        }
        self._reported_episodes, self._reported_rests = self.episodes.total, self.stillness.count
        status, each = make_statuses(tasks, values, KEYS)
        reason = self._damper.reason if active else node.state
        return Report(reason, status, each, self._changes, tally.samples - tally.estimates)

    def _health_task(self, detail: str, remarks: Sequence[str]) -> DiagnosticTask:
        reason = self._damper.reason
        remarks = [*self._remarks(), *filter(None, remarks)]
        if reason == OK:
            return DiagnosticTask(LEVEL_OK, Remarks.ESTIMATING, remarks)
        level = LEVEL_ERROR if reason in ERRORS else LEVEL_WARN
        words = f"{Remarks.WITHHOLDING}{reason}" + (f": {detail}" if detail else "")
        return DiagnosticTask(level, words, remarks)

    def _remarks(self) -> Iterator[str]:
        episodes, ok = self.episodes, self._damper.reason == OK
        new, last = episodes.total - self._reported_episodes, episodes.last
        if new and last is not None:
            more = Remarks.MORE_EPISODES % (new - 1) if new > 1 else ""
            yield f"{Remarks.RECOVERED}{last.reason} ({last.length_s:.2g} s){more}"
        if ok and self._withheld > 0.0:
            yield Remarks.WITHHELD % (100.0 * self._withheld)
        if ok and self._outside >= HealthLimits.OUTSIDE:
            extrapolates = self._damper.model.body.extrapolates
            yield (Remarks.EXTRAPOLATED if extrapolates else Remarks.CLAMPED) % (100.0 * self._outside)
        if ok and self._held >= HealthLimits.OUTSIDE:
            yield Remarks.HELD % (100.0 * self._held)
        if self.stillness.resting:
            yield Remarks.RESTS % self.stillness.last_s
        elif self.stillness.count > self._reported_rests:
            yield Remarks.RESTED % self.stillness.last_s

    def _frequency_task(self) -> DiagnosticTask:
        figures, remarks = self.position.figures, [self.mismatch] if self.mismatch else []
        if not self._is_rolled:
            return DiagnosticTask(LEVEL_OK, Remarks.NOT_MEASURED, remarks)
        if not figures.samples:
            return DiagnosticTask(LEVEL_ERROR, Remarks.NO_POSITION, remarks)
        rates = Remarks.POSITION_RATE % figures.rate_Hz
        if not isinstance(self._damper.current, ConstantCurrent):
            rates += Remarks.CURRENT_RATE % self.current.figures.rate_Hz
        if figures.dropped and figures.dropped >= HealthLimits.DROPPED * (figures.samples + figures.dropped):
            share = figures.dropped / (figures.samples + figures.dropped)
            remarks.insert(0, Remarks.MISSING % (100.0 * share) + figures.describe_missing())
        return DiagnosticTask(LEVEL_OK, rates, remarks)

    def _stamps_task(self) -> DiagnosticTask:
        now, before, remarks = self.position.figures, self._position_before, list[str]()
        if not now.samples:
            words = Remarks.NO_RECENT_POSITION if self._is_rolled else Remarks.NOT_MEASURED
        elif now.total_dropped is None:
            words = Remarks.NO_STAMP
        else:
            words = Remarks.ARRIVAL % (now.mean_age_s * 1e3)
            if now.mean_age_s < -ClockLimits.AHEAD_S:
                remarks.append(Remarks.AHEAD)
            current = self.current.figures
            apart_s = now.usual_age_s - current.usual_age_s if current.samples else 0.0
            if abs(apart_s) > (ClockLimits.OFFSET_S if current.dropped is None else ClockLimits.LATE_S):
                remarks.append(Remarks.APART % apart_s)
        repeats = now.total_out_of_order + now.total_duplicates - before.total_out_of_order - before.total_duplicates
        if repeats:
            remarks.append(Remarks.REPEATS % repeats)
        if breaks := now.total_interruptions - before.total_interruptions:
            remarks.append(Remarks.INTERRUPTIONS % breaks)
        return DiagnosticTask(LEVEL_OK, words, remarks + ([self._recent_jump] if self._recent_jump else []))

    def _model_remarks(self) -> Iterator[str]:
        if self.cost is not None and self.cost.drifted:
            snapshot = f"; snapshot {self.snapshots.state}" if self.snapshots is not None and self._recorded else ""
            yield f"re-identify: {self.cost.describe_drift()}{snapshot}"

    def _values(self) -> Values:
        damper, tally, stillness = self._damper, self._damper.tally, self.stillness
        yield Figures.REASON.of(damper.reason)
        yield Figures.RATE.of(self._rate_Hz)
        yield Figures.AGE.of(damper.age_ns * 1e-9)
        yield Figures.WITHHELD_SHARE.of(100.0 * self._withheld)
        yield Figures.OUTSIDE_SHARE.of(self._outside)
        yield Figures.OUTSIDE.of(damper.model.body.outside)
        yield Figures.SAMPLES.of(tally.samples)
        yield Figures.ESTIMATED.of(tally.estimates)
        if damper.model.sampling.delay_ticks:
            yield Figures.LATE.of(tally.late)
        if tally.held:
            yield Figures.HELD.of(tally.held)
        yield Figures.UNREADABLE.of(tally.unreadable)
        for reason, count in sorted(tally.withheld.items()):
            yield Figures.WITHHELD.of(count, reason)
        yield Figures.EPISODES.of(self.episodes.total)
        yield Figures.LAST_EPISODE.of(self.episodes.last)
        yield Figures.RESTS.of(stillness.count)
        if stillness.count:
            yield Figures.LAST_REST.of(stillness.last_s)
        yield from self.latency.figures.values("publish")
        for name, share in self._load._asdict().items():
            if share is not None:
                yield Figures.LOAD.of(100.0 * share, name)
        for name, stream in (("position", self.position), ("current", self.current), ("measured force", self.force)):
            yield from stream.figures.values(name)
        if self.position.figures.total_dropped is not None:
            yield Figures.ALL_DROPPED.of(self.position.figures.total_dropped)
        yield Figures.JUMPS.of(f"{self._jumps}, the last: {self._jump}")
        if self.cost is not None:
            yield from self.cost.values(self._evaluated)
        if self.snapshots is not None:
            yield Figures.SNAPSHOT.of(self.snapshots.state)
        yield from self._facts
