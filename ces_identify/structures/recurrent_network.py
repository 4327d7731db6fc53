"""Recurrent networks in training: their parameters, the run of many windows, and the way back for derivatives.

Arrays of the kernels have the shape (signals, ticks, lanes); lanes are windows that run side by side, from states of
zero. Only the filters are a loop over ticks; all else is products of matrices over ticks and lanes, several times as
fast as `ces_observer.tick.recurrent`, which takes tick by tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F
from ces_identify.numerics.core import run_batch
from ces_identify.training import Training
from ces_observer.errors import CesError
from ces_observer.model import Envelope
from ces_observer.structures.recurrent import CURRENT, MOTION, POSITION, SPEED, Member, Recurrent, ScaledInput, Stage
from ces_observer.structures.structure import OperatingRange

FASTEST_S, SLOWEST_S = 1.5e-3, 0.1  # decay times of the filters
FILTERS, TANHS, BETWEEN = 8, 12, 8  # of a stage of the motion, and outputs of the first one
CURRENT_FILTERS, CURRENT_TANHS, FACTORS = 2, 4, 2
SMOOTHING = 0.05  # of the root of the speed, relative to the speed's spread
FIRST_BIAS = 0.3  # standard deviation of a start's biases


@njit(cache=True, nogil=True, fastmath={"contract"})
def scan(real: F, imag: F, drive_real: F, drive_imag: F, state: F) -> None:
    """Run h(k) = pole h(k-1) + drive(k) in place: the drives (poles, ticks, lanes) become the states.

    `state` (2, poles, lanes) is h before the first tick, and after the last one at the end.
    """
    poles, ticks, lanes = drive_real.shape
    for j in range(poles):
        a, b = real[j], imag[j]
        x, y = state[0, j], state[1, j]
        for k in range(ticks):
            for i in range(lanes):
                p, q = x[i], y[i]
                x[i] = a * p - b * q + drive_real[j, k, i]
                y[i] = b * p + a * q + drive_imag[j, k, i]
                drive_real[j, k, i] = x[i]
                drive_imag[j, k, i] = y[i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def scan_back(real: F, imag: F, state_real: F, state_imag: F, back_real: F, back_imag: F) -> tuple[F, F]:
    """Turn derivatives by the states, in place, into derivatives by the drives; return those by the poles (poles,)."""
    poles, ticks, lanes = state_real.shape
    by_real, by_imag = np.zeros(poles), np.zeros(poles)
    x, y, sums = np.empty(lanes), np.empty(lanes), np.empty((2, lanes))
    for j in range(poles):
        a, b = real[j], imag[j]
        x[:] = 0.0
        y[:] = 0.0
        sums[:] = 0.0
        for k in range(ticks - 1, -1, -1):
            for i in range(lanes):
                p, q = x[i], y[i]
                x[i] = a * p + b * q + back_real[j, k, i]
                y[i] = a * q - b * p + back_imag[j, k, i]
                back_real[j, k, i] = x[i]
                back_imag[j, k, i] = y[i]
            if k > 0:
                for i in range(lanes):
                    p, q = state_real[j, k - 1, i], state_imag[j, k - 1, i]
                    sums[0, i] += x[i] * p + y[i] * q
                    sums[1, i] += y[i] * p - x[i] * q
        by_real[j], by_imag[j] = sums[0].sum(), sums[1].sum()
    return by_real, by_imag


class StageArrays(NamedTuple):
    """A stage as `ces_observer.structures.recurrent.Stage` describes it, or derivatives by its parts.

    Shapes: `poles` (2, poles) real and imaginary parts, `drive` (2 poles, inputs), `hidden` (tanh, states), `out`
    (outputs, tanh + states) with states = 2 poles + inputs, biases (tanh,) and (outputs,).
    """

    poles: F
    drive: F
    hidden: F
    hidden_bias: F
    out: F
    out_bias: F


class MemberArrays(NamedTuple):
    """The stages of a network; `current` is None without a changing current."""

    first: StageArrays
    second: StageArrays
    current: StageArrays | None


class Tape(NamedTuple):
    """What the way back needs: inputs (n, ticks, lanes) of a stage, and `joined` (tanh + states, ticks, lanes)."""

    inputs: F
    joined: F


def run_stage(stage: StageArrays, inputs: F, state: F) -> tuple[F, Tape]:
    """Return the outputs (outputs, ticks, lanes); `state` (2, poles, lanes) moves on to the last tick."""
    count, tanhs = stage.poles.shape[1], len(stage.hidden_bias)
    joined = np.empty((stage.out.shape[1], *inputs.shape[1:]))
    states = joined[tanhs:]
    states[2 * count :] = inputs
    np.matmul(stage.drive, _flat(inputs), out=_flat(states)[: 2 * count])
    scan(*stage.poles, states[:count], states[count : 2 * count], state)
    hidden = _flat(joined)[:tanhs]
    np.matmul(stage.hidden, _flat(states), out=hidden)
    hidden += stage.hidden_bias[:, None]
    np.tanh(hidden, out=hidden)
    outputs = stage.out @ _flat(joined) + stage.out_bias[:, None]
    return outputs.reshape(-1, *inputs.shape[1:]), Tape(inputs, joined)


def run_stage_back(stage: StageArrays, trace: Tape, back: F) -> tuple[F, StageArrays]:
    """Return the derivatives by inputs and parts, from those by the outputs (outputs, ticks, lanes)."""
    count, tanhs = stage.poles.shape[1], len(stage.hidden_bias)
    joined, inputs, back = _flat(trace.joined), _flat(trace.inputs), _flat(back)
    by_joined = stage.out.T @ back
    by_hidden, by_states = by_joined[:tanhs], by_joined[tanhs:]
    by_hidden *= 1.0 - joined[:tanhs] ** 2
    by_states += stage.hidden.T @ by_hidden
    planes = by_states.reshape(-1, *trace.inputs.shape[1:])
    states = trace.joined[tanhs:]
    by_poles = scan_back(
        *stage.poles, states[:count], states[count : 2 * count], planes[:count], planes[count : 2 * count]
    )
    driven = by_states[: 2 * count]
    by_inputs = (by_states[2 * count :] + stage.drive.T @ driven).reshape(trace.inputs.shape)
    return by_inputs, StageArrays(
        np.array(by_poles),
        driven @ inputs.T,
        by_hidden @ joined[tanhs:].T,
        by_hidden.sum(axis=1),
        back @ joined.T,
        back.sum(axis=1),
    )


def _flat(planes: F) -> F:
    return planes.reshape(len(planes), -1)


def new_states(member: MemberArrays, lanes: int) -> list[F]:
    """Return states of zero (2, poles, lanes) for each stage."""
    return [np.zeros((*stage.poles.shape, lanes)) for stage in member if stage is not None]


def run_member(member: MemberArrays, motion: F, current: F, states: list[F]) -> tuple[F, list[Tape]]:
    """Return the scaled force (ticks, lanes) for inputs (n, ticks, lanes), and the traces."""
    between, first = run_stage(member.first, motion, states[0])
    forces, second = run_stage(member.second, np.tanh(between, out=between), states[1])
    if member.current is None:
        return forces[0], [first, second]
    factors, third = run_stage(member.current, current, states[2])
    force = forces[0] + (factors * forces[1:]).sum(axis=0)
    return force, [first, second, third, Tape(factors, forces)]


def run_member_back(member: MemberArrays, traces: list[Tape], back: F) -> MemberArrays:
    """Return the derivatives by all parts, from those by the force (ticks, lanes)."""
    first, second, *rest = traces
    by_forces, by_current = back[None], None
    if member.current is not None:
        third, (factors, forces) = rest
        by_forces = np.concatenate([back[None], back * factors])
        _, by_current = run_stage_back(member.current, third, back * forces[1:])
    by_between, by_second = run_stage_back(member.second, second, by_forces)
    by_between *= 1.0 - second.inputs**2
    _, by_first = run_stage_back(member.first, first, by_between)
    return MemberArrays(by_first, by_second, by_current)


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
        return np.array([-scaled.mean / scaled.spread for scaled in self.motion[:3]])

    def at_rest(self, weights: F) -> F:
        """Return the scaled force (ticks,) at rest: its part that is linear in the position, beside the speed's."""
        motion, current = self.rows
        speed = motion[:3] - self.still[:, None]
        rows = np.concatenate([np.ones((1, motion.shape[1])), motion[3:], speed, *(speed * row for row in current)])
        roots = np.sqrt(weights)
        scaled = roots * self.training.measured / self.training.scale_N
        factors = np.linalg.lstsq((rows * roots).T, scaled, rcond=None)[0]
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
            bank = Filters.of(filters, 1.0 / self.rate_Hz)
            stages.append(StageArrays(bank.poles, np.tile(bank.gain, 2)[:, None] * drive, *rest))
        first, second, *current = stages
        return MemberArrays(first, second, current[0] if current else None)

    def gradient(self, params: F, by: MemberArrays) -> F:
        """Return the derivatives by the parameters, from those by the arrays."""
        parts = []
        for (filters, drive, *_), derivatives in zip(self.split(params), by, strict=False):
            if derivatives is None:
                break
            bank = Filters.of(filters, 1.0 / self.rate_Hz)
            by_gain = (derivatives.drive * drive).sum(axis=1).reshape(2, -1).sum(axis=0)
            by_filters = bank.gradient(derivatives.poles, by_gain, 1.0 / self.rate_Hz)
            parts += [by_filters, np.tile(bank.gain, 2)[:, None] * derivatives.drive, *derivatives[2:]]
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
        bank = Filters.of(params, 1.0 / self.rate_Hz)
        rows = (
            bank.decay_s,
            params[1] / (2.0 * np.pi * bank.decay_s),
            np.tile(bank.gain, 2)[:, None] * drive,
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
        raw = raw_inputs([scaled.signal for scaled in ones], smoothing_m_s, envelope, inputs)
        means, spreads = (np.array([getattr(scaled, key) for scaled in ones])[:, None] for key in ("mean", "spread"))
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
