"""A recording and its simulation on one uniform grid: the data of every part of the diagnosis.

Nothing here is causal: a diagnosis runs offline, so the position is smoothed and forces are band-limited without delay.
Measured and simulated force pass the same filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ces_data.arrays import F, Mask
from ces_data.recording import Channel, Recording
from ces_data.samples import measured_at, without_spikes
from ces_gap.errors import GapError
from ces_gap.grid import (
    bridge_gaps,
    derivative,
    find_low_pass_Hz,
    interpolate,
    lay_base_grid,
    rms,
    smooth_out,
    thin_out,
    without_edges,
)
from ces_gap.limits import DiagnosisLimits
from ces_gap.plant_map import RecentMaps, SpeedMap, SprungMap, learn_sprung_map
from ces_gap.sensor_noise import UNMEASURED, GridSignals, MeasuredNoise, measure_noise
from ces_identify.prepare.series import hold_current
from ces_identify.simulations.simulation import Simulation, find_predictions

EDGE_S = 0.1  # [s] at both ends of a segment, where filters settle


@dataclass(frozen=True)
class TraceInputs:
    """Inputs of the damper: `position` [m], `speed` [m/s] and `current` [A] on a trace's grid, each (n,)."""

    position: F
    speed: F
    current: F
    current_as_logged: bool = False  # True: reruns of the simulation use the logged current, not that of the grid

    def with_position(self, position: F, rate_Hz: float) -> TraceInputs:
        """Return the inputs with another position [m] (n,), the speed changed consistently."""
        return replace(self, position=position, speed=self.speed + derivative(position - self.position, rate_Hz))

    def with_current(self, current: F) -> TraceInputs:
        """Return the inputs with another current [A] (n,)."""
        return replace(self, current=current, current_as_logged=False)


@dataclass(frozen=True)
class Trace:
    """A recording on a uniform grid.

    Arrays over n ticks: `time_s` from the first position sample; `inputs`; `acceleration` [m/s2]; measured `force` [N];
    `simulated` force [N] on the smoothed position, `simulated_as_logged` [N] on the logged position. `usable` (n,)
    marks the ticks at which all of them are known and filters have settled; elsewhere they are interpolated.
    `noise_N` is the RMS of the force noise on the grid, `measured_noise` where it is from. `simulated_left_out` [N] is
    the force by models that were not fitted to this recording, if the simulation was; `simulated_at_base` [N] is the
    simulated force at the position's rate, before the low-pass of the grid. `sprung_map` is learnt on
    `map_ticks` (n,), on the usable ticks if None.
    """

    name: str
    rate_Hz: float
    time_s: F
    inputs: TraceInputs
    acceleration: F
    force: F
    simulated: F
    simulated_as_logged: F
    simulated_at_base: F
    usable: Mask
    recording: Recording
    noise_N: float
    map_ticks: Mask | None = None
    measured_noise: MeasuredNoise = UNMEASURED
    simulated_left_out: F | None = None
    own_error_N: float = 0.0  # RMS error that the simulation may have here, 0 if it does not say

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def step_s(self) -> float:
        """Seconds between ticks."""
        return 1.0 / self.rate_Hz

    @cached_property
    def sample_s(self) -> float:
        """Seconds between samples of the simulated force as it was logged, or of the position if that is slower."""
        channels = (self.recording.channels.get(name) for name in ("position", "sim_force"))
        steps = [np.diff(c.stamps_ns) for c in channels if c is not None and len(c) > 1]
        return float(max(np.median(s) for s in steps)) * 1e-9

    @cached_property
    def sprung_map(self) -> SprungMap:
        """The map of speed and current behind a spring that fits the simulated force best."""
        ticks = self.usable if self.map_ticks is None else self.map_ticks
        return learn_sprung_map(self.inputs.speed, self.inputs.current, self.simulated, ticks, self.rate_Hz)

    @cached_property
    def _recent_maps(self) -> RecentMaps:
        return RecentMaps()

    def learn_map(self, inputs: TraceInputs, force: F) -> SpeedMap:
        """Return the map of speed and current that fits the `force` [N] (n,) under `inputs` best."""
        return self._recent_maps.learn(inputs.speed, inputs.current, force, self.usable)

    @cached_property
    def base_grid(self) -> tuple[F, F, int]:
        """Times [s] of the position samples (p,), times of an even grid at their rate, and its factor of decimation."""
        clock = self.recording.channel("position").stamps_ns
        seconds = (clock - clock[0]) * 1e-9
        base, base_Hz, _ = lay_base_grid(seconds, self.name)
        return seconds, base, round(base_Hz / self.rate_Hz)

    def grid_ns(self) -> NDArray[np.int64]:
        """Return the time stamps [ns] of the ticks (n,)."""
        return _stamps(self.recording, self.time_s)


def make_trace(recording: Recording, simulated_N: F, noise: MeasuredNoise | None = None, thinned: bool = True) -> Trace:
    """Return the trace of `recording`; `simulated_N` [N] (p,) is at its position samples, NaN where unknown.

    The `noise` of the force is measured unless it is given. If it is not to be `thinned`, the grid has the rate of the
    position. Without a force channel the force is zero and no tick is usable. Raises GapError if there are too few
    samples.
    """
    logged = without_spikes(recording, dropouts=False)  # a force that stays 0 after a jump may be play
    trace = _lay_on_grid(recording, logged, simulated_N, thinned)
    noise = noise or _measure_noise(trace, logged.channels.get("force"), simulated_N)
    return replace(trace, noise_N=noise.rms_N, measured_noise=noise)


def _lay_on_grid(recording: Recording, logged: Recording, simulated_N: F, thinned: bool) -> Trace:
    """Return the trace of a recording, which was `logged` without spikes; its noise is not measured."""
    clock = recording.channel("position").stamps_ns
    seconds = (clock - clock[0]) * 1e-9
    base, base_Hz, factor = lay_base_grid(seconds, recording.name)
    factor = factor if thinned else 1
    position, known_x = bridge_gaps(seconds, logged.channel("position").values, base)
    position = smooth_out(position, find_low_pass_Hz(position, base_Hz), base_Hz)
    speed = derivative(position, base_Hz)
    force, known_f, measured = _bridge_force(logged, base, factor)
    simulated, known_s = bridge_gaps(seconds, simulated_N, base)
    current, known_i = bridge_current(logged, base)
    usable = without_edges(known_x & known_f & known_s & known_i, round(EDGE_S * base_Hz)) & measured
    keep = slice(None, None, factor)
    return Trace(
        name=recording.name,
        rate_Hz=base_Hz / factor,
        time_s=base[keep],
        inputs=TraceInputs(position[keep], speed[keep], current[keep], current_as_logged=True),
        acceleration=derivative(speed, base_Hz)[keep],
        force=thin_out(force, factor),
        simulated=thin_out(simulated, factor),
        simulated_as_logged=thin_out(simulated, factor),
        usable=usable[keep],
        recording=recording,
        noise_N=0.0,
        simulated_at_base=simulated,
    )


def _bridge_force(logged: Recording, base: F, factor: int) -> tuple[F, Mask, Mask]:
    """Return the measured force [N] (n,) at times `base` [s], where it is known, and where thinning finds no gap."""
    channel, start_ns = logged.channels.get("force"), logged.channel("position").stamps_ns[0]
    if channel is None:
        return np.zeros_like(base), np.zeros(len(base), bool), np.zeros(len(base), bool)
    force, known = bridge_gaps((channel.stamps_ns - start_ns) * 1e-9, channel.values, base)
    return force, known, without_edges(measured_at(channel, _stamps(logged, base)), factor - 1)


def bridge_current(recording: Recording, base: F) -> tuple[F, Mask]:
    """Return the held current [A] (n,) at times `base` [s], and where it is known; elsewhere it is interpolated."""
    current = hold_current(recording, _stamps(recording, base), DiagnosisLimits.CURRENT_AGE_S)
    known = np.isfinite(current)
    return np.interp(base, base[known], current[known]) if known.any() else np.zeros_like(base), known


def _stamps(recording: Recording, base: F) -> NDArray[np.int64]:
    """Return the time stamps [ns] (n,) of times [s] after the first position sample."""
    first_ns = recording.channel("position").stamps_ns[0]
    return np.asarray(first_ns + np.round(base * 1e9).astype(np.int64), dtype=np.int64)


def _measure_noise(trace: Trace, channel: Channel | None, simulated_N: F) -> MeasuredNoise:
    """Return the noise of the force `channel` on the grid of a trace; `simulated_N` [N] is at the position samples."""
    if channel is None:
        return UNMEASURED
    (seconds, base, factor), inputs = trace.base_grid, trace.inputs
    force_s = (channel.stamps_ns - trace.recording.channel("position").stamps_ns[0]) * 1e-9
    motion = inputs.position, inputs.speed, trace.acceleration, inputs.current
    signals = GridSignals(trace.rate_Hz, *motion, trace.force, trace.usable)
    beside = np.interp(force_s, seconds, simulated_N, np.nan, np.nan)
    return measure_noise(channel.values, lambda v: thin_out(interpolate(force_s, v, base), factor), signals, beside)


def open_trace(simulation: Simulation, recording: Recording, also_as_logged: bool = True) -> Trace:
    """Return the trace of a recording; the simulation runs on the smoothed position, if it can be run.

    With `also_as_logged` it runs on the logged position as well. Raises GapError and the errors of the simulation.
    """
    recorded = find_predictions(simulation) is not None
    run_as_logged = also_as_logged or recorded
    force = simulation.force(recording) if run_as_logged else np.zeros(len(recording.channel("position")))
    logged = make_trace(recording, force)
    if recorded:
        return logged
    smooth = smooth_recording(recording, logged)
    trace = make_trace(smooth, simulation.force(smooth), logged.measured_noise)
    return replace(trace, simulated_as_logged=logged.simulated if also_as_logged else trace.simulated)


def resample_to_grid(trace: Trace, simulated_N: F) -> F:
    """Return a force [N] at the position samples of the recording, resampled to the grid of its trace (n,)."""
    seconds, base, factor = trace.base_grid
    return thin_out(interpolate(seconds, simulated_N, base), factor)


def with_simulation(trace: Trace, simulated_N: F) -> Trace:
    """Return the trace with another simulated force [N], at the position samples of its recording."""
    seconds, base, factor = trace.base_grid
    force = interpolate(seconds, simulated_N, base)
    return replace(trace, simulated=thin_out(force, factor), simulated_at_base=force)


def smooth_recording(recording: Recording, trace: Trace) -> Recording:
    """Return the recording with the finite position samples replaced by the smoothed position of the trace."""
    position = recording.channel("position")
    seconds = (position.stamps_ns - position.stamps_ns[0]) * 1e-9
    values = CubicSpline(trace.time_s, trace.inputs.position)(np.clip(seconds, 0.0, trace.time_s[-1]))
    values = np.where(np.isfinite(position.values), values, position.values)
    return replace(recording, channels={**recording.channels, "position": replace(position, values=values)})


def usable_values(traces: Sequence[Trace], values: Sequence[F]) -> F:
    """Return the `values` (n,) on the usable ticks of all traces, concatenated."""
    return np.concatenate([v[t.usable] for t, v in zip(traces, values, strict=True)])


def usable_inputs(traces: Sequence[Trace], name: str) -> F:
    """Return the input `name` (position, speed or current) on the usable ticks of all traces, concatenated."""
    return usable_values(traces, [getattr(t.inputs, name) for t in traces])


def noise_floor_N(traces: Sequence[Trace], as_logged: bool = False) -> float:
    """Return the RMS [N] of the measured noise of several traces together, on the grid or of the samples as logged."""
    shares = [t.measured_noise.passes if as_logged else 1.0 for t in traces]
    return float(np.sqrt(np.mean([(t.noise_N / share) ** 2 for t, share in zip(traces, shares, strict=True)])))


def gap_N(traces: Sequence[Trace], forces: Sequence[F], noise_N: float) -> float:
    """Return the RMS [N] of measured minus modelled force (n,) on the usable ticks, less that of the noise."""
    error = usable_values(traces, [t.force - force for t, force in zip(traces, forces, strict=True)])
    return float(np.sqrt(max(rms(error) ** 2 - noise_N**2, 0.0)))


def own_error_N(traces: Sequence[Trace]) -> float:
    """Return the RMS error [N] that the simulation may have on several traces together, 0 if it does not say."""
    return float(np.sqrt(np.mean([t.own_error_N**2 for t in traces])))


def require_usable(trace: Trace) -> None:
    """Raise GapError if the trace has too few usable ticks."""
    seconds = float(trace.usable.sum()) / trace.rate_Hz
    if seconds < DiagnosisLimits.MIN_USABLE_S:
        raise GapError(
            f"{trace.name}: {seconds:.2f} s with position, current, force and a simulated force together; "
            f"expected at least {DiagnosisLimits.MIN_USABLE_S:g} s; "
            "check the signals file and that the channels overlap in time"
        )
