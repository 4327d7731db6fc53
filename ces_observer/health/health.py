"""The health of an observed damper: what happens to its samples goes in, a status for diagnostics comes out."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate
from math import ceil
from typing import NamedTuple, Protocol

from ces_observer.damper_observer import NO_CURRENT, OFF_CLOCK, POSITION_NOT_FINITE, SILENT, DamperObserver
from ces_observer.estimator import UNBOUNDED
from ces_observer.health.process import Load
from ces_observer.health.running_cost import RunningCost
from ces_observer.health.streams import Arrivals
from ces_observer.tracker import BEYOND_STROKE, OK

Values = Iterator[tuple[str, str]]  # key and value for diagnostics
MAX_EPISODES = 10  # ended episodes listed one by one; the totals count all
MAX_REASONS = 4  # of one episode listed by name


@dataclass(frozen=True)
class Episode:
    """An ended episode: its start [ns of the node's clock], length [s], reasons in order, and withheld samples."""

    start_ns: int
    length_s: float
    reasons: tuple[str, ...]
    withheld: int

    @property
    def reason(self) -> str:
        """All its reasons in one line."""
        return ", then ".join(self.reasons)

    def __str__(self) -> str:
        start = f"{self.start_ns // 10**9}.{self.start_ns // 10**6 % 1000:03d} s"
        return f"{start}, for {self.length_s:.3f} s: {self.reason} ({self.withheld} samples withheld)"


class Episodes:
    """Episodes of one damper: `total` counts the ended ones, `last` holds the newest of them.

    `by_reason` maps the first reason to number and total length [s] of its episodes.
    """

    def __init__(self) -> None:
        self.total = 0
        self.last: deque[Episode] = deque(maxlen=MAX_EPISODES)
        self.by_reason: dict[str, tuple[int, float]] = {}
        self._reasons: list[str] = []
        self._start_ns = self._withheld = 0

    def add_withheld(self, reason: str, now_ns: int, withheld_before: int) -> None:
        """Add a reason for withholding; `withheld_before` counts the samples withheld before this one."""
        if not self._reasons:
            self._start_ns, self._withheld = now_ns, withheld_before
        if reason not in self._reasons and len(self._reasons) < MAX_REASONS:
            self._reasons.append(reason)

    def end_episode(self, now_ns: int, withheld: int) -> None:
        """End the episode, if there is one; `withheld` counts the samples withheld so far.

        One that began at 0, before the first /clock of simulated time, is taken to begin now.
        """
        if not self._reasons:
            return
        start_ns = self._start_ns or now_ns
        length_s = max(0, now_ns - start_ns) * 1e-9
        episode = Episode(start_ns, length_s, tuple(self._reasons), withheld - self._withheld)
        self._reasons.clear()
        self.total += 1
        self.last.append(episode)
        count, length = self.by_reason.get(episode.reasons[0], (0, 0.0))
        self.by_reason[episode.reasons[0]] = count + 1, length + episode.length_s

    def values(self) -> Values:
        """Yield the values of the ended episodes, newest first."""
        yield "episodes of withholding", str(self.total)
        for reason, (count, length_s) in sorted(self.by_reason.items()):
            yield f"episodes: {reason}", f"{count}, {length_s:.3f} s in all"
        for number, episode in enumerate(reversed(self.last), start=1):
            yield f"last episode {number}", str(episode)


class Stillness:
    """Rests of at least `warn_s` [s] of the positions' stamps; with 0 there are none.

    `count` is the number of rests, `last_s` [s] the length of the last one, `resting` True during a rest.
    """

    def __init__(self, warn_s: float) -> None:
        self.warn_s = warn_s
        self._position_m: float | None = None
        self._since_ns = 0
        self.count = 0
        self.last_s = 0.0
        self.resting = False

    def take(self, stamp_ns: int, position_m: float) -> None:
        """Add a position sample [m]; NaN ends a rest."""
        if position_m != self._position_m or stamp_ns < self._since_ns:
            self._position_m, self._since_ns, self.resting = position_m, stamp_ns, False
        elif self.resting or 0.0 < self.warn_s * 1e9 <= stamp_ns - self._since_ns:
            self.count += not self.resting
            self.resting = True
            self.last_s = (stamp_ns - self._since_ns) * 1e-9


PARTS_BITS = 6
WHOLE_BITS = PARTS_BITS + 1  # smaller numbers have a class each
MAX_NS = (1 << 37) - 1  # 137 s; the last class counts all longer ones
CLASSES = (MAX_NS.bit_length() - PARTS_BITS + 1) << PARTS_BITS


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
        self._counts = [0] * CLASSES
        self._max_ns = 0
        self.figures = LatencyFigures()

    def take(self, ns: int) -> None:
        """Count a latency; a negative one, from different clocks, counts as zero."""
        if ns > self._max_ns:  # noqa: PLR1730  # faster than max()
            self._max_ns = ns
        if not 0 <= ns <= MAX_NS:
            ns = 0 if ns < 0 else MAX_NS
        shift = ns.bit_length() - WHOLE_BITS
        if shift < 0:  # noqa: PLR1730
            shift = 0
        self._counts[(shift << PARTS_BITS) + (ns >> shift)] += 1

    def roll(self) -> LatencyFigures:
        """Return the figures of the window and begin a new one."""
        totals = list(accumulate(self._counts))
        p50_ns, p99_ns = self._percentile_ns(totals, 50), self._percentile_ns(totals, 99)
        self.figures = LatencyFigures(p50_ns, p99_ns, self._max_ns, totals[-1])
        self._counts, self._max_ns = [0] * CLASSES, 0
        return self.figures

    def _percentile_ns(self, totals: list[int], percent: int) -> int:
        """Return the middle of the class that holds the smallest latency not exceeded by `percent` of all.

        The first 128 classes hold a single whole number each.
        """
        place = bisect_left(totals, ceil(totals[-1] * percent / 100))
        shift = max(0, (place >> PARTS_BITS) - 1)
        middle_ns = ((place - (shift << PARTS_BITS)) << shift) + (1 << shift >> 1)
        return min(middle_ns, self._max_ns)


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


class Health:
    """Status of one damper; rates, shares and latencies are of the last window that `roll` closed."""

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
        self._reported_episodes = self._reported_rests = 0  # in a status message
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
        self._before = now.copy()
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
            extrapolates = self._damper.model.body.extrapolates
            what = "of the forces extrapolated to inputs" if extrapolates else "of the forces from clamped inputs,"
            yield f"{self._outside:.1%} {what} outside what the model was identified on"
        if ok and self._held >= OUTSIDE_WARN:
            yield f"{self._held:.1%} of the forces held at the force envelope"
        if self.stillness.resting:
            yield f"the position has not changed for {self.stillness.last_s:.1f} s: at rest, or its sensor is stuck"
        elif self.stillness.count > self._reported_rests:
            yield f"the position has not changed for {self.stillness.last_s:.1f} s and does now"
        figures = self.position.figures
        if figures.dropped and figures.dropped >= DROPPED_WARN * (figures.samples + figures.dropped):
            share = figures.dropped / (figures.samples + figures.dropped)
            yield f"{share:.1%} of the positions {figures.describe_missing()}"
        if self.cost is not None and self.cost.drifted:
            snapshot = f"; snapshot {self.snapshots.state}" if self.snapshots is not None and self._recorded else ""
            yield f"re-identify: {self.cost.describe_drift()}{snapshot}"

    def _values(self) -> Values:
        damper, tally, stillness = self._damper, self._damper.tally, self.stillness
        yield "reason", damper.reason
        yield "rate [Hz]", f"{self._rate_Hz:.1f}"
        yield "age of the last position on arrival [s]", f"{damper.age_ns * 1e-9:.6f}"
        yield "share outside the envelope", f"{self._outside:.4f}"
        yield "inputs outside the envelope", f"are {damper.model.body.outside}"
        yield "position samples", str(tally.samples)
        yield "forces estimated", str(tally.estimates)
        if damper.model.best.sampling.delay_ticks:
            yield "delayed forces estimated", str(tally.late)
        if tally.held:
            yield "forces held at the force envelope", str(tally.held)
        yield "messages without the field", str(tally.unreadable)
        for reason, count in sorted(tally.withheld.items()):
            yield f"withheld: {reason}", str(count)
        yield from self.episodes.values()
        yield "position has not changed, times", str(stillness.count)
        if stillness.count:
            yield "position has not changed, last for [s]", f"{stillness.last_s:.3f}"
        yield from self.latency.figures.values("publish")
        for name, share in self._load._asdict().items():
            if share is not None:
                yield f"{name} load [% of a core]", f"{100.0 * share:.1f}"
        for name, stream in (("position", self.position), ("current", self.current), ("measured force", self.force)):
            yield from stream.figures.values(name)
        if self.cost is not None:
            yield from self.cost.values(self._evaluated)
        if self.snapshots is not None:
            yield "snapshot", self.snapshots.state
        yield from self._facts
