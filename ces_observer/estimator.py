"""The estimator: stamped position and current in; damping force, or the reason why there is none, out.

It is driven by position samples alone and has no clock, so its forces are the same in real time, in simulated time and
offline. `ces_observer.tick.estimator` computes them; `ces_identify.simulations.simulate.sample_run` is its batch form.

A model with a delay estimates the force of a sample when the speed is known better, so many ticks later. Its estimates
come out in `late`, each with the stamp of the sample that it belongs to: the first sample of every tick.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import chain
from math import isfinite
from numbers import Real
from operator import index
from pathlib import Path
from typing import NamedTuple

from ces_observer.bank_design import (
    ORDER,
    SHIFTS,
    SPEED,
    BankSettings,
    Gains,
    design_bank,
    response_s,
    spans_of,
)
from ces_observer.core import bind, floats, ints
from ces_observer.errors import CesError
from ces_observer.flat import ArrayLayout, Arrays
from ces_observer.limits import SpeedLimits
from ces_observer.model import Model, Sampling, load_model
from ces_observer.reasons import REASONS, WARMING_UP
from ces_observer.tick import bank, tracker
from ces_observer.tick import estimator as tick
from ces_observer.tick.estimator import CAUSE, FORCE, LATE_COUNT, LATE_STAMPS, LATE_VALUES, LATE_WIDTH, REASON
from ces_observer.tick.model import CLAMPED, HELD
from ces_observer.tick.run import run_half_width
from ces_observer.tick.tracker import (
    DOUBTED_TAU,
    LAST_INTERVAL,
    P_ESTIMATOR,
    TAU,
    TRACK_POSITION,
    TRACK_SPEED,
    WAITING,
)

SWITCH_S = 0.2  # [s] mean time for which one mode is the right one


MAX_WAITING = 100  # samples in a tick: no sensor sends so many, so that its stamps are no nanoseconds
NO_STAMPS = "the stamps hardly go on; expected whole nanoseconds (1 ms is 1_000_000)"


def layout_of(sampling: Sampling) -> ArrayLayout:
    """Return a new layout of tracker and bank alone."""
    layout = ArrayLayout(tracker.P_ESTIMATOR, tracker.N_ESTIMATOR, tracker.S_ESTIMATOR, tracker.K_ESTIMATOR)
    fill_tracker(layout, sampling)
    return layout


def least_rate_Hz(sampling: Sampling) -> float:
    """Return the rate of positions [Hz] below which every one comes so late that no force is given."""
    p = layout_of(sampling).p
    return 1.0 / min(p[tracker.DOUBT_S] + p[tracker.OVERDUE_S], sampling.max_gap_s)


def fill_tracker(layout: ArrayLayout, sampling: Sampling) -> None:
    """Write the numbers of tracker and bank into a layout, and reserve their state."""
    fill_bank(layout, sampling.stroke, sampling.delay_ticks)
    settling_s = SpeedLimits.SETTLING * response_s(sampling.stroke)
    settling_ticks = settling_s * sampling.rate_Hz
    low, high = sampling.stroke_m
    layout.p[tracker.TICKS_PER_NS] = sampling.rate_Hz * 1e-9
    layout.p[tracker.OUTLIER_M] = sampling.outlier_m
    layout.p[tracker.STROKE_LOW] = low
    layout.p[tracker.STROKE_HIGH] = high
    layout.p[tracker.LARGEST_CHANGE] = SpeedLimits.MAX_CHANGE * sampling.speed_m_s
    layout.p[tracker.OVERDUE_S] = SpeedLimits.OVERDUE / sampling.rate_Hz
    layout.p[tracker.SETTLING_S] = settling_s
    layout.p[tracker.SETTLING_TICKS] = settling_ticks
    layout.p[tracker.DOUBT_S] = SpeedLimits.DOUBT * settling_s
    layout.p[tracker.DOUBT_TICKS] = SpeedLimits.DOUBT * settling_ticks
    max_gap_ns = round(sampling.max_gap_s * 1e9)
    room = int(max_gap_ns * layout.p[tracker.TICKS_PER_NS]) + 2 if sampling.delay_ticks else 0
    layout.n[tracker.MAX_GAP_NS] = max_gap_ns
    layout.n[tracker.MEASURES_SPEED] = sampling.motion == SPEED
    layout.n[tracker.LATE_AT] = layout.state(2 * room)
    layout.n[tracker.LATE_KNOWN] = layout.memory(room)


def fill_bank(layout: ArrayLayout, stroke: BankSettings, delay: int) -> None:
    """Write the numbers of a bank that looks back over `delay` ticks into a layout, and reserve its state."""
    modes, spans = design_bank(stroke, delay), spans_of(stroke)
    tick_s = 1.0 / stroke.rate_Hz
    stay = max(0.0, 1.0 - tick_s / SWITCH_S)
    measurements = 2 if stroke.motion else 1
    ring = (delay + 1) * (1 + len(modes) * (1 + 2 * measurements)) if delay else 0
    size = len(modes) * bank.MODE_WIDTH + ring
    states = layout.state(size)
    layout.p[bank.TICK_S] = tick_s
    layout.p[bank.STAY] = stay
    layout.p[bank.LEAVE] = (1.0 - stay) / len(modes)
    layout.n[bank.DELAY] = delay
    layout.n[bank.MODES] = len(modes)
    layout.n[bank.SPANS] = len(spans)
    layout.n[bank.MEASURES_MOTION] = measurements > 1
    layout.n[bank.SPAN_TABLE] = layout.indices(spans)
    layout.n[bank.SEEN] = layout.table(
        x
        for at in range(len(SHIFTS))
        for mode in modes
        for x in (*mode.measured[at], *(mode.motion[at] if stroke.motion else ()))
    )
    layout.n[bank.GAINS] = layout.table(_gains(stroke, delay))
    first = (mode.gains[span][0] for span in range(len(spans)) for mode in modes)
    layout.n[bank.LIKELIHOODS] = layout.table(x for gains in first for x in (gains.height, *gains.sharpness))
    layout.n[bank.COMPANIONS] = layout.table(x for mode in modes for x in (*mode.speed, *mode.position))
    smoothing = (row for mode in modes for row in zip(*mode.smoothing, strict=True))
    layout.n[bank.SMOOTHING] = layout.table(chain.from_iterable(smoothing))
    layout.n[bank.MODE_STATES] = states
    layout.n[bank.RING] = states + len(modes) * bank.MODE_WIDTH
    layout.n[bank.BANK_STATES] = size
    layout.n[bank.SAVED] = layout.state(size)


@lru_cache(maxsize=32)
def _gains(stroke: BankSettings, delay: int) -> tuple[float, ...]:
    """Return the gains of all modes by span and shift; after lost ticks a sample lies within half a tick."""
    modes = design_bank(stroke, delay)
    spans = [
        (span, at) for span in range(len(spans_of(stroke))) for at in range(bank.LATE_SHIFT * (span > 0), len(SHIFTS))
    ]
    return tuple(x for span, at in spans for mode in modes for x in _row(mode.gains[span][at]))


def _row(gains: Gains) -> tuple[float, ...]:
    """Return a mode's row of gains, in the order that `ces_observer.tick.bank` names."""
    position, *motion = zip(gains.position, gains.speed, *gains.states[:ORDER], strict=True)
    if not motion:
        return position
    offset = gains.states[ORDER] if len(gains.states) > ORDER else (0.0, 0.0)
    return (*position, *motion[0], *offset)


class LateEstimate(NamedTuple):
    """The estimate of an earlier sample, now that its speed is known; `half_width` [N] is None without a band."""

    stamp_ns: int
    position: float
    speed: float
    force: float
    half_width: float | None


class EstimatorArrays(NamedTuple):
    """The arrays of tracker and estimator, and those of the model's structure."""

    sampling: Arrays
    structure: Arrays


def lay_out_estimator(model: Model) -> EstimatorArrays:
    """Return the arrays of a model's estimator; raises ModelError for numbers that cannot be used."""
    length = model.sampling.delay_ticks + 1
    layout = ArrayLayout(P_ESTIMATOR, tick.N_ESTIMATOR_END, tick.S_ESTIMATOR_END, tick.K_ESTIMATOR_END)
    fill_tracker(layout, model.sampling)
    layout.n[tick.RING_VALUES] = layout.state(tick.RING_WIDTH * length)
    layout.n[tick.RING_STAMPS] = layout.memory(tick.RING_WIDTH * length)
    layout.n[LATE_VALUES] = layout.state(LATE_WIDTH * length)
    layout.n[LATE_STAMPS] = layout.memory(length)
    return EstimatorArrays(layout.arrays(), model.lay_out().arrays())


class Estimator:
    """Estimates the force of one damper, sample by sample, by a model or that in a file.

    After `step`: `reason` is "ok" or why the force was withheld, and `cause` what a warm-up is for; `position` [m] and
    `speed` [m/s] are those at the last accepted sample; `late` holds the estimates that have become known.
    """

    def __init__(self, model: Model | str | Path) -> None:
        self.model = model = model if isinstance(model, Model) else load_model(model)
        own, run = (Arrays(floats(p), ints(n), floats(s), ints(k)) for p, n, s, k in lay_out_estimator(model))
        _, self._n, self._s, self._k = own
        self._flags = run.k
        self._half_width = bind(run_half_width, run.p, run.n, run.s)
        self._step, self._reset = (bind(one, *own, *run) for one in (tick.estimator_step, tick.estimator_reset))
        self._least_rate_Hz = least_rate_Hz(model.sampling)
        self._skip_late = bind(tick.estimator_skip_late, self._n, self._s, self._k)
        self.is_late = model.sampling.delay_ticks > 0
        self.delay_ns = round(model.sampling.delay_ticks / model.sampling.rate_Hz * 1e9)
        self.reset()

    def __repr__(self) -> str:
        rate_Hz = self.model.sampling.rate_Hz
        return f"Estimator: {self.model.structure} at {rate_Hz:g} Hz; {self.reason or 'force estimated'}"

    def reset(self) -> None:
        """Bring the estimator back to new."""
        self._reset()

    def step(self, stamp_ns: int, position_m: float, current_A: float, motion: float = 0.0) -> float | None:
        """Return the force [N] at `stamp_ns`, within the model's force envelope, or None with `reason` set.

        `motion` is the signal `model.sampling.motion`, if the model needs one. Bad samples count as missing. A model
        with a delay has no force at once: the reason is "ok" while `late` has those of earlier samples. Raises CesError
        for what is no number.
        """
        try:
            withheld = self._step(index(stamp_ns), position_m, current_A, motion)
        except TypeError:
            raise _explain_types(stamp_ns, position_m=position_m, current_A=current_A, motion=motion) from None
        if withheld or self.is_late:
            return None
        force: float = self._s[FORCE]
        return force

    @property
    def word(self) -> str:
        """One of REASONS: "ok", or why the last force was withheld."""
        return REASONS[self._k[REASON]]

    @property
    def reason(self) -> str:
        """The same, with what is wrong with the stamps if they are why it warms up."""
        reason = self.word
        if reason != WARMING_UP:
            return reason
        if self._k[WAITING] > MAX_WAITING:
            return f"{reason}: {NO_STAMPS}"
        seldom = self._s[LAST_INTERVAL] * self._least_rate_Hz > 1.0 and self._s[DOUBTED_TAU] > self._s[TAU]
        return f"{reason}: {describe_rate(1.0 / self._s[LAST_INTERVAL], self._least_rate_Hz)}" if seldom else reason

    @property
    def cause(self) -> str:
        """What the warm-up is for; empty before the first sample."""
        return REASONS[self._k[CAUSE]] if self._k[CAUSE] else ""

    @property
    def position(self) -> float:
        """Position [m] at the last accepted sample."""
        return self._s[TRACK_POSITION]

    @property
    def speed(self) -> float:
        """Speed [m/s] at the last accepted sample."""
        return self._s[TRACK_SPEED]

    @property
    def late(self) -> list[LateEstimate]:
        """The estimates of earlier samples that the last step has brought."""
        count = self._k[LATE_COUNT]
        return [self._late_estimate(i) for i in range(count)] if count else []

    def _late_estimate(self, i: int) -> LateEstimate:
        at = self._n[LATE_VALUES] + LATE_WIDTH * i
        position, speed, force, width = self._s[at : at + LATE_WIDTH]
        stamp_ns = self._k[self._n[LATE_STAMPS] + i]
        return LateEstimate(stamp_ns, position, speed, force, width if isfinite(width) else None)

    @property
    def is_warm(self) -> bool:
        """True if `step` has just given a force, at once or of an earlier sample."""
        return self._k[REASON] == 0 and (not self.is_late or self._k[LATE_COUNT] > 0)

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the envelope; they were clamped, unless the structure extrapolates."""
        return self._flags[CLAMPED] != 0

    @property
    def held(self) -> bool:
        """True if the last force lay outside the force envelope and was held at its end."""
        return self._flags[HELD] != 0

    def half_width(self) -> float | None:
        """Return the half-width [N] of the band around the force that `step` has just returned, None without one."""
        width = self._half_width()
        return width if isfinite(width) and not self.is_late else None

    def skip_late(self, until_ns: int) -> None:
        """Give no estimates in `late` up to this stamp: another estimator has given them."""
        self._skip_late(until_ns)


def describe_rate(rate_Hz: float, least_Hz: float) -> str:
    """Return that positions come too seldom for a model."""
    return f"positions come at about {rate_Hz:.0f} Hz; this model needs {least_Hz:.0f} Hz or more"


def _explain_types(stamp_ns: object, **numbers: object) -> CesError:
    """Return the error for the argument of a step that has the wrong type."""
    if not hasattr(stamp_ns, "__index__"):
        return CesError(f"stamp_ns: is {stamp_ns!r}; expected whole nanoseconds, as int(1e9 * time_s)")
    name, value = next(((n, v) for n, v in numbers.items() if not isinstance(v, Real)), ("motion", numbers["motion"]))
    return CesError(f"{name}: is {value!r}; expected a number (NaN if it is missing)")
