"""A selection problem: candidates and prepared series as the arrays on which the search works.

Constructed inputs are computed over whole arrays, and terms become the arrays that the kernels read. Alternating blocks
of ticks serve estimation (fit) and selection (cost of the free run), so that both cover every regime, such as a whole
sweep, and share no tick. Every recording has the same weight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_identify.limits import EnvelopeLimits, MisfitLimits, StabilityLimits, TickLimits
from ces_identify.numerics import kernels
from ces_identify.numerics.core import compile_tick, core_kernel
from ces_identify.numerics.kernels import TermArrays
from ces_identify.prepare.cost import EQUAL, Weighting, require_force
from ces_identify.prepare.series import Series
from ces_observer.errors import RecordingError
from ces_observer.flat import ArrayLayout
from ces_observer.model import Envelope
from ces_observer.structures.constructed_inputs import BASE, ConstructedInput, TriangularMembership, lay_out_constructed
from ces_observer.structures.polynomial import Factor, Term, collect_constructed
from ces_observer.structures.structure import Range
from ces_observer.tick.constructed import constructed_update, membership
from ces_observer.tick.model import clamp

Power = tuple[str, float, bool]  # signal, power, signed


clamp_value, update_inputs, membership_value = (
    compile_tick(clamp),
    compile_tick(constructed_update),
    compile_tick(membership),
)


def signal_values(
    constructed: Sequence[ConstructedInput], envelope: Envelope, inputs: F, segments: I, rate_Hz: float
) -> dict[str, F]:
    """Return position, speed and current (ticks,), clamped, and each constructed input as the observer computes it.

    `inputs` (3, ticks) are position [m], speed [m/s] and current [A]; they are clamped to `envelope`. In `constructed`,
    each follows those from which it is computed; outside `segments` they are zero.
    """
    layout = ArrayLayout(0, 0, len(BASE), 0)
    table, places = lay_out_constructed(layout, constructed, rate_Hz, 0)
    arrays = layout.arrays()
    p, n, s = np.array(arrays.p), np.array(arrays.n, np.int64), np.array(arrays.s)
    values = np.zeros((len(places), len(inputs[0])))
    values[: len(BASE)] = inputs
    _construct(p, n, s, table, np.array([envelope.by_signal[name] for name in BASE]), segments, values)
    return dict(zip(places, values, strict=True))


@core_kernel
def _construct(p: F, n: I, s: F, table: int, ranges: F, segments: I, values: F) -> None:
    """Clamp position, speed and current, the first rows of `values` (signals, ticks), and compute the other rows."""
    count = len(values) - 3
    for row in range(3):
        for i in range(values.shape[1]):
            values[row, i] = clamp_value(values[row, i], ranges[row, 0], ranges[row, 1])
    if count == 0:
        return
    for segment in range(len(segments)):
        for i in range(segments[segment, 0], segments[segment, 1]):
            for row in range(3):
                s[row] = values[row, i]
            update_inputs(p, n, s, table, count, 0, i > segments[segment, 0])
            for row in range(3, 3 + count):
                values[row, i] = s[row]


@core_kernel
def _memberships(values: F, low: float, peak: float, high: float) -> F:
    out = np.empty(len(values))
    for i in range(len(values)):
        out[i] = membership_value(values[i], low, peak, high)
    return out


@dataclass(frozen=True)
class TermLayout:
    """Terms as arrays, the powers in the table that they index, and the constructed inputs that they use."""

    powers: tuple[Power, ...]
    arrays: TermArrays
    constructed: tuple[ConstructedInput, ...] = ()

    def subset(self, chosen: I) -> TermArrays:
        """Return the arrays of the terms at the indices `chosen`."""
        return TermArrays(*(array[chosen] for array in self.arrays))

    def power_table(self, envelope: Envelope, inputs: F, segments: I, rate_Hz: float) -> F:
        """Return each power of its signal, shape (max(1, powers), ticks); for the inputs see `signal_values`."""
        values = signal_values(self.constructed, envelope, inputs, segments, rate_Hz)
        table = np.zeros((max(1, len(self.powers)), len(inputs[0])))
        for i, (signal, power, signed) in enumerate(self.powers):
            table[i] = kernels.power_row(values[signal], power, signed)
        return table

    def variable(self, term: int, factor: int) -> tuple[str, int]:
        """Return the signal and lag of which a factor is a function; for a membership, the signal behind it."""
        signal = self.powers[self.arrays.columns[term, factor]][0]
        hat = self._memberships.get(signal)
        return (hat.of if hat else signal), int(self.arrays.lags[term, factor])

    def factor_values(self, column: int, values: F) -> F:
        """Return row `column` of the power table at `values` (n,) of the factor's variable."""
        signal, power, signed = self.powers[column]
        hat = self._memberships.get(signal)
        return _memberships(values, *hat.ends) if hat else np.asarray(kernels.power_row(values, power, signed))

    def ranges(self, envelope: Envelope) -> dict[str, Range]:
        """Return the range of every signal, constructed ones included."""
        ranges = dict(envelope.by_signal)
        return ranges | {definition.name: definition.range(ranges) for definition in self.constructed}

    def kinks(self, signal: str) -> list[float]:
        """Return the values at which the memberships of a signal change slope, ascending."""
        return sorted({at for hat in self._memberships.values() if hat.of == signal for at in hat.kinks})

    @property
    def _memberships(self) -> dict[str, TriangularMembership]:
        return {hat.name: hat for hat in self.constructed if isinstance(hat, TriangularMembership)}


def lay_out_terms(terms: Sequence[Term]) -> TermLayout:
    """Return the arrays of `terms`, without their coefficients."""
    powers = sorted({_power(f) for term in terms for f in term.inputs})
    row = {power: i for i, power in enumerate(powers)}
    counts = np.array([len(term.inputs) for term in terms], np.int64)
    columns, lags = np.zeros((2, len(terms), int(counts.max(initial=1))), np.int64)
    for t, term in enumerate(terms):
        for f, factor in enumerate(term.inputs):
            columns[t, f], lags[t, f] = row[_power(factor)], factor.lag
    outputs = np.array([term.output_lag for term in terms], np.int64)
    return TermLayout(tuple(powers), TermArrays(columns, lags, counts, outputs), collect_constructed(terms))


def _power(factor: Factor) -> Power:
    return factor.signal, float(factor.power), factor.signed


BLOCK_S = 1.0  # length of a block [s]
ESTIMATION_BLOCKS, PERIOD_BLOCKS = 2, 3
CHUNK = 4096  # ticks per block of regressors held in memory


@dataclass(frozen=True)
class Problem:
    """Candidates, and the data for fits on the estimation ticks and for free runs on the selection ticks.

    `selection` and `everything` (ticks,) are the weights of the selection ticks and of all scored ticks in the free-run
    cost, `one_step` those of a least-squares fit with measured past forces. `probes` (n, points) are the
    inputs' factors over the envelope; the search skips models with a gain of `max_gain` or more there. For the other
    arrays see `kernels.ScoredRun`. `initial` are the indices of the terms from which the thesis' procedure starts.
    """

    candidates: tuple[Term, ...]
    layout: TermLayout
    envelope: Envelope
    force_envelope: Range
    powers: F
    measured: F
    segments: I
    recordings: I
    selection: F
    everything: F
    one_step: F
    probes: F
    max_gain: float
    initial: I = field(default_factory=lambda: np.empty(0, np.int64))

    @property
    def run(self) -> kernels.ScoredRun:
        """The data of a free run scored on the selection ticks."""
        data = self.powers, self.segments, self.recordings, self.selection, self.measured
        return kernels.ScoredRun(*data, self.force_envelope)

    @cached_property
    def estimation(self) -> F:
        """Weights (ticks,) of the estimation ticks in the free-run error, 0 elsewhere."""
        return np.where(self.selection > 0.0, 0.0, self.everything)

    @cached_property
    def gram(self) -> F:
        """Inner products (terms + 1, terms + 1) of the regressors and, last, the force, weighted by `one_step`."""
        n, weights = len(self.candidates), self.one_step
        gram = np.zeros((n + 1, n + 1))
        for s, k0, k1 in pieces(self.segments):
            if weights[k0:k1].any():
                rows = np.empty((n + 1, k1 - k0))
                rows[:n] = kernels.regressor_columns(
                    self.powers, self.measured, self.segments, self.layout.arrays, k0, k1, s
                )
                rows[n] = self.measured[k0:k1]
                rows *= np.sqrt(weights[k0:k1])
                gram += rows @ rows.T
        return gram

    def gain(self, chosen: I, coefficients: F) -> float:
        """Return the largest gain of past forces at the probed inputs of the terms at the indices `chosen`."""
        return float(kernels.probed_gain(self.probes[chosen], self.layout.arrays.outputs[chosen], coefficients))

    def selection_cost(self, chosen: I, coefficients: F) -> float:
        """Return the free-run cost J [%] of the terms at the indices `chosen` on the selection ticks."""
        room = np.empty((1 + len(chosen), kernels.BLOCK)), np.empty(self.powers.shape[1])
        return float(kernels.free_run_cost(self.run, self.layout.subset(chosen), coefficients, np.inf, *room))


def coarsen(problem: Problem, step: int) -> Problem:
    """Return the problem on every `step`-th tick, lags rounded; past forces keep their lags."""
    parts = [np.arange(start, stop, step) for start, stop in problem.segments]
    ends = np.cumsum([len(part) for part in parts])
    ticks, arrays = np.concatenate(parts), problem.layout.arrays
    arrays = arrays._replace(lags=np.rint(arrays.lags / step).astype(np.int64))
    return replace(
        problem,
        layout=replace(problem.layout, arrays=arrays),
        powers=np.ascontiguousarray(problem.powers[:, ticks]),
        measured=problem.measured[ticks],
        segments=np.stack([ends - [len(part) for part in parts], ends], axis=1),
        selection=step * problem.selection[ticks],
        one_step=problem.one_step[ticks],
        everything=step * problem.everything[ticks],
    )


def assemble_problem(
    series: Sequence[Series], candidates: Sequence[Term], stable: bool = True, weighting: Weighting = EQUAL
) -> Problem:
    """Return the problem of choosing among `candidates` on `series`; raises RecordingError if these hold too little.

    With `stable`, only models that are contractions at the probed inputs are considered. `weighting` applies to fit and
    cost.
    """
    for recorded in series:
        require_force(recorded)
    envelope = compute_envelope(series)
    layout = lay_out_terms(candidates)
    inputs = np.concatenate([s.inputs for s in series], axis=1)
    offsets = np.cumsum([0, *(len(s) for s in series[:-1])])
    stacked = np.concatenate([s.segments + offset for s, offset in zip(series, offsets, strict=True)])
    segments = np.ascontiguousarray(stacked, np.int64)
    recordings = np.repeat(np.arange(len(series)), [len(s.segments) for s in series]).astype(np.int64)
    powers = layout.power_table(envelope, inputs, segments, series[0].rate_Hz)
    measured = np.nan_to_num(np.concatenate([s.force for s in series]))
    weighting = weighting.with_common_stroke(series)
    everything = np.concatenate([_weights(s, s.scored, weighting) for s in series])
    selection = np.concatenate([_weights(s, s.scored & ~estimation_ticks(s), weighting) for s in series])
    one_step = _fit_weights(series, layout, weighting)
    if np.count_nonzero(one_step) < TickLimits.MIN_ERRORS:
        raise RecordingError(
            f"{np.count_nonzero(one_step)} estimation ticks; expected at least {TickLimits.MIN_ERRORS}: record longer"
        )
    forces = measured[everything > 0]
    margin = EnvelopeLimits.FORCE_MARGIN * float(np.ptp(forces))
    return Problem(
        candidates=tuple(candidates),
        layout=layout,
        envelope=envelope,
        force_envelope=(min(float(forces.min()) - margin, 0.0), max(float(forces.max()) + margin, 0.0)),
        powers=powers,
        measured=measured,
        segments=segments,
        recordings=recordings,
        selection=selection,
        everything=everything,
        one_step=one_step,
        probes=probe(layout, envelope),
        max_gain=StabilityLimits.PROBED_GAIN if stable else np.inf,
    )


def compute_envelope(series: Sequence[Series]) -> Envelope:
    """Return the range of each input over the scored ticks of all series, a little widened at both ends.

    What lies between two currents far apart is known as little as what lies beyond the last one.
    """

    def span(name: str) -> Range:
        values = [getattr(s, name)[s.scored] for s in series]
        low, high = min(v.min() for v in values), max(v.max() for v in values)
        margin = EnvelopeLimits.INPUT_MARGIN * (high - low)
        return float(low - margin), float(high + margin)

    gap = find_current_gap(np.concatenate([s.current[s.scored] for s in series]))
    return Envelope(span("position"), span("speed"), span("current"), gap)


def find_current_gap(current: F) -> Range | None:
    """Return the widest range of the current [A] that ticks (n,) hardly ever have, less the margins; None if narrow."""
    ordered, few = np.sort(current), int(EnvelopeLimits.MIN_SHARE * len(current)) + 1
    span, widths = float(np.ptp(ordered)), ordered[few:] - ordered[:-few]
    widest = int(np.argmax(widths))
    if span < MisfitLimits.MIN_CURRENT_SPAN_A or widths[widest] <= EnvelopeLimits.MAX_CURRENT_GAP * span:
        return None
    margin = EnvelopeLimits.INPUT_MARGIN * span
    return float(ordered[widest] + margin), float(ordered[widest + few] - margin)


def probe(layout: TermLayout, envelope: Envelope) -> F:
    """Return each term's product of input factors (terms, points) on a grid of the envelope, or at Sobol points."""
    columns, _, counts, outputs = layout.arrays
    rows = [{f: layout.variable(t, f) for f in range(count)} for t, count in enumerate(counts)]
    dimensions = sorted({key for t, row in enumerate(rows) if outputs[t] for key in row.values()})
    ranges = layout.ranges(envelope)
    inputs = _spread_points([ranges[s] for s, _ in dimensions], [layout.kinks(s) for s, _ in dimensions])
    points = np.ones((len(rows), inputs.shape[1]))
    for t, row in enumerate(rows):
        for f, key in row.items() if outputs[t] else ():
            points[t] *= layout.factor_values(columns[t, f], inputs[dimensions.index(key)])
    return points


def _spread_points(ranges: Sequence[Range], kinks: Sequence[Sequence[float]]) -> F:
    """Return points (ranges, n) over a box, denser towards zero; a grid also includes the `kinks` of each range."""
    if not ranges:
        return np.empty((0, 1))
    if len(ranges) <= 2:
        axes = [_from_zero(np.linspace(0.0, 1.0, n), ends) for n, ends in zip((81, 13), ranges[::-1], strict=False)]
        axes = [np.union1d(x, np.clip(at, *ends)) for x, at, ends in zip(axes, kinks[::-1], ranges[::-1], strict=True)]
        return np.array([axis.ravel() for axis in np.meshgrid(*axes)])[::-1].copy()
    from scipy.stats import qmc  # takes a third of the time in which `ces identify` starts

    inside = qmc.Sobol(len(ranges), seed=0).random(1024).T
    return np.array([_from_zero(unit, ends) for unit, ends in zip(inside, ranges, strict=True)])


def _from_zero(unit: F, ends: Range) -> F:
    """Return the numbers at the shares `unit` of the range `ends`, denser towards zero if it contains zero."""
    low, high = ends
    if not low < 0.0 < high:
        return low + (high - low) * unit
    side = 2.0 * unit - 1.0
    return np.asarray(np.where(side < 0.0, -low, high) * side * np.abs(side))


def pieces(segments: I) -> Iterator[tuple[int, int, int]]:
    """Yield pieces of at most CHUNK ticks: the index of the segment, the first tick and the one after the last."""
    for s, (start, stop) in enumerate(segments):
        for k0 in range(start, stop, CHUNK):
            yield s, k0, min(k0 + CHUNK, stop)


def estimation_ticks(series: Series) -> Mask:
    """Return a mask (ticks,) of the estimation ticks; the other ticks of an identified series serve selection."""
    block = np.arange(len(series)) // max(1, round(BLOCK_S * series.rate_Hz))
    return np.asarray(block % PERIOD_BLOCKS < ESTIMATION_BLOCKS)


def _weights(series: Series, ticks: Mask, weighting: Weighting) -> F:
    """Return w / sum w (y - mean y)^2 on `ticks`, 0 elsewhere, so that the weighted squared error is (J / 100)^2."""
    weights, force = np.where(ticks, weighting.tick_weights(series), 0.0), np.where(ticks, series.force, 0.0)
    mean = float(weights @ force) / max(float(weights.sum()), 1e-300)
    spread = float(weights @ (force - mean) ** 2)
    if spread <= 0.0:
        raise RecordingError(f"{series.name}: too short for estimation and selection; expected more than 4 s")
    return weights / spread


def _fit_weights(series: Sequence[Series], layout: TermLayout, weighting: Weighting) -> F:
    """Return the least-squares weights (ticks,): 0 off the estimation ticks and where a past force was not measured."""
    depth = int(layout.arrays.outputs.max(initial=0))
    weights = []
    for recorded in series:
        finite = np.isfinite(recorded.force)
        usable = finite.copy()
        for lag in range(1, depth + 1):
            usable[lag:] &= finite[:-lag]
        for start, _ in recorded.segments:
            usable[start : start + depth] = False
        own = weighting.tick_weights(recorded)
        scale = _weights(recorded, recorded.scored, weighting).sum() / max(own[recorded.scored].sum(), 1e-300)
        weights.append(np.where(usable & estimation_ticks(recorded), scale * own, 0.0))
    return np.concatenate(weights)
