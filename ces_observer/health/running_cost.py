"""The running cost J of the estimate against a measured force: pairs of both by stamp, over a window."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite, sqrt

from ces_observer.health.diagnostics import Figures
from ces_observer.limits import RunningCostLimits
from ces_observer.model import Model

HISTORY = 2048  # estimates, and measured forces that wait for one: two seconds at 1 kHz


class ForcePairs:
    """Calls `on_pair(stamp_ns, measured_N, estimated_N)` for each measured force between two estimates.

    The estimate at its stamp is interpolated linearly, unless the two are further apart than `max_gap_s`. `unpaired`
    counts the measured forces without an estimate.
    """

    def __init__(self, on_pair: Callable[[int, float, float], None], max_gap_s: float) -> None:
        self._on_pair = on_pair
        self._max_gap_ns = round(max_gap_s * 1e9)
        self._waiting: deque[tuple[int, float]] = deque()
        self._stamps: list[int] = []
        self._estimates: list[float] = []
        self.unpaired = 0

    def add_estimate(self, stamp_ns: int, force_N: float) -> None:
        """Add an estimate; one that is not later than the last shows that time was set back."""
        stamps = self._stamps
        if stamps and stamp_ns <= stamps[-1]:
            self.unpaired += len(self._waiting)
            self._waiting.clear()
            stamps.clear()
            self._estimates.clear()
        elif len(stamps) >= 2 * HISTORY:
            del stamps[:HISTORY], self._estimates[:HISTORY]
        stamps.append(stamp_ns)
        self._estimates.append(force_N)
        waiting = self._waiting
        while waiting and waiting[0][0] <= stamp_ns:
            self._pair(*waiting.popleft())

    def add_measured(self, stamp_ns: int, force_N: float) -> None:
        """Add a finite measured force."""
        if self._stamps and stamp_ns <= self._stamps[-1]:
            self._pair(stamp_ns, force_N)
            return
        if len(self._waiting) >= HISTORY:
            self._waiting.popleft()
            self.unpaired += 1
        self._waiting.append((stamp_ns, force_N))

    def _pair(self, stamp_ns: int, measured_N: float) -> None:
        """Pair a measured force that is stamped no later than the newest estimate."""
        stamps, estimates = self._stamps, self._estimates
        after = bisect_left(stamps, stamp_ns)
        if stamps[after] == stamp_ns:
            self._on_pair(stamp_ns, measured_N, estimates[after])
            return
        step_ns = stamps[after] - stamps[after - 1] if after else 0
        if not 0 < step_ns <= self._max_gap_ns:
            self.unpaired += 1
            return
        share = (stamp_ns - stamps[after - 1]) / step_ns
        before = estimates[after - 1]
        self._on_pair(stamp_ns, measured_N, before + share * (estimates[after] - before))


SECOND_NS = 1_000_000_000


class RunningCost:
    """Running J [%] of one damper.

    `window_s` is in whole seconds; `warn_J` [%] is the threshold; below `min_N`, a standard deviation of the measured
    force [N], there is no cost; `max_gap_s` is the longest interval between two estimates around a measured force.
    After each whole second of stamps: `spread_N` is the standard deviation in the window; `J` the cost, or None;
    `drifted` becomes True when J and the cost of at least three single seconds exceed the threshold, and False when J
    has stayed below 0.8 of it for three seconds. `paired` counts the measured forces used, `ignored` those that are not
    finite, `unpaired` those without estimates around them.
    """

    def __init__(self, window_s: int = 10, warn_J: float = 20.0, min_N: float = 20.0, max_gap_s: float = 0.05) -> None:
        self.warn_J, self.min_N = warn_J, min_N
        self._pairs = ForcePairs(self._take, max_gap_s)
        self.add_estimate = self._pairs.add_estimate  # takes (stamp_ns, force_N); direct, as it is called often
        self.ignored = self.paired = 0
        self._seconds: deque[_Second] = deque(maxlen=window_s)
        self.drifted = False
        self._restart(0)

    @classmethod
    def from_model(cls, model: Model, warn_J: float | None = None, window_s: int = 10) -> RunningCost:
        """Return the running cost of a model; `warn_J` defaults to `default_warn_J`."""
        low, high = model.force_envelope_N
        min_N = max(RunningCostLimits.MIN_FORCE_N, RunningCostLimits.MIN_FORCE_SHARE * (high - low))
        warn_J = default_warn_J(model) if warn_J is None else warn_J
        return cls(window_s, warn_J, min_N, model.sampling.max_gap_s)

    @property
    def unpaired(self) -> int:
        """Measured forces without estimates around them."""
        return self._pairs.unpaired

    def add_measured(self, stamp_ns: int, force_N: float) -> None:
        """Add a measured force."""
        if isfinite(force_N):
            self._pairs.add_measured(stamp_ns, force_N)
        else:
            self.ignored += 1

    def describe_drift(self) -> str:
        """Return a sentence about a cost above its threshold."""
        known = "unknown" if self.J is None else f"{self.J:.1f}%"
        return f"the cost J against the measured force is {known}, expected below {self.warn_J:.1f}%"

    def values(self, evaluated: bool) -> Iterator[tuple[str, str]]:
        """Yield the key-value pairs for diagnostics; `evaluated` is True if the last window had pairs."""
        yield Figures.COST.of(self.J if evaluated else None)
        yield Figures.COST_LIMIT.of(self.warn_J)
        yield Figures.FORCE_SPREAD.of(self.spread_N)
        yield Figures.FORCES_NOT_FINITE.of(self.ignored)
        yield Figures.FORCES_UNPAIRED.of(self.unpaired)

    def _restart(self, stamp_ns: int) -> None:
        self._seconds.clear()
        self._second = _Second()
        self._end_ns = stamp_ns + SECOND_NS
        self._good = 0
        self.J: float | None = None
        self.spread_N = 0.0

    def _take(self, stamp_ns: int, measured_N: float, estimated_N: float) -> None:
        """Add a pair to the present second, even if its stamp is older."""
        if not -RunningCostLimits.LATE_S * SECOND_NS <= stamp_ns - self._end_ns < 0:
            self._end_second(stamp_ns)
        self.paired += 1
        second, error_N = self._second, estimated_N - measured_N
        second.pairs += 1
        second.force += measured_N
        second.force2 += measured_N * measured_N
        second.error2 += error_N * error_N

    def _end_second(self, stamp_ns: int) -> None:
        """End a second of stamps and evaluate the window, or restart after a pause or a time jump."""
        if not 0 <= stamp_ns - self._end_ns < SECOND_NS:
            self._restart(stamp_ns)
            return
        self._seconds.append(self._second)
        self._second = _Second()
        self._end_ns += SECOND_NS
        pairs = sum(second.pairs for second in self._seconds)
        if not pairs:
            self.J, self.spread_N = None, 0.0
            return
        mean = sum(second.force for second in self._seconds) / pairs
        variance = sum(second.force2 for second in self._seconds) / pairs - mean * mean
        self.spread_N = sqrt(max(0.0, variance))
        if pairs < RunningCostLimits.MIN_PAIRS or self.spread_N < self.min_N:
            self.J = None
            return
        error_N = sqrt(sum(second.error2 for second in self._seconds) / pairs)
        self.J = 100.0 * error_N / self.spread_N
        limit_N = self.warn_J * self.spread_N / 100.0
        bad = sum(second.error_N > limit_N for second in self._seconds)
        self._good = self._good + 1 if error_N < RunningCostLimits.GOOD * limit_N else 0
        self.drifted = (
            self._good < RunningCostLimits.BAD_SECONDS
            if self.drifted
            else error_N > limit_N and bad >= RunningCostLimits.BAD_SECONDS
        )


@dataclass
class _Second:
    """Sums over the pairs of a second: their number, measured forces, squares of these and of the errors."""

    pairs: int = 0
    force: float = 0.0
    force2: float = 0.0
    error2: float = 0.0

    @property
    def error_N(self) -> float:
        """Root of the mean squared error [N]."""
        return sqrt(self.error2 / self.pairs) if self.pairs else 0.0


def default_warn_J(model: Model) -> float:
    """Return twice the worst validation (else identification) cost in its provenance, at least 10.

    The provenance is not checked on loading: entries that are not costs are skipped.
    """
    rows = model.provenance.get("cost_J_percent")
    costs: dict[object, list[float]] = {}
    for row in rows if isinstance(rows, list) else ():
        if isinstance(row, Mapping) and isinstance(row.get("J"), int | float) and isfinite(row["J"]):
            costs.setdefault(row.get("role"), []).append(float(row["J"]))
    values = costs.get("validation") or costs.get("identification") or [0.0]
    return max(RunningCostLimits.MIN_WARN_J, RunningCostLimits.WARN_RATIO * max(values))
