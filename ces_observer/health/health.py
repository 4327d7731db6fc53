"""The health of an observed damper: what happens to its samples goes in, a status for diagnostics comes out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple, Protocol

from ces_observer.current_hold import ConstantCurrent
from ces_observer.damper_observer import NO_CURRENT, OFF_CLOCK, POSITION_NOT_FINITE, SILENT, DamperObserver
from ces_observer.health.episodes import Episodes, Stillness
from ces_observer.health.process import Load
from ces_observer.health.running_cost import RunningCost
from ces_observer.health.streams import Arrivals, StreamFigures
from ces_observer.reasons import BEYOND_STROKE, OK, UNBOUNDED

Values = Iterator[tuple[str, str]]  # key and value for diagnostics

MAX_LATENCIES = 20_000  # kept of a window: the newest


class LatencyFigures(NamedTuple):
    """One window: median, 99th percentile and maximum [ns], 0 if it was empty, and the number of latencies."""

    p50_ns: int = 0
    p99_ns: int = 0
    max_ns: int = 0
    samples: int = 0

    def values(self, end: str) -> Values:
        """Yield the latencies from a stamp to `end`."""
        for name, ns in (("p50", self.p50_ns), ("p99", self.p99_ns), ("max", self.max_ns)):
            yield f"latency from stamp to {end}, {name} [ms]", f"{ns * 1e-6:.3f}" if self.samples else "none"


class Latencies:
    """The latencies since the last `roll`; `figures` are those of the window before."""

    def __init__(self) -> None:
        self._ns: deque[int] = deque(maxlen=MAX_LATENCIES)
        self.figures = LatencyFigures()

    def take(self, ns: int) -> None:
        """Count a latency; a negative one, from different clocks, counts as zero."""
        self._ns.append(ns)

    def roll(self) -> LatencyFigures:
        """Return the figures of the window and begin a new one."""
        ns, self.figures = sorted(self._ns), LatencyFigures()
        self._ns.clear()
        if ns:
            p50_ns, p99_ns, max_ns = (max(0, ns[ceil(len(ns) * percent / 100) - 1]) for percent in (50, 99, 100))
            self.figures = LatencyFigures(p50_ns, p99_ns, max_ns, len(ns))
        return self.figures


LEVEL_OK, LEVEL_WARN, LEVEL_ERROR = 0, 1, 2  # as in diagnostic_msgs/msg/DiagnosticStatus
ERRORS = frozenset({SILENT, POSITION_NOT_FINITE, NO_CURRENT, OFF_CLOCK, UNBOUNDED, BEYOND_STROKE})
OUTSIDE_WARN = 0.01  # share of forces from inputs outside the envelope, or held at its own, that gives a warning
DROPPED_WARN = 0.01  # share of missing positions that gives a warning
STILL_WARN_S = 1.0  # time without any change of position that gives a warning


class DriftRecorder(Protocol):
    """What keeps the seconds around a drift; `state` says how the last time went."""

    state: str

    def note_drift(self, drift: str) -> bool:
        """Take note of a drift; return whether it will be recorded."""


@dataclass(frozen=True)
class Status:
    """One status: `level` as in DiagnosticStatus, `message` in one line, `values` in the order of display."""

    level: int
    message: str
    values: tuple[tuple[str, str], ...]


UNCONFIGURED, INACTIVE, ACTIVE = "unconfigured", "inactive", "active"  # states of a node


class NodeFacts(NamedTuple):
    """The state of a node, remarks on it (empty ones are none), and more values for `~/details`."""

    state: str = ACTIVE
    remarks: tuple[str, ...] = ()
    values: tuple[tuple[str, str], ...] = ()


class DiagnosticTask(NamedTuple):
    """One task of diagnostics: its level and message, and remarks, each of which makes it a warning."""

    level: int
    words: str
    remarks: Sequence[str] = ()


class Report(NamedTuple):
    """The report on a damper: its reason, a status with all values, those of the tasks by name, and counts for the log.

    `changes` of the reason and samples `withheld` are counted since the start.
    """

    reason: str
    status: Status
    tasks: tuple[tuple[str, Status], ...] = ()
    changes: int = 0
    withheld: int = 0


def make_statuses(
    tasks: Mapping[str, DiagnosticTask], values: Mapping[str, str], keys: Mapping[str, Sequence[str]]
) -> tuple[Status, tuple[tuple[str, Status], ...]]:
    """Return one status with the first task's words, all remarks and `values`, and one of each task with its `keys`."""
    levels = {name: max(task.level, LEVEL_WARN if task.remarks else LEVEL_OK) for name, task in tasks.items()}
    each = tuple(
        (name, Status(levels[name], "; ".join((task.words, *task.remarks)),
                      tuple((key, values[key]) for key in keys[name] if key in values)))
        for name, task in tasks.items()
    )  # fmt: skip
    remarks = [remark for task in tasks.values() for remark in task.remarks]
    words = next(iter(tasks.values())).words
    return Status(max(levels.values()), "; ".join((words, *remarks)), tuple(values.items())), each


def unconfigured_report(purpose: str) -> Report:
    """Return the report of a node without a model; `purpose` is what it would do."""
    status = Status(LEVEL_WARN, f"unconfigured: configure the node to {purpose}", (("state", UNCONFIGURED),))
    return Report(UNCONFIGURED, status, (("health", status),))


def find_change_remarks(values: Mapping[str, str]) -> list[str]:
    """Return a remark on the last change of the model, if it was refused."""
    change = values.get("last change of the model", "")
    return [f"the last change was {change}"] if change.startswith(REFUSED) else []


INACTIVE_TASK = DiagnosticTask(LEVEL_WARN, "inactive: activate the node to publish")
LATENCIES = tuple(f"latency from stamp to publish, {name} [ms]" for name in ("p50", "p99", "max"))
KEYS: Mapping[str, Sequence[str]] = {  # of the tasks, at most 20 in all
    "health": ("reason", "state", "withheld in the last second [%]", "share outside the envelope",
               "last episode", "unexpected errors"),
    "frequency": ("position: rate [Hz]", "current: rate [Hz]", "dropped", "forces estimated"),
    "time stamps": ("age of the last position on arrival [s]", *LATENCIES, "jumps of time"),
    "model": ("model sha256", "computed by", "last change of the model", "running cost J [%]", "threshold of J [%]"),
}  # fmt: skip
AHEAD_S = 0.05  # of stamps before the node's clock, that simulated time may give
REFUSED = "refused"  # begins the state of a change of the model


class Health:
    """Report on one damper; rates, shares and latencies are of the last window that `roll` closed.

    `mismatch` names publishers that its subscriptions cannot hear, beside those that they do.
    """

    def __init__(
        self, damper: DamperObserver, facts: Mapping[str, str], *,
        cost: RunningCost | None = None, snapshots: DriftRecorder | None = None, name: str = "damper",
    ) -> None:  # fmt: skip
        self.position, self.current, self.force = Arrivals(), Arrivals(), Arrivals()
        self.stillness = Stillness(STILL_WARN_S)
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
            return DiagnosticTask(LEVEL_OK, "estimating", remarks)
        level = LEVEL_ERROR if reason in ERRORS else LEVEL_WARN
        return DiagnosticTask(level, f"withholding: {reason}" + (f": {detail}" if detail else ""), remarks)

    def _remarks(self) -> Iterator[str]:
        episodes, ok = self.episodes, self._damper.reason == OK
        new, last = episodes.total - self._reported_episodes, episodes.last
        if new and last is not None:
            more = f" and {new - 1} more" if new > 1 else ""
            yield f"recovered from {last.reason} ({last.length_s:.2g} s){more}"
        if ok and self._withheld > 0.0:
            yield f"{self._withheld:.1%} withheld in the last second"
        if ok and self._outside >= OUTSIDE_WARN:
            extrapolates = self._damper.model.body.extrapolates
            what = "of the forces extrapolated to inputs" if extrapolates else "of the forces from clamped inputs,"
            yield f"{self._outside:.1%} {what} outside what the model was identified on"
        if ok and self._held >= OUTSIDE_WARN:
            yield f"{self._held:.1%} of the forces held at the force envelope"
        if self.stillness.resting:
            yield f"the position has not changed for {self.stillness.last_s:.1f} s: at rest, or its sensor is stuck"
        elif self.stillness.count > self._reported_rests:
            yield f"the position has not changed for {self.stillness.last_s:.1f} s and does now"

    def _frequency_task(self) -> DiagnosticTask:
        figures, remarks = self.position.figures, [self.mismatch] if self.mismatch else []
        if not self._is_rolled:
            return DiagnosticTask(LEVEL_OK, "not measured yet", remarks)
        if not figures.samples:
            return DiagnosticTask(LEVEL_ERROR, "no position", remarks)
        rates = f"position {figures.rate_Hz:.1f} Hz"
        if not isinstance(self._damper.current, ConstantCurrent):
            rates += f", current {self.current.figures.rate_Hz:.1f} Hz"
        if figures.dropped and figures.dropped >= DROPPED_WARN * (figures.samples + figures.dropped):
            share = figures.dropped / (figures.samples + figures.dropped)
            remarks.insert(0, f"{share:.1%} of the positions {figures.describe_missing()}")
        return DiagnosticTask(LEVEL_OK, rates, remarks)

    def _stamps_task(self) -> DiagnosticTask:
        now, before, remarks = self.position.figures, self._position_before, list[str]()
        if not now.samples:
            words = "no position in the last second" if self._is_rolled else "not measured yet"
        elif now.total_dropped is None:
            words = "positions have no stamp: they are stamped on arrival"
        else:
            words = f"positions arrive {now.mean_age_s * 1e3:.1f} ms after their stamp"
            if now.mean_age_s < -AHEAD_S:
                remarks.append("their stamps are ahead of the node's clock")
        repeats = now.total_out_of_order + now.total_duplicates - before.total_out_of_order - before.total_duplicates
        if repeats:
            remarks.append(f"{repeats} positions repeat or run backwards")
        if breaks := now.total_interruptions - before.total_interruptions:
            remarks.append(f"{breaks} interruptions of the stamps")
        return DiagnosticTask(LEVEL_OK, words, remarks + ([self._recent_jump] if self._recent_jump else []))

    def _model_remarks(self) -> Iterator[str]:
        if self.cost is not None and self.cost.drifted:
            snapshot = f"; snapshot {self.snapshots.state}" if self.snapshots is not None and self._recorded else ""
            yield f"re-identify: {self.cost.describe_drift()}{snapshot}"

    def _values(self) -> Values:
        damper, tally, stillness = self._damper, self._damper.tally, self.stillness
        yield "reason", damper.reason
        yield "rate [Hz]", f"{self._rate_Hz:.1f}"
        yield "age of the last position on arrival [s]", f"{damper.age_ns * 1e-9:.6f}"
        yield "withheld in the last second [%]", f"{100.0 * self._withheld:.1f}"
        yield "share outside the envelope", f"{self._outside:.4f}"
        yield "inputs outside the envelope", f"are {damper.model.body.outside}"
        yield "position samples", str(tally.samples)
        yield "forces estimated", str(tally.estimates)
        if damper.model.sampling.delay_ticks:
            yield "delayed forces estimated", str(tally.late)
        if tally.held:
            yield "forces held at the force envelope", str(tally.held)
        yield "messages without the field", str(tally.unreadable)
        for reason, count in sorted(tally.withheld.items()):
            yield f"withheld: {reason}", str(count)
        yield "episodes of withholding", str(self.episodes.total)
        yield "last episode", str(self.episodes.last or "none")
        yield "position has not changed, times", str(stillness.count)
        if stillness.count:
            yield "position has not changed, last for [s]", f"{stillness.last_s:.3f}"
        yield from self.latency.figures.values("publish")
        for name, share in self._load._asdict().items():
            if share is not None:
                yield f"{name} load [% of a core]", f"{100.0 * share:.1f}"
        for name, stream in (("position", self.position), ("current", self.current), ("measured force", self.force)):
            yield from stream.figures.values(name)
        if self.position.figures.total_dropped is not None:
            yield "dropped", str(self.position.figures.total_dropped)
        yield "jumps of time", f"{self._jumps}, the last: {self._jump}"
        if self.cost is not None:
            yield from self.cost.values(self._evaluated)
        if self.snapshots is not None:
            yield "snapshot", self.snapshots.state
        yield from self._facts
