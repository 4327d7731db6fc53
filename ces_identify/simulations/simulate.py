"""A model over whole arrays: a recording or a prepared series in; the estimator's force out, or that some ticks ahead.

Ahead, a model of its own past force continues from the measured one (Ljung, System Identification, 2nd ed., section
3.2); where none was measured, from its own. The others, such as hydraulic networks, know no past force: what they
predict is what they simulate, however far ahead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import isfinite, nan
from typing import Any

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_data.recording import Recording
from ces_identify.numerics.core import compile_tick, core_kernel, pointer, with_names
from ces_identify.prepare.series import FreeRun, Series, Tracked, prepare, select_samples, track_samples
from ces_identify.structures import run_batch
from ces_observer.model import Model, Sampling
from ces_observer.structures.mixture import Mixture
from ces_observer.structures.structure import OperatingRange, Range, Structure
from ces_observer.tick.lagged import LAGGED_DEPTH, LAGGED_NEWEST, LAGGED_RINGS
from ces_observer.tick.mixture import structure_reset, structure_tick
from ces_observer.tick.model import K_STRUCTURE, KIND
from ces_observer.tick.polynomial import LAG_COUNT, OUTPUT_LAG_COUNT, OUTPUT_LAG_TABLE
from ces_observer.tick.structure import EXPERTS, FUZZY, POLYNOMIAL, SIGMOID
from ces_observer.tick.tracker import OK, RESTARTED


def simulate_series(model: Model, series: Series) -> FreeRun:
    """Return the free run of `model` on a prepared series."""
    force, held = run_batch(model, series.inputs, series.segments)
    return FreeRun(force, outside_envelope(model, series), held, model.force_envelope_N)


def outside_envelope(model: Model, series: Series) -> Mask:
    """Return where (ticks,) an input of `series` that the model uses is outside its envelope."""
    outside = np.zeros(len(series), bool)
    for name in model.used_ranges:
        outside |= is_outside(model, name, getattr(series, name))
    return outside


def is_outside(model: Model, name: str, values: F, slack: float = 0.0) -> Mask:
    """Return where values (n,) of a signal are outside the model's envelope, or in the gap of its currents.

    `slack`, of the range or of its larger end, is not outside.
    """
    low, high = model.envelope.by_signal[name]
    margin = slack * max(high - low, abs(high), abs(low))
    outside = (values < low - margin) | (values > high + margin)
    if name == "current" and (gap := model.envelope.current_gap_A) is not None:
        outside |= (values > gap[0] + margin) & (values < gap[1] - margin)
    return np.asarray(outside)


@dataclass(frozen=True)
class SampleRun:
    """The free run of a model at the position samples of a recording, as the estimator returns it.

    `force` (n,) [N] is NaN where the estimator withholds it: at unusable samples, in the warm-up, and from a force that
    is not finite to the segment's end (where the estimator would restart its warm-up). `newest` (n,) is the newest tick
    of `series` at each sample, -1 without one, and `ahead` (n,) the time since then [ticks]; `run` is the free run on
    the ticks.
    """

    model: Model
    force: F
    newest: I
    ahead: F
    series: Series
    run: FreeRun

    def held_at(self, samples: Mask) -> tuple[Range, F, Mask]:
        """Return the force envelope [N], and for some samples their time [s] and where the force was held at it."""
        ticks = self.newest[samples]
        return self.model.force_envelope_N, self.series.time_s[ticks], self.run.held[ticks]


def force_at_samples(force: F, newest: I, ahead: F, within: Range) -> F:
    """Return the force [N] at samples (n,) on the line through their last two ticks, held in a range.

    `force` (ticks,) [N] is that on ticks, `newest` (n,) the tick before each sample, `ahead` (n,) ticks before it.
    """
    slope = force[newest] - force[np.maximum(newest - 1, 0)]
    return np.asarray(np.clip(force[newest] + slope * ahead, *within))


def sample_force(model: Model, recording: Recording) -> F:
    """Return the force [N] at every position sample (n,), as the estimator returns it, NaN where it withholds it."""
    return sample_run(model, recording).force


def sample_run(model: Model, recording: Recording) -> SampleRun:
    """Return the free run of `model` at the position samples of `recording`."""
    return run_opened(model, open_recording(recording, model.sampling))


@dataclass(frozen=True)
class OpenedRecording:
    """A recording as models of one sampling see it: its `series`, and the samples with the ticks of each.

    `index` and `tracked` are of the usable ones among `count` position samples.
    """

    series: Series
    index: I
    tracked: Tracked
    count: int


def open_recording(recording: Recording, sampling: Sampling) -> OpenedRecording:
    """Return the recording as models of this sampling see it."""
    samples = select_samples(recording, sampling)
    tracked, count = track_samples(samples, sampling), len(recording.channel("position"))
    return OpenedRecording(prepare(recording, sampling), samples.index, tracked, count)


def run_opened(model: Model, opened: OpenedRecording) -> SampleRun:
    """Return the free run of `model` at the position samples of a recording opened for its sampling."""
    series, tracked = opened.series, opened.tracked
    run = simulate_series(model, series)
    newest = tracked.total - 1
    at_samples = force_at_samples(run.force, newest, tracked.ahead, model.force_envelope_N)
    taken = (tracked.status == OK) | (tracked.status == RESTARTED)
    taken &= np.isfinite(tracked.late[newest, 1])
    starts = series.segments[:, 0]
    since = newest - starts[np.searchsorted(starts, newest, side="right") - 1]
    at_samples[~taken | (since < round(model.warm_up_s * series.rate_Hz))] = np.nan
    out, ticks, ahead = np.full(opened.count, np.nan), np.full(opened.count, -1), np.zeros(opened.count)
    out[opened.index], ticks[opened.index], ahead[opened.index] = at_samples, newest, tracked.ahead
    return SampleRun(model, out, ticks, ahead, series, run)


def since_reversal(series: Series) -> F:
    """Return the time [s] (ticks,) since the last change of direction or segment start."""
    ticks = np.arange(len(series))
    turned = np.append(True, series.speed[1:] * series.speed[:-1] <= 0.0)
    turned[series.segments[:, 0]] = True
    return np.asarray((ticks - np.maximum.accumulate(np.where(turned, ticks, 0))) / series.rate_Hz)


def predict_series(model: Model, series: Series, steps: int) -> F:
    """Return the force [N] on the ticks of a series (ticks,), each predicted `steps` ticks before.

    The first `steps` ticks of a segment are simulated; from a force that is not finite to the segment's end, all are
    NaN.
    """
    inputs = np.ascontiguousarray([series.position, series.speed, series.current])
    return _predict_body(model.body, model.operating_range, inputs, series.force, series.segments, steps)


def _predict_body(body: Structure, within: OperatingRange, inputs: F, measured: F, segments: I, steps: int) -> F:
    if isinstance(body, Mixture):
        parts = (_predict_body(m.body, m.within(within), inputs, measured, segments, steps) for m in body.members)
        mean = sum(member.weight * force for member, force in zip(body.members, parts, strict=True))
        return np.clip(mean, *within.force_N)
    arrays, force = body.lay_out(within).arrays(), np.full(len(measured), np.nan)
    state, flags = np.array(arrays.s), np.array(arrays.k, np.int64)
    given = np.array(arrays.p), np.array(arrays.n, np.int64), state, flags, state.copy(), flags.copy()
    _kernel(body.runs)(*given, inputs, measured, segments, steps, force)
    return force


@core_kernel
def feed_force(n: Any, s: Any, k: Any, force: float) -> None:
    """Put a measured force [N] in the place of the newest one of a model's own."""
    if n[KIND] == POLYNOMIAL:
        first = K_STRUCTURE + n[LAG_COUNT]
        for i in range(n[OUTPUT_LAG_COUNT]):
            row = n[OUTPUT_LAG_TABLE] + 3 * i
            newest = k[first + i] - 1
            s[newest if newest >= n[row + 1] else n[row + 2] - 1] = force
    elif n[KIND] == SIGMOID or n[KIND] == FUZZY or n[KIND] == EXPERTS:
        s[n[LAGGED_RINGS] + 3 * n[LAGGED_DEPTH] + k[LAGGED_NEWEST]] = force


def _predict(
    numbers: F, counts: I, states: F, flags: I, own: F, kept: I, inputs: F, measured: F, segments: I, steps: int, out: F
) -> None:
    """Run along the measured force in `states` and `flags`; from each tick on, run free in `own` and `kept`."""
    p, n, s, k = pointer(numbers), pointer(counts), pointer(states), pointer(flags)
    ahead_s, ahead_k = pointer(own), pointer(kept)
    for segment in range(len(segments)):
        begin, end = segments[segment, 0], segments[segment, 1]
        structure_reset(p, n, s, k)
        for i in range(begin, end):
            own[:], kept[:] = states, flags
            for j in range(i, min(i + steps, end)):
                force = structure_tick(p, n, ahead_s, ahead_k, inputs[0, j], inputs[1, j], inputs[2, j])
                if j == i + steps - 1 or i == begin:
                    out[j] = force if isfinite(force) else nan
            force = structure_tick(p, n, s, k, inputs[0, i], inputs[1, i], inputs[2, i])
            if not isfinite(force):
                out[i:end] = nan
                break
            if isfinite(measured[i]):
                feed_force(n, s, k, measured[i])


@cache
def _kernel(runs: tuple[Any, Any]) -> Any:
    """Return the kernel compiled for a structure's reset and tick."""
    reset, tick = runs
    names = {"structure_reset": compile_tick(reset), "structure_tick": compile_tick(tick)}
    return with_names(_predict, f"predict_{runs[1].__name__}", names)
