"""What the nodes say in /diagnostics: figures with their keys, remarks, tasks and statuses; without ROS.

Figures, remarks, reasons that are errors, and thresholds are printed to C++ (`ces_identify.export.cpp_sources`) and
shown in docs/reference/nodes.md. Forms are those of C's printf.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

from ces_observer.damper_observer import NO_CURRENT, OFF_CLOCK, POSITION_NOT_FINITE, SILENT
from ces_observer.reasons import BEYOND_STROKE, UNBOUNDED

MAX_LATENCIES = 20_000  # kept of a window: the newest
REFUSED = "refused"  # begins the state of a change of the model
ERRORS = (SILENT, POSITION_NOT_FINITE, NO_CURRENT, OFF_CLOCK, UNBOUNDED, BEYOND_STROKE)  # other reasons are warnings
Values = Iterator[tuple[str, str]]  # key and value for diagnostics


@dataclass(frozen=True)
class Figure:
    """A value for diagnostics: its key, with {} for a name, the form of its value, and its meaning.

    Without a meaning it belongs to the figure before it.
    """

    key: str
    form: str = "%d"
    meaning: str = ""

    def of(self, value: object, *names: str) -> tuple[str, str]:
        """Return key and value; None is no value."""
        return self.key.format(*names), "none" if value is None else self.form % value


class Figures:
    """The figures of the observer, in the order of their description."""

    REASON = Figure("reason", "%s", "ok, or why the force is withheld")
    RATE = Figure("rate [Hz]", "%.1f", "position samples per second")
    AGE = Figure("age of the last position on arrival [s]", "%.6f", "clock of the node minus its stamp")
    WITHHELD_SHARE = Figure("withheld in the last second [%]", "%.1f", "of the samples")
    OUTSIDE_SHARE = Figure("share outside the envelope", "%.4f", "of the last second; what becomes of them")
    OUTSIDE = Figure("inputs outside the envelope", "are %s")
    SAMPLES = Figure("position samples", "%d", "since the start; withheld by reason")
    ESTIMATED = Figure("forces estimated")
    WITHHELD = Figure("withheld: {}")
    LATE = Figure("delayed forces estimated", "%d", "since the start, by a model with a delay")
    HELD = Figure("forces held at the force envelope", "%d", "since the start, if any")
    UNREADABLE = Figure("messages without the field", "%d", "received messages in which the signal's field is missing")
    EPISODES = Figure("episodes of withholding", "%d", "number; the last one: its start, length, reasons and samples")
    LAST_EPISODE = Figure("last episode", "%s")
    RESTS = Figure("position has not changed, times", "%d", "at rest, or its sensor is stuck")
    LAST_REST = Figure("position has not changed, last for [s]", "%.3f")
    LATENCY = Figure("latency from stamp to {}, {} [ms]", "%.3f", "p50, p99 and max of the last second")
    LOAD = Figure("{} load [% of a core]", "%.1f", "of the process and of the callbacks")
    STREAM_RATE = Figure("{}: rate [Hz]", "%.1f", "of each input in the last second")
    MEAN_AGE = Figure("{}: age, mean [ms]", "%.3f")
    MAX_AGE = Figure("{}: age, max [ms]", "%.3f")
    JITTER = Figure("{}: jitter [ms]", "%.3f")
    ALL_DROPPED = Figure("dropped", "%d", "samples missing between stamps (first: positions), and what became of them")
    DROPPED = Figure("{}: dropped")
    DROPPED_IN_QUEUE = Figure("{}: dropped, in this node's queue")
    DROPPED_ON_THE_WAY = Figure("{}: dropped, lost on the way", "%s")
    NOT_SENT = Figure("{}: dropped, not sent", "%s")
    OUT_OF_ORDER = Figure("{}: out of order", "%d", "since the start")
    DUPLICATES = Figure("{}: duplicates")
    INTERRUPTIONS = Figure("{}: interruptions")
    COST = Figure("running cost J [%]", "%.2f", "against the measured force, if there is one")
    COST_LIMIT = Figure("threshold of J [%]", "%.2f")
    FORCE_SPREAD = Figure("measured force, standard deviation [N]", "%.1f")
    FORCES_NOT_FINITE = Figure("measured forces not finite", "%d", "left out of J")
    FORCES_UNPAIRED = Figure("measured forces without estimates around")
    JUMPS = Figure("jumps of time", "%s", "number, and the last one")
    SNAPSHOT = Figure("snapshot", "%s", "what became of the last request for a recording")


class Remarks:
    """What the tasks of the observer say."""

    ESTIMATING = "estimating"
    WITHHOLDING = "withholding: "
    RECOVERED = "recovered from "
    MORE_EPISODES = " and %.0f more"
    WITHHELD = "%.1f%% withheld in the last second"
    EXTRAPOLATED = "%.1f%% of the forces extrapolated to inputs outside what the model was identified on"
    CLAMPED = "%.1f%% of the forces from clamped inputs, outside what the model was identified on"
    HELD = "%.1f%% of the forces held at the force envelope"
    RESTS = "the position has not changed for %.1f s: at rest, or its sensor is stuck"
    RESTED = "the position has not changed for %.1f s and does now"
    NOT_MEASURED = "not measured yet"
    NO_POSITION = "no position"
    POSITION_RATE = "position %.1f Hz"
    CURRENT_RATE = ", current %.1f Hz"
    MISSING = "%.1f%% of the positions missing"
    MISSING_IN_QUEUE = ", %.0f of them dropped by this node's queue: set input_depth higher"
    MISSING_ON_THE_WAY = ", %.0f of them lost on the way"
    MISSING_UNKNOWN = ": lost on the way, or the source paused"
    MISSING_PAUSED = ": the source paused"
    NOT_NUMBERED = "unknown: the middleware does not number the messages"
    NO_RECENT_POSITION = "no position in the last second"
    NO_STAMP = "positions have no stamp: they are stamped on arrival"
    ARRIVAL = "positions arrive %.1f ms after their stamp"
    AHEAD = "their stamps are ahead of the node's clock"
    APART = "the current is stamped %+.3f s off them: by another clock? current.delay takes that off"
    REPEATS = "%.0f positions repeat or run backwards"
    INTERRUPTIONS = "%.0f interruptions of the stamps"


class LatencyFigures(NamedTuple):
    """One window: median, 99th percentile and maximum [ns], 0 if it was empty, and the number of latencies."""

    p50_ns: int = 0
    p99_ns: int = 0
    max_ns: int = 0
    samples: int = 0

    def values(self, end: str) -> Values:
        """Yield the latencies from a stamp to `end`."""
        for name, ns in (("p50", self.p50_ns), ("p99", self.p99_ns), ("max", self.max_ns)):
            yield Figures.LATENCY.of(ns * 1e-6 if self.samples else None, end, name)


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
