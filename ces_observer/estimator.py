"""The estimator: stamped position and current in; damping force, or the reason why there is none, out.

It is driven by position samples alone and has no clock, so its forces are the same in real time, in simulated time and
offline. `ces_observer.tick.estimator` computes them; `ces_identify.simulations.simulate.sample_run` is its batch form.

A model with a delay estimates the force of a sample when the speed is known better, so many ticks later. Its estimates
come out in `late`, each with the stamp of the sample that it belongs to: the first sample of every tick.
"""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import NamedTuple

from ces_observer.core import bind, floats, ints
from ces_observer.flat import Arrays, Layout
from ces_observer.model import Model, load_model
from ces_observer.reasons import REASONS
from ces_observer.sampling_layout import fill_tracker
from ces_observer.tick import estimator as tick
from ces_observer.tick.estimator import CAUSE, FORCE, LATE_COUNT, LATE_STAMPS, LATE_VALUES, LATE_WIDTH, REASON
from ces_observer.tick.model import CLAMPED, HELD
from ces_observer.tick.run import run_half_width
from ces_observer.tick.tracker import P_ESTIMATOR, TRACK_POSITION, TRACK_SPEED


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
    layout = Layout(P_ESTIMATOR, tick.N_ESTIMATOR_END, tick.S_ESTIMATOR_END, tick.K_ESTIMATOR_END)
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
        self._skip_late = bind(tick.estimator_skip_late, self._n, self._s, self._k)
        self.is_late = model.sampling.delay_ticks > 0
        self.delay_ns = round(model.sampling.delay_ticks / model.sampling.rate_Hz * 1e9)
        self.reset()

    def reset(self) -> None:
        """Bring the estimator back to new."""
        self._reset()

    def step(self, stamp_ns: int, position_m: float, current_A: float, motion: float = 0.0) -> float | None:
        """Return the force [N] at `stamp_ns`, within the model's force envelope, or None with `reason` set.

        `motion` is the signal `model.sampling.motion`, if the model needs one. Bad samples count as missing. A model
        with a delay has no force at once: the reason is "ok" while `late` has those of earlier samples.
        """
        if self._step(stamp_ns, position_m, current_A, motion) or self.is_late:
            return None
        force: float = self._s[FORCE]
        return force

    @property
    def reason(self) -> str:
        """The word "ok", or why the last force was withheld."""
        return REASONS[self._k[REASON]]

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
