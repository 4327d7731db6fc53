"""The free run of a model on a recording: its cost J with an interval, the noise floor, and exits from the envelope.

J is a ratio of two sums. The influence of a tick on its logarithm is, to first order,

    (e^2 / sum(e^2) - (y - mean y)^2 / sum((y - mean y)^2)) / 2

and `ces_identify.numerics.correlation` gives the standard error of the sum of that over each recording, with what it
assumes on slow changes. The interval is J times and divided by one factor. It says how J would vary over other
stretches of the same experiments.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_identify.limits import BandLimits, EnvelopeLimits, ErrorLimits, MisfitLimits, TickLimits
from ces_identify.numerics.correlation import add_errors, estimate_sum_error, sum_bins
from ces_identify.prepare.cost import Weighting, require_force, series_cost, weighted_cost
from ces_identify.prepare.sampling import delay_text
from ces_identify.prepare.series import DROPPED_OUTLIER, FreeRun, Series
from ces_identify.simulations.simulate import is_outside, simulate_series
from ces_identify.validation.band import band_half_width
from ces_identify.validation.cost_frame import FramedResult
from ces_identify.validation.cycle_noise import CycleNoise, cycle_noise
from ces_observer.model import Model
from ces_observer.structures.structure import Range
from ces_report.typesetting import format_alike

IDENTIFICATION, VALIDATION = "identification", "validation"
UNITS = {"position": "m", "speed": "m/s", "current": "A"}
WORKING, MOST = 0.5, 0.9  # a window works with this share of the work that this quantile of windows has
DIVERGED = "no interval and no RMS error (the simulated force is not finite)"
SHORT = f"no interval (too short: it would reach beyond {ErrorLimits.MAX_FACTOR:g} times the cost)"


@dataclass(frozen=True)
class RangeUse:
    """One signal: the range `used` by a recording, the range `known` to the model, and the share of ticks outside.

    `gap` says in words what the model does not know within its range.
    """

    signal: str
    used: tuple[float, float]
    known: tuple[float, float]
    outside_share: float
    gap: str = ""

    def as_texts(self) -> tuple[str, str]:
        """Return the ranges used and known as text, without their unit; all numbers have the same decimals."""
        ends = format_alike((*self.used, *self.known))
        used, known = (f"{low} to {high}" if low != high else low for low, high in (ends[:2], ends[2:]))
        return used, known + self.gap

    def __str__(self) -> str:
        used, known = self.as_texts()
        return f"{self.signal} {used} {UNITS[self.signal]}, model knows {known}"


@dataclass(frozen=True, repr=False)
class Evaluation(FramedResult):
    """The free run of a model on one series. `role` is IDENTIFICATION if fit or selection used it, else VALIDATION.

    `half_width` (ticks,) [N] is that of the model's band, None if it has none. `outside` are the signals that leave the
    model's envelope.
    """

    name: str
    role: str
    series: Series
    run: FreeRun
    cost: float
    half_width: F | None = None
    outside: tuple[RangeUse, ...] = ()

    @property
    def error(self) -> F:
        """Measured minus simulated force [N] on the scored ticks, shape (n,)."""
        scored = self.series.scored
        return np.asarray(self.series.force[scored] - self.run.force[scored])

    @property
    def rms_N(self) -> float:
        """Root mean square of the error [N]."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def scored_s(self) -> float:
        """Scored time [s]."""
        return float(self.series.scored.sum()) / self.series.rate_Hz

    @cached_property
    def interval(self) -> CostInterval | None:
        """The interval of J; None if the run diverged or the recording is too short."""
        return cost_interval([self])

    @cached_property
    def noise(self) -> CycleNoise | str:
        """The noise floor from repeated cycles, or why there is none."""
        return cycle_noise(self.series)

    @property
    def floor(self) -> float | None:
        """The cost J [%] that noise alone causes; None where cycles do not repeat."""
        return self.noise.floor if isinstance(self.noise, CycleNoise) else None

    @property
    def clamped_share(self) -> float:
        """Share of the scored ticks with inputs outside the model's envelope."""
        return float(self.run.clamped[self.series.scored].mean())

    @property
    def held_share(self) -> float:
        """Share of the scored ticks whose force was held at an end of the force envelope."""
        return float(self.run.held[self.series.scored].mean())

    @property
    def outside_share(self) -> float:
        """Share of the scored ticks with inputs or force outside the model's envelopes; NaN of what has none."""
        if not math.isfinite(self.run.force_envelope_N[0]):
            return math.nan
        return float((self.run.clamped | self.run.held)[self.series.scored].mean())

    @property
    def outside_text(self) -> str:
        """The share of the time outside the envelope, with the ranges of the signals; empty if hardly any."""
        return describe_outside(self.name, self.clamped_share, self.outside) if self.outside else ""

    @property
    def held_text(self) -> str:
        """The share of the time with the force held at its envelope; empty if there is none."""
        scored = self.series.scored
        return describe_held(self.name, self.run.force_envelope_N, self.series.time_s[scored], self.run.held[scored])

    @property
    def lost_text(self) -> str:
        """For how much of the measured time there is no force, and why; empty if it is little."""
        measured = int(np.isfinite(self.series.force).sum())
        return describe_lost(self.name, 1.0 - float(self.series.scored.sum()) / max(measured, 1), self.series)

    @property
    def late_text(self) -> str:
        """For how much of the time the vehicle would withhold the force that counts here; empty if it is little."""
        if self.series.unsettled <= TickLimits.MAX_LATE:
            return ""
        share = f"{100.0 * self.series.unsettled:.0f} % of the positions, whose forces count here"
        return f"{self.name}: on the vehicle there is no force at {share}: {self.series.rates}"

    @property
    def band_text(self) -> str:
        """That the band holds far less than it is meant for; empty if it does not."""
        if self.coverage is None or self.coverage >= BandLimits.MIN_HELD:
            return ""
        share = f"{100.0 * self.coverage:.0f} % of the measured forces, not the {100.0 * BandLimits.LEVEL:.0f} %"
        return f"{self.name}: the band holds {share} that it is meant for"

    @property
    def rest_text(self) -> str:
        """That the damper hardly works, so that a small error is a large J; empty if it does, or J is small."""
        force, (low, high) = self.series.force[self.series.scored], self.run.force_envelope_N
        if self.cost < MisfitLimits.MISFIT_J or not force.std() < EnvelopeLimits.MIN_FORCE * (high - low) < math.inf:
            return ""
        text = (
            f"the measured force varies by {force.std():.3g} N (standard deviation), of {low:.0f} to {high:.0f} N that"
        )
        return f"{self.name}: {text} the model may give: J is relative to that, and the RMS error is {self.rms_N:.3g} N"

    @property
    def warnings(self) -> list[str]:
        """What is wrong with the run, or with its J; empty if little is."""
        texts = (self.lost_text, self.late_text, self.outside_text, self.held_text, self.band_text, self.rest_text)
        return [text for text in texts if text]

    @property
    def coverage(self) -> float | None:
        """Share of the scored ticks with a band whose measured force is within it; None if hardly any has one."""
        if self.half_width is None:
            return None
        half = self.half_width[self.series.scored]
        banded = np.isfinite(half) | ~np.isfinite(self.error)
        if not banded.all() and banded.sum() < TickLimits.MIN_ERRORS:
            return None
        return float(np.mean((np.abs(self.error) <= half)[banded]))

    def weighted_cost(self, weighting: Weighting) -> float:
        """Return the weighted J [%]; NaN where no weighted tick is scored."""
        scored = self.series.scored
        return weighted_cost(
            self.series.force[scored], self.run.force[scored], weighting.tick_weights(self.series)[scored]
        )


def describe_size(model: Model) -> str:
    """Return the size of a model in words, with its delay if there is one."""
    return model.size + (f" ({delay_text(delay_s)})" if (delay_s := model.sampling.delay_s) else "")


def evaluate(model: Model, series: Sequence[Series], role: str) -> list[Evaluation]:
    """Return the evaluation of `model` on each series; raises RecordingError for a series without a force."""
    for recorded in series:
        require_force(recorded)
    runs = [simulate_series(model, recorded) for recorded in series]
    return [
        Evaluation(
            name=recorded.name,
            role=role,
            series=recorded,
            run=run,
            cost=series_cost(recorded, run.force),
            half_width=None
            if model.band is None
            else band_half_width(model.band, recorded, run.force, model.used_gap_A),
            outside=outside_ranges(model, recorded),
        )
        for recorded, run in zip(series, runs, strict=True)
    ]


@dataclass(frozen=True, repr=False)
class CostInterval:
    """J is between `low` and `high` [%] with probability LEVEL."""

    low: float
    high: float

    def __repr__(self) -> str:
        return f"CostInterval(low={self.low:.4g}, high={self.high:.4g})"


@dataclass(frozen=True)
class ScoredTicks:
    """The scored ticks of a recording in order: `squares` of the error (n,) [N²] and measured `force` (n,) [N]."""

    squares: F
    force: F
    rate_Hz: float

    @property
    def spread(self) -> F:
        """Squared distance of the force from its mean (n,) [N²]."""
        return np.asarray((self.force - self.force.mean()) ** 2)


def cost_interval(evaluations: Sequence[Evaluation]) -> CostInterval | None:
    """Return the interval of J over all `evaluations` together; None if a run diverged or they are too short.

    Errors and forces are pooled, each force relative to its recording's mean.
    """
    if not all(np.isfinite(evaluation.cost) for evaluation in evaluations):
        return None
    return interval_of_ticks([scored_ticks(e) for e in evaluations])


def interval_of_ticks(recordings: Sequence[ScoredTicks]) -> CostInterval | None:
    """Return the interval of J over recordings of finite forces; None if they are too short."""
    squares, spread = _sums(recordings)
    influences = [  # of each bin on the logarithm of J
        sum_bins(0.5 * (ticks.squares / max(squares, 1e-300) - ticks.spread / spread), ticks.rate_Hz)
        for ticks in recordings
    ]
    if min(map(len, influences)) < ErrorLimits.MIN_BINS:
        return None
    seconds = [len(ticks.force) / ticks.rate_Hz for ticks in recordings]
    error = add_errors([estimate_sum_error(x, s) for x, s in zip(influences, seconds, strict=True)])
    factor = float(np.exp(error.half_width(ErrorLimits.LEVEL)))
    cost = 100.0 * float(np.sqrt(squares / spread))
    return CostInterval(cost / factor, cost * factor) if factor <= ErrorLimits.MAX_FACTOR else None


def pooled_cost(evaluations: Sequence[Evaluation]) -> float:
    """Return J [%] over all ticks of `evaluations`, each force relative to its recording's mean."""
    squares, spread = _sums([scored_ticks(e) for e in evaluations])
    return float(100.0 * np.sqrt(squares / spread))


def scored_ticks(evaluation: Evaluation) -> ScoredTicks:
    """Return the scored ticks of `evaluation`."""
    series = evaluation.series
    return ScoredTicks(evaluation.error**2, series.force[series.scored], series.rate_Hz)


def _sums(recordings: Sequence[ScoredTicks]) -> tuple[float, float]:
    return sum(float(t.squares.sum()) for t in recordings), sum(float(t.spread.sum()) for t in recordings)


@dataclass(frozen=True)
class PooledCost:
    """Several free runs together: their `number`, scored time [s], and J [%] with its interval."""

    number: int
    scored_s: float
    cost: float
    interval: CostInterval | None


def pool_evaluations(evaluations: Sequence[Evaluation]) -> PooledCost | None:
    """Return J over several free runs together; None for fewer than two."""
    if len(evaluations) < 2:
        return None
    seconds = sum(e.scored_s for e in evaluations)
    return PooledCost(len(evaluations), seconds, pooled_cost(evaluations), cost_interval(evaluations))


def explain_missing(evaluations: Sequence[Evaluation], floors: bool = True) -> list[str]:
    """Return a line for each reason why a figure is missing, with the names of the recordings.

    The line is such as `no noise floor (the stroke does not repeat): noise, road`, or `...: all recordings`. Without
    `floors` nothing is said of the noise floor.
    """
    names: dict[str, list[str]] = {}
    for evaluation in evaluations:
        if not math.isfinite(evaluation.cost):
            names.setdefault(DIVERGED, []).append(evaluation.name)
        elif evaluation.interval is None:
            names.setdefault(SHORT, []).append(evaluation.name)
        if floors and isinstance(evaluation.noise, str):
            names.setdefault(f"no noise floor ({evaluation.noise})", []).append(evaluation.name)
    return [
        f"{reason}: {'all recordings' if 1 < len(evaluations) == len(some) else ', '.join(dict.fromkeys(some))}"
        for reason, some in names.items()
    ]


def outside_ranges(model: Model, series: Series) -> tuple[RangeUse, ...]:
    """Return the signals that the model uses and that leave its envelope on the scored ticks, the longest first.

    Without scored ticks (no measured force) all ticks count.
    """
    ticks = series.scored if series.scored.any() else np.ones(len(series), bool)
    return find_outside(model, {name: getattr(series, name)[ticks] for name in UNITS})


def find_outside(model: Model, signals: Mapping[str, F]) -> tuple[RangeUse, ...]:
    """Return the same for arrays (n,) of position [m], speed [m/s] and current [A] by name."""
    uses = []
    for name, known in model.used_ranges.items():
        values = signals.get(name, np.empty(0))
        share = float(np.mean(is_outside(model, name, values))) if len(values) else 0.0
        if share > EnvelopeLimits.MIN_SHARE:
            gap = model.envelope.gap_text if name == "current" else ""
            uses.append(RangeUse(name, (float(values.min()), float(values.max())), known, share, gap))
    return tuple(sorted(uses, key=lambda use: -use.outside_share))


def describe_outside(name: str, share: float, uses: Sequence[RangeUse]) -> str:
    """Return as text that recording `name` is outside for a share of the time, with the ranges of its signals."""
    return f"{name} is outside the model's envelope for {100.0 * share:.1f} % of the time: {'; '.join(map(str, uses))}"


def describe_lost(name: str, share: float, series: Series) -> str:
    """Return as text that there is no force for a share of the time, and why; empty if it is little."""
    if share <= (TickLimits.MAX_LATE if series.unsettled > TickLimits.MAX_LATE else TickLimits.MAX_LOST):
        return ""
    lost = "".join(f"{count} positions dropped ({why}), " for why, count in series.dropped.items() if count)
    count = len(series.segments)
    starts = f"each of {count} starts" if count > 1 else "the start"
    warm_up = f"a warm-up of {series.warm_up / series.rate_Hz:g} s"
    most = max(filter(series.dropped.get, series.dropped), key=series.dropped.__getitem__, default="")
    cause = "; it moves faster, or with more noise, than the recordings of the model" if most == DROPPED_OUTLIER else ""
    if not cause and series.unsettled > TickLimits.MAX_LATE:
        cause = f"; {series.rates}"
    return f"{name}: no force for {100.0 * share:.1f} % of the time: {lost}{warm_up} after {starts}{cause}"


def describe_held(name: str, force_envelope_N: Range, time_s: F, held: Mask) -> str:
    """Return as text for how much of the times (n,) [s] on recording `name` the force was held; empty if never."""
    if not held.any():
        return ""
    ends = "{:.0f} to {:.0f} N".format(*force_envelope_N)
    share = f"{100.0 * held.mean():.3g} % of the time, first at {time_s[held.argmax()]:.2f} s"
    doubt = ": the model does not fit this recording" if held.mean() > EnvelopeLimits.MIN_SHARE else ""
    return f"{name}: the force was held at its envelope ({ends}) for {share}{doubt}"


def find_working_windows(length: int, scored: Mask, force: F, speed: F, squares: F) -> tuple[I, F]:
    """Return the starts of the windows of `length` ticks in which the damper works, and the mean of `squares` in each.

    The damper works where the product of RMS speed and RMS variation of the force is large. Only windows with the most
    scored ticks count.
    """

    def sliding_sum(values: F | float) -> F:
        total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(np.where(scored, values, 0.0)))])
        return np.asarray(np.maximum(total[length:] - total[:-length], 0.0))

    count = sliding_sum(1.0)
    full = np.flatnonzero(count == count.max())
    work = np.sqrt(sliding_sum(speed**2) * sliding_sum((force - force[scored].mean()) ** 2))[full]
    starts = full[work >= WORKING * np.quantile(work, MOST)]
    return starts, sliding_sum(squares)[starts] / max(count.max(), 1.0)
