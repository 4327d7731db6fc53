"""Training of recurrent networks: stacked series in, AdamW on the free-run error of windows drawn at random.

A fit has a fixed number of steps, so that it depends on data and seed alone. In its second half the free run on the
selection ticks is computed now and then, and the parameters with the lowest cost are kept.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics.core import run_batch
from ces_identify.polynomial.search_limits import Limits, Listener, SearchResult, reason_to_end
from ces_identify.trained.recurrent_kernels import MemberArrays, StageArrays, new_states, run_member, run_member_back
from ces_identify.trained.training import Training
from ces_observer.errors import CesError
from ces_observer.model import Envelope
from ces_observer.structures.recurrent import CURRENT, MOTION, POSITION, SPEED, Member, Recurrent, ScaledInput, Stage
from ces_observer.structures.structure import OperatingRange

FASTEST_S, SLOWEST_S = 1.5e-3, 0.1  # decay times of the filters
FILTERS, TANHS, BETWEEN = 8, 12, 8  # of a stage of the motion, and outputs of the first one
CURRENT_FILTERS, CURRENT_TANHS, FACTORS = 2, 4, 2
SMOOTHING = 0.05  # of the root of the speed, relative to the speed's spread
FIRST_BIAS = 0.3  # standard deviation of a start's biases

STEPS = 5000
WARM_STEPS = 50  # over which the rate rises
RATE = 2.5e-2  # of the first step after these; falls with a cosine to 0
DECAY = 0.03  # of weights, a step and rate
MEAN_BETA, SQUARE_BETA, MIN_ROOT = 0.9, 0.999, 1e-8  # of AdamW (Loshchilov & Hutter 2019)
MAX_GRADIENT = 1.0
WINDOW_S, MIN_WINDOW, MAX_WINDOW = 0.27, 400, 800  # length of a window, and its limits [ticks]
UNSCORED = 0.25  # of a window, at its beginning, without a weight
STEP_TICKS, MIN_LANES = 4800, 8  # of all windows of a step, and least number of these
REST_WEIGHT = 0.1  # of a damper at rest, for which no recording is needed
CHECKS = 12  # free runs on the selection ticks, evenly spaced in the second half
POLL_STEPS = 20  # between two looks at the clock
HOPELESS = "far from the best of other structures"


@dataclass(frozen=True)
class StageShape:
    """Numbers of inputs, filters, tanh and outputs of a stage."""

    inputs: int
    filters: int
    tanhs: int
    outputs: int

    @property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Shapes of the parameters: decay and turn of the filters, then as in `StageArrays`."""
        states = 2 * self.filters + self.inputs
        return (
            (2, self.filters),
            (2 * self.filters, self.inputs),
            (self.tanhs, states),
            (self.tanhs,),
            (self.outputs, self.tanhs + states),
            (self.outputs,),
        )


@dataclass(frozen=True)
class Filters:
    """Filters of the parameters (2, filters): decay time [s], size of the pole, angle [rad a tick], gain."""

    decay_s: F
    size: F
    angle: F
    gain: F
    slope: F  # of the logarithm of the decay time, by its parameter

    @classmethod
    def of(cls, params: F, tick_s: float) -> Filters:
        """Return the filters; a decay time stays within FASTEST_S and SLOWEST_S for any parameter."""
        share, span = 1.0 / (1.0 + np.exp(-params[0])), np.log(SLOWEST_S / FASTEST_S)
        decay = FASTEST_S * np.exp(span * share)
        size = np.exp(-tick_s / decay)
        return cls(decay, size, params[1] * tick_s / decay, np.sqrt(1.0 - size**2), span * share * (1.0 - share))

    @property
    def poles(self) -> F:
        """Real and imaginary parts (2, filters)."""
        return np.stack([self.size * np.cos(self.angle), self.size * np.sin(self.angle)])

    def gradient(self, by_poles: F, by_gain: F, tick_s: float) -> F:
        """Return the derivatives by the parameters, from those by poles and gain."""
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        by_size = by_poles[0] * cosine + by_poles[1] * sine - by_gain * self.size / self.gain
        by_angle = self.size * (by_poles[1] * cosine - by_poles[0] * sine)
        by_decay = by_size * self.size * tick_s / self.decay_s - by_angle * self.angle
        return np.stack([by_decay * self.slope, by_angle * tick_s / self.decay_s])


@dataclass(frozen=True)
class RecurrentFamily:
    """Networks on the inputs of `training` that change; parameters are one vector (parameters,) for each member.

    Inputs are scaled by mean and spread.
    """

    training: Training
    rate_Hz: float
    smoothing_m_s: float
    motion: tuple[ScaledInput, ...]
    current: tuple[ScaledInput, ...]

    @cached_property
    def stages(self) -> tuple[StageShape, ...]:
        """The stages of a member."""
        outputs = 1 + FACTORS * len(self.current)
        first = StageShape(len(self.motion), FILTERS, TANHS, BETWEEN), StageShape(BETWEEN, FILTERS, TANHS, outputs)
        return (*first, StageShape(1, CURRENT_FILTERS, CURRENT_TANHS, FACTORS)) if self.current else first

    @cached_property
    def size(self) -> int:
        """Number of parameters of a member."""
        return sum(int(np.prod(shape)) for stage in self.stages for shape in stage.shapes)

    @cached_property
    def rows(self) -> tuple[F, F]:
        """Scaled inputs of motion and current (n, ticks)."""
        t = self.training
        return scaled_inputs(self.motion, self.current, self.smoothing_m_s, t.envelope, t.inputs)

    @property
    def still(self) -> F:
        """The scaled inputs (3,) of a speed of zero."""
        return np.array([-one.mean / one.spread for one in self.motion[:3]])

    def at_rest(self, weights: F) -> F:
        """Return the scaled force (ticks,) at rest: its part that is linear in the position, beside the speed's."""
        motion, current = self.rows
        speed = motion[:3] - self.still[:, None]
        rows = np.concatenate([np.ones((1, motion.shape[1])), motion[3:], speed, *(speed * row for row in current)])
        roots = np.sqrt(weights)
        factors = np.linalg.lstsq((rows * roots).T, roots * self.training.measured / self.training.scale_N, rcond=None)[
            0
        ]
        factors[len(motion) - 2 :] = 0.0
        return np.asarray(factors @ rows)

    @cached_property
    def decayed(self) -> F:
        """1 for weights, 0 for biases and filters (parameters,)."""
        marks = np.zeros(self.size)
        for _, drive, hidden, _, out, _ in self.split(marks):
            for matrix in (drive, hidden, out):
                matrix[:] = 1.0
        return marks

    def split(self, params: F) -> list[list[F]]:
        """Return views of the parameters by stage, in the order of `StageShape.shapes`."""
        shapes = [shape for stage in self.stages for shape in stage.shapes]
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
        views = [part.reshape(shape) for part, shape in zip(np.split(params, ends[:-1]), shapes, strict=True)]
        return [views[k : k + 6] for k in range(0, len(views), 6)]

    def start(self, random: np.random.Generator) -> F:
        """Return random parameters: decay times over the whole range, outputs of about 1, the mean force."""
        params = np.zeros(self.size)
        for filters, drive, hidden, hidden_bias, out, _ in self.split(params):
            count = filters.shape[1]
            share = np.clip((np.arange(count) + random.uniform(0.2, 0.8, count)) / count, 0.02, 0.98)
            filters[:] = np.log(share / (1.0 - share)), random.normal(0.0, 1.0, count)
            for matrix in (drive, hidden, out):
                matrix[:] = random.normal(0.0, 1.0 / np.sqrt(matrix.shape[1]), matrix.shape)
            hidden_bias[:] = random.normal(0.0, FIRST_BIAS, len(hidden_bias))
        self.split(params)[1][-1][0] = self.training.level
        return params

    def arrays(self, params: F) -> MemberArrays:
        """Return the arrays of the kernels."""
        stages = []
        for filters, drive, *rest in self.split(params):
            found = Filters.of(filters, 1.0 / self.rate_Hz)
            stages.append(StageArrays(found.poles, np.tile(found.gain, 2)[:, None] * drive, *rest))
        first, second, *current = stages
        return MemberArrays(first, second, current[0] if current else None)

    def gradient(self, params: F, by: MemberArrays) -> F:
        """Return the derivatives by the parameters, from those by the arrays."""
        parts = []
        for (filters, drive, *_), derivatives in zip(self.split(params), by, strict=False):
            if derivatives is None:
                break
            found = Filters.of(filters, 1.0 / self.rate_Hz)
            by_gain = (derivatives.drive * drive).sum(axis=1).reshape(2, -1).sum(axis=0)
            by_filters = found.gradient(derivatives.poles, by_gain, 1.0 / self.rate_Hz)
            parts += [by_filters, np.tile(found.gain, 2)[:, None] * derivatives.drive, *derivatives[2:]]
        return np.concatenate([part.ravel() for part in parts])

    def force(self, members: Sequence[F]) -> F:
        """Return the free run (ticks,) [N] of the mean of members."""
        t = self.training
        within = OperatingRange(self.rate_Hz, t.envelope.by_signal, (-inf, inf))
        return run_batch(self.body(members), within, t.inputs, t.segments)[0]

    def body(self, members: Sequence[F]) -> Recurrent:
        """Return the structure with these members."""
        networks = tuple(Member(*map(self._stage, self.split(params))) for params in members)
        return Recurrent(self.training.scale_N, self.smoothing_m_s, self.motion, self.current, networks)

    def _stage(self, views: Sequence[F]) -> Stage:
        params, drive, *rest = views
        found = Filters.of(params, 1.0 / self.rate_Hz)
        rows = (
            found.decay_s,
            params[1] / (2.0 * np.pi * found.decay_s),
            np.tile(found.gain, 2)[:, None] * drive,
            *rest,
        )
        return Stage(*(tuple(row.ravel().tolist()) for row in rows))


def raw_inputs(signals: Sequence[str], smoothing_m_s: float, envelope: Envelope, inputs: F) -> F:
    """Return inputs (signals, ticks) clamped to the envelope: those of MOTION and CURRENT, in SI units."""
    x, v, i = (np.clip(row, *limits) for row, limits in zip(inputs, envelope.by_signal.values(), strict=True))
    size = np.abs(v)
    rows = dict(zip((*MOTION, CURRENT), (v, v / np.sqrt(size + smoothing_m_s), np.sqrt(size), x, i), strict=True))
    return np.stack([rows[signal] for signal in signals]) if signals else np.empty((0, inputs.shape[1]))


def scaled_inputs(
    motion: Sequence[ScaledInput], current: Sequence[ScaledInput], smoothing_m_s: float, envelope: Envelope, inputs: F
) -> tuple[F, F]:
    """Return the scaled inputs of motion and current (n, ticks), clamped to the envelope."""
    rows = []
    for ones in (motion, current):
        raw = raw_inputs([one.signal for one in ones], smoothing_m_s, envelope, inputs)
        means, spreads = (np.array([getattr(one, key) for one in ones])[:, None] for key in ("mean", "spread"))
        rows.append((raw - means) / spreads)
    return rows[0], rows[1]


def build_family(training: Training, rate_Hz: float) -> RecurrentFamily:
    """Return the networks on the inputs that change; raises CesError if the speed does not."""
    changing = training.changing_inputs()
    if SPEED not in changing:
        raise CesError("the speed does not change in these recordings; record a moving damper")
    smoothing = SMOOTHING * float(training.inputs[1].std())
    motion = MOTION if POSITION in changing else MOTION[:-1]
    parts = []
    for signals in (motion, (CURRENT,) if CURRENT in changing else ()):
        rows = raw_inputs(signals, smoothing, training.envelope, training.inputs)
        parts.append(tuple(ScaledInput(s, float(r.mean()), float(r.std())) for s, r in zip(signals, rows, strict=True)))
    return RecurrentFamily(training, rate_Hz, smoothing, *parts)


@dataclass(frozen=True)
class Windows:
    """Windows of `ticks` that start at `starts` (n,), `lanes` of them in a step; `weights` are 1 in the mean."""

    starts: I
    ticks: int
    unscored: int
    lanes: int
    weights: F

    @classmethod
    def of(cls, training: Training, rate_Hz: float, weights: F) -> Windows:
        """Return the windows with enough weight; the longest segment limits their length."""
        ticks = min(max(MIN_WINDOW, round(WINDOW_S * rate_Hz)), MAX_WINDOW, int(np.diff(training.segments).max()))
        unscored = round(UNSCORED * ticks)
        known = np.concatenate([[0], np.cumsum(weights > 0.0)])
        first = np.concatenate([np.arange(a, max(a, b - ticks + 1)) for a, b in training.segments])
        share = (known[first + ticks] - known[first + unscored]) / (ticks - unscored)
        starts = first[share >= min(0.5, float(share.max()))]
        lanes = max(MIN_LANES, STEP_TICKS // ticks)
        return cls(starts, ticks, unscored, lanes, weights / weights[weights > 0.0].mean())

    def draw(self, random: np.random.Generator) -> tuple[I, F]:
        """Return ticks and weights (ticks, lanes + 1) of some windows, the weights over the number of scored ticks.

        The last one stays at one tick: it stands for a damper at rest, which recordings may not hold.
        """
        at = random.choice(self.starts, self.lanes + 1) + np.arange(self.ticks)[:, None]
        at[:, -1] = at[0, -1]
        weights = self.weights[at] / (self.lanes * (self.ticks - self.unscored))
        weights[:, -1] = REST_WEIGHT / (self.ticks - self.unscored)
        weights[: self.unscored] = 0.0
        return at, weights


def descend(
    family: RecurrentFamily, weights: F, params: F, random: np.random.Generator, steps: int, rate: float = RATE
) -> Iterator[F]:
    """Yield the parameters after each step of AdamW on the weighted squared error of windows."""
    t = family.training
    windows, measured = Windows.of(t, family.rate_Hz, weights), t.measured / t.scale_N
    at_rest = family.at_rest(weights)
    mean, square = np.zeros(len(params)), np.zeros(len(params))
    motion, current = family.rows
    for k in range(1, steps + 1):
        at, share = windows.draw(random)
        arrays = family.arrays(params)
        moving, wanted = motion[:, at], measured[at]
        moving[:3, :, -1], wanted[:, -1] = family.still[:, None], at_rest[at[:, -1]]
        force, traces = run_member(arrays, moving, current[:, at], new_states(arrays, windows.lanes + 1))
        back = run_member_back(arrays, traces, 2.0 * share * (force - wanted))
        gradient = family.gradient(params, back)
        gradient *= min(1.0, MAX_GRADIENT / max(float(np.linalg.norm(gradient)), 1e-300))
        mean += (1.0 - MEAN_BETA) * (gradient - mean)
        square += (1.0 - SQUARE_BETA) * (gradient**2 - square)
        root = np.sqrt(square / (1.0 - SQUARE_BETA**k)) + MIN_ROOT
        now = rate * min(1.0, k / WARM_STEPS) * 0.5 * (1.0 + np.cos(np.pi * k / steps))
        params = params - now * (mean / (1.0 - MEAN_BETA**k) / root + DECAY * family.decayed * params)
        yield params


def count_steps(limits: Limits) -> int:
    """Return the steps of a fit: STEPS in the default work."""
    return max(2, round(STEPS * limits.work))


def train_member(
    family: RecurrentFamily, limits: Limits, listener: Listener, seed: int, deadline: float, stop: threading.Event
) -> SearchResult:
    """Return the parameters with the lowest cost on the selection ticks that a seeded fit met."""
    random, training, steps = np.random.default_rng(seed), family.training, count_steps(limits)
    best = SearchResult(np.arange(FILTERS), np.empty(0), np.inf, seed, 0, "steps exhausted")
    checks = set(np.linspace(steps // 2, steps, CHECKS, dtype=int).tolist())
    for k, params in enumerate(descend(family, training.estimation, family.start(random), random, steps), 1):
        ended = reason_to_end(limits, best.cost, deadline, stop) if k % POLL_STEPS == 0 else ""
        if ended or k in checks:
            cost = training.cost(family.force([params]), training.selection)
            if cost < best.cost:
                best = replace(best, coefficients=params, cost=cost, trials=k, share=k / steps)
                listener(best)
            ended = ended or (HOPELESS if best.cost > limits.hopeless else "")
        if ended:
            return replace(best, ended=ended)
    return best
