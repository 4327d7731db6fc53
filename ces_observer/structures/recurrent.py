"""A recurrent network that forgets for any parameters: what it is made of, and its proof.

`ces_observer.tick.recurrent` has its equations. The current has a stage of its own, so that a current never seen cannot
upset the motion. A filter h(k) = pole h(k-1) + drive u(k) has pole = exp((-1 / decay_s + 2 pi i frequency_Hz) T), T the
tick.

|pole| < 1 for any parameters. With |u| <= U, |h| <= |drive| U / (1 - |pole|), and |tanh| <= 1: the force is bounded for
every input, as inputs are clamped to the envelope. The difference of two runs with the same inputs is that of their
states: in the first stage it falls as |pole|^k, and tanh never amplifies it. With d bounds on the differences of the
inputs of the second, those of its states fall as |pole|^k beside what |drive| d adds; d falls, so that its value at the
beginning of a while bounds the whole of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import chain, islice
from math import hypot, pi, sqrt
from operator import mul
from typing import ClassVar, Self

from ces_observer.errors import ModelError
from ces_observer.fields import REQUIRED
from ces_observer.flat import ArrayLayout
from ces_observer.limits import FileLimits, NumberLimits, ProofLimits
from ces_observer.proof.certificate import Certificate
from ces_observer.records import bounded, choice, items
from ces_observer.structures.lagged_signals import spread, weight
from ces_observer.structures.structure import OperatingRange, Ranges, Structure, require_length
from ces_observer.tick import recurrent as tick
from ces_observer.tick.model import K_STRUCTURE
from ces_observer.tick.structure import RECURRENT

SPEED, ROOT, SIZE, POSITION, CURRENT = "speed", "speed_root", "speed_size", "position", "current"
MOTION = (SPEED, ROOT, SIZE, POSITION)
PLACES = {name: tick.SIGNAL_SPEED + i for i, name in enumerate((*MOTION, CURRENT))}  # in s
STEP_S, MAX_STEPS = 0.02, 3000  # of the bounds on what differs
WIDENED = 1.0 + 1e-9  # of bounds, more than rounding changes them
CLAIM = (
    "the difference of two runs with the same inputs dies out with a time constant of at most slowest_s; "
    "|F| <= force_bound_N for every input"
)
METHOD = "poles within the unit circle, |tanh| <= 1, inputs clamped to the envelope"

Row = tuple[float, ...]


def _dot(left: Sequence[float], right: Sequence[float]) -> float:
    return float(sum(map(mul, left, right)))


@dataclass(frozen=True)
class ScaledInput:
    """An input of a stage, (value - mean) / spread; `signal` is one of MOTION or CURRENT."""

    signal: str = choice(REQUIRED, "", (*MOTION, CURRENT))
    mean: float = weight()
    spread: float = spread()

    def bound(self, inputs: Ranges, smoothing_m_s: float) -> float:
        """Return a bound on its size for inputs [m, m/s, A] in their ranges."""
        name = self.signal.partition("_")[0]
        low, high = inputs[name]
        values: tuple[float, ...] = (low, high, min(max(0.0, low), high))
        if name == SPEED:
            values = tuple(_speed_values(v, smoothing_m_s)[MOTION.index(self.signal)] for v in values)
        return max(abs(value - self.mean) for value in values) / self.spread


def _speed_values(speed: float, smoothing_m_s: float) -> tuple[float, float, float]:
    """Return SPEED, ROOT and SIZE at a speed [m/s]."""
    return speed, speed / sqrt(abs(speed) + smoothing_m_s), sqrt(abs(speed))


@dataclass(frozen=True)
class Stage:
    """Filters and a layer of tanh; matrices are listed by rows, those of `drive` first real, then imaginary parts."""

    decay_s: Row = bounded(*FileLimits.FILTER_S, unit="s", max_count=FileLimits.MAX_ITEMS)
    frequency_Hz: Row = bounded(-FileLimits.MAX_FILTER_HZ, FileLimits.MAX_FILTER_HZ)
    drive: Row = weight()
    hidden: Row = weight()
    hidden_bias: Row = bounded(-NumberLimits.MAX_NUMBER, NumberLimits.MAX_NUMBER, max_count=FileLimits.MAX_ITEMS)
    out: Row = weight()
    out_bias: Row = bounded(-NumberLimits.MAX_NUMBER, NumberLimits.MAX_NUMBER, max_count=FileLimits.MAX_ITEMS)

    @property
    def kept(self) -> Row:
        """The share of each filter's state that is left after STEP_S."""
        return tuple(math.exp(-STEP_S / decay) for decay in self.decay_s)

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return len(self.drive) // (2 * len(self.decay_s))

    def poles(self, rate_Hz: float) -> list[complex]:
        """Return the poles at a rate."""
        sizes = [math.exp(-1.0 / (decay * rate_Hz)) for decay in self.decay_s]
        angles = [2.0 * pi * frequency / rate_Hz for frequency in self.frequency_Hz]
        return [complex(r * math.cos(a), r * math.sin(a)) for r, a in zip(sizes, angles, strict=True)]

    def fill(self, layout: ArrayLayout, rate_Hz: float, source: int, results: int) -> list[int]:
        """Write the stage into a layout; return its counts. Inputs and outputs begin at `source` and `results` in s."""
        width = 2 * len(self.decay_s) + self.inputs
        poles = [(pole, 1.0 / (1.0 - pole)) for pole in self.poles(rate_Hz)]
        layers = [
            (self.drive, self.inputs, [0.0] * (2 * len(poles))),
            (self.hidden, width, self.hidden_bias),
            (self.out, len(self.hidden_bias) + width, self.out_bias),
        ]
        counts = {
            tick.STAGE_INPUTS: self.inputs,
            tick.STAGE_FILTERS: len(poles),
            tick.STAGE_TANHS: len(self.hidden_bias),
            tick.STAGE_OUTPUTS: len(self.out_bias),
            tick.STAGE_SOURCE: source,
            tick.STAGE_RESULTS: results,
            tick.STAGE_POLES: layout.table(x for pair in poles for signal in pair for x in (signal.real, signal.imag)),
            tick.STAGE_JOINED: layout.state(len(self.hidden_bias) + width),
        }
        for place, (matrix, columns, biases) in zip(range(tick.STAGE_DRIVE, tick.STAGE_JOINED), layers, strict=True):
            rows = zip(cut(matrix, columns), biases, strict=True)
            counts[place] = layout.table(number for row, bias in rows for number in (*row, bias))
        return [counts[place] for place in range(tick.N_STAGE)]

    def bound_states(self, inputs: Sequence[float], rate_Hz: float) -> list[float]:
        """Return bounds on the size of the filters' states for inputs of bounded sizes."""
        count = len(self.decay_s)
        rooms = [-math.expm1(-1.0 / (decay * rate_Hz)) for decay in self.decay_s]
        rows = cut(self.drive, len(inputs))
        return [
            _dot(list(map(hypot, real, imag)), inputs) / room
            for real, imag, room in zip(rows[:count], rows[count:], rooms, strict=True)
        ]

    @cached_property
    def slopes(self) -> list[Row]:
        """Bounds on the derivatives of each output by the size of the states, then by the inputs; |tanh'| <= 1."""
        count, hidden = len(self.decay_s), len(self.hidden_bias)
        sizes = [_by_state(row, count) for row in cut(self.hidden, 2 * count + self.inputs)]
        return [
            tuple(
                own + _dot([abs(weight) for weight in row[:hidden]], column)
                for own, column in zip(direct, zip(*sizes, strict=True), strict=True)
            )
            for row in cut(self.out, hidden + 2 * count + self.inputs)
            for direct in [_by_state(row[hidden:], count)]
        ]

    def differences(self, states: Sequence[float], inputs: Sequence[float]) -> list[float]:
        """Return bounds on the differences of the outputs, from those of states and inputs."""
        return [_dot(row, (*states, *inputs)) for row in self.slopes]

    def bound(self, inputs: Sequence[float], rate_Hz: float) -> list[float]:
        """Return bounds on the size of the outputs for inputs of bounded sizes."""
        count, hidden = len(self.decay_s), len(self.hidden_bias)
        states = self.bound_states(inputs, rate_Hz)
        bounds = []
        for bias, row in zip(self.out_bias, cut(self.out, hidden + 2 * count + len(inputs)), strict=True):
            tanhs, real, imag, direct = row[:hidden], row[hidden:][:count], row[hidden + count :], row[-len(inputs) :]
            linear = _dot(list(map(hypot, real, imag[:count])), states) + _dot(list(map(abs, direct)), inputs)
            bounds.append(abs(bias) + sum(map(abs, tanhs)) + linear)
        return bounds

    def check_sizes(self, where: str, inputs: int, outputs: int) -> None:
        """Raise ModelError unless its lists fit the numbers of inputs and outputs."""
        poles, hidden = len(self.decay_s), len(self.hidden_bias)
        states = 2 * poles + inputs
        sizes = (poles, poles, 2 * poles * inputs, hidden * states, hidden, outputs * (hidden + states), outputs)
        for (name, numbers), size in zip(vars(self).items(), sizes, strict=False):  # cached properties come last
            require_length(f"{where}: {name}", numbers, size)


def _by_state(row: Sequence[float], filters: int) -> Row:
    """Return the largest changes of a weighted sum of states, real parts first, and inputs by the size of each."""
    sizes = map(hypot, row[:filters], row[filters : 2 * filters])
    return (*sizes, *map(abs, row[2 * filters :]))


def cut(numbers: Sequence[float], width: int) -> list[Row]:
    """Return the rows of a matrix that is listed row by row."""
    return [tuple(numbers[k : k + width]) for k in range(0, len(numbers), width)]


@dataclass(frozen=True)
class Member:
    """One network; without a changing current it has no stage for it, and one output only."""

    first: Stage
    second: Stage
    current: Stage | None = None

    @property
    def stages(self) -> dict[str, Stage]:
        """The stages that it has, by name."""
        return {name: stage for name, stage in vars(self).items() if stage is not None}

    def differences(self, motion: Sequence[float], current: Sequence[float], rate_Hz: float) -> Iterator[float]:
        """Yield bounds on the difference of two runs' scaled forces, from any states, after 0, 1, 2, ... STEP_S."""
        between, no_input = [1.0] * len(self.first.out_bias), [0.0] * self.first.inputs
        first, second = (
            [2.0 * one for one in stage.bound_states(inputs, rate_Hz)]
            for stage, inputs in ((self.first, motion), (self.second, between))
        )
        factors = [] if self.current is None else self.current.bound(current, rate_Hz)
        third = [] if self.current is None else [2.0 * one for one in self.current.bound_states(current, rate_Hz)]
        outputs = self.second.bound(between, rate_Hz)[1:]
        while True:
            moved = [min(2.0, one) for one in self.first.differences(first, no_input)]
            force, *scaled = self.second.differences(second, moved)
            others = [] if self.current is None else self.current.differences(third, [0.0])
            yield force + _dot(scaled, factors) + _dot(outputs, others)
            room = self.second.bound_states(moved, rate_Hz)
            second = [
                kept * one + (1.0 - kept) * most for one, most, kept in zip(second, room, self.second.kept, strict=True)
            ]
            first = list(map(mul, first, self.first.kept))
            third = [] if self.current is None else list(map(mul, third, self.current.kept))

    def bound(self, motion: Sequence[float], current: Sequence[float], rate_Hz: float) -> float:
        """Return a bound on its scaled force for inputs of bounded sizes."""
        between = [1.0] * len(self.first.out_bias)
        force, *scaled = self.second.bound(between, rate_Hz)
        factors = [] if self.current is None else self.current.bound(current, rate_Hz)
        return force + _dot(scaled, factors)

    def fill(self, layout: ArrayLayout, rate_Hz: float, scaled: int) -> list[int]:
        """Write the member into a layout; return the counts of its stages. Its inputs begin at `scaled` in s."""
        between, forces = layout.state(len(self.first.out_bias)), layout.state(len(self.second.out_bias))
        counts = self.first.fill(layout, rate_Hz, scaled, between) + self.second.fill(layout, rate_Hz, between, forces)
        if self.current is None:
            return counts
        factors = layout.state(len(self.current.out_bias))
        return counts + self.current.fill(layout, rate_Hz, scaled + self.first.inputs, factors)

    def check_sizes(self, where: str, motion: int, current: int) -> None:
        """Raise ModelError unless its stages fit the numbers of inputs and each other."""
        if (self.current is None) == bool(current):
            expected = "a stage for the current" if current else "null for the current, which is no input"
            raise ModelError(f"{where}: expected {expected}")
        between, factors = len(self.first.out_bias), 0
        self.first.check_sizes(f"{where}: first", motion, between)
        if self.current is not None:
            factors = len(self.current.out_bias)
            self.current.check_sizes(f"{where}: current", current, factors)
        self.second.check_sizes(f"{where}: second", between, 1 + factors)


@dataclass(frozen=True)
class FadingCertificate(Certificate):
    """Proved bounds: `force_bound_N` on |force| [N], and `slowest_s` on the time constant of what is forgotten."""

    force_bound_N: float
    slowest_s: float
    claim: str
    method: str
    forgets_s: float = math.inf

    @property
    def force_N(self) -> float:
        """Bound on the force [N]; the poles lie within the unit circle in every model file."""
        return self.force_bound_N

    @property
    def bounds(self) -> Mapping[str, float]:
        """Bound on the force, and the slowest decay."""
        return {"force_bound_N": self.force_bound_N, "slowest_s": self.slowest_s, "forgets_s": self.forgets_s}

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """The proved numbers for display."""
        return (
            ("slowest filter", f"{1e3 * self.slowest_s:.3g} ms"),
            self.past_row,
            ("force bound", f"{self.force_bound_N:.6g} N for any input"),
        )


@dataclass(frozen=True)
class Recurrent(Structure):
    """The mean of `members`, times `scale_N`; see the module."""

    name, section, option, rank = "recurrent", "recurrent", "recurrent", 3
    number, runs = RECURRENT, (tick.recurrent_reset, tick.recurrent_tick)
    unproved: ClassVar[str] = "its force is not proved to be bounded"

    scale_N: float = spread("N")
    smoothing_m_s: float = spread("m/s")
    motion: tuple[ScaledInput, ...] = items(1, len(MOTION))
    current: tuple[ScaledInput, ...] = items(0, 1)
    members: tuple[Member, ...] = items(1, FileLimits.MAX_MEMBERS)

    def checked(self) -> Self:
        """Return it; raises ModelError unless inputs and stages fit together."""
        for name, of, signals in (("motion", self.motion, MOTION), ("current", self.current, (CURRENT,))):
            for i, one in enumerate(of):
                if one.signal not in signals:
                    raise ModelError(f"{name}[{i}]: signal is {one.signal!r}; expected one of {', '.join(signals)}")
        for i, member in enumerate(self.members):
            member.check_sizes(f"members[{i}]", len(self.motion), len(self.current))
        return self

    @property
    def size(self) -> str:
        """The size, in words."""
        filters = sum(len(stage.decay_s) for stage in self.all_stages)
        networks = f"{len(self.members)} network" + "s" * (len(self.members) > 1)
        return f"{networks} with {filters} filters, {self.parameters} parameters"

    @property
    def all_stages(self) -> list[Stage]:
        """The stages of all members."""
        return list(chain.from_iterable(member.stages.values() for member in self.members))

    @property
    def parameters(self) -> int:
        """Number of parameters of all members."""
        names = [declared.name for declared in fields(Stage)]
        return sum(len(getattr(stage, name)) for stage in self.all_stages for name in names)

    def steady_force(self, within: OperatingRange, speed_m_s: float, current_A: float) -> float:
        """Return the force [N] at constant inputs: that of a first tick, before which inputs were the same."""
        middle = 0.5 * sum(within.inputs[POSITION])
        return self.make_predictor(within).tick(middle, speed_m_s, current_A)

    def fill(self, layout: ArrayLayout, within: OperatingRange) -> None:
        """Write the network into a layout, for `ces_observer.tick.recurrent`."""
        layout.reserve(tick.P_RECURRENT, tick.N_RECURRENT, tick.S_RECURRENT, K_STRUCTURE)
        inputs = (*self.motion, *self.current)
        layout.p[tick.RECURRENT_SCALE] = self.scale_N / len(self.members)
        layout.p[tick.RECURRENT_SMOOTHING] = self.smoothing_m_s
        scaled = layout.state(len(inputs))
        stages = [number for member in self.members for number in member.fill(layout, within.rate_Hz, scaled)]
        layout.n[tick.RECURRENT_MEMBERS] = len(self.members)
        layout.n[tick.RECURRENT_STAGES] = len(self.members[0].stages)
        layout.n[tick.RECURRENT_INPUTS] = len(inputs)
        layout.n[tick.RECURRENT_TABLE] = layout.indices(stages)
        layout.n[tick.RECURRENT_SIGNALS] = layout.indices(PLACES[signal.signal] for signal in inputs)
        layout.n[tick.RECURRENT_SCALES] = layout.table(
            number for signal in inputs for number in (signal.mean, signal.spread)
        )
        layout.n[tick.RECURRENT_SCALED] = scaled
        layout.n[tick.RECURRENT_DRIVEN] = layout.state(2 * max(len(stage.decay_s) for stage in self.all_stages))

    def certify(self, within: OperatingRange) -> FadingCertificate:
        """Return the proved bound on |force| [N] and the slowest decay."""
        smoothing = self.smoothing_m_s
        motion, current = ([u.bound(within.inputs, smoothing) for u in us] for us in (self.motion, self.current))
        bounds = [member.bound(motion, current, within.rate_Hz) for member in self.members]
        force = self.scale_N * sum(bounds) / len(bounds) * WIDENED
        slowest = max(max(stage.decay_s) for stage in self.all_stages)
        return FadingCertificate(force, slowest, CLAIM, METHOD, self._forgets_s(motion, current, within))

    def _forgets_s(self, motion: Sequence[float], current: Sequence[float], within: OperatingRange) -> float:
        """Return after how long [s] two runs are proved to agree; infinite after MAX_STEPS."""
        low, high = within.force_N
        runs = zip(*(member.differences(motion, current, within.rate_Hz) for member in self.members), strict=True)
        limit = ProofLimits.FORGOTTEN * (high - low) / WIDENED * len(self.members) / self.scale_N
        return next((k * STEP_S for k, apart in enumerate(islice(runs, MAX_STEPS)) if sum(apart) < limit), math.inf)
