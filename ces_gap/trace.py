"""A recording beside its simulation on one uniform grid: what every part of the diagnosis looks at.

Nothing here is causal: a diagnosis is made offline, so position is smoothed and forces are band-limited without delay.
Measured and simulated force pass the same filter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ces_gap.derivative import derivative
from ces_gap.errors import GapError
from ces_gap.grid import (
    base_times,
    bridge_gaps,
    estimate_noise_N,
    find_low_pass_Hz,
    find_rates,
    smooth_out,
    thin_out,
    without_edges,
)
from ces_gap.plant_map.own_spring import PumpedMap, SprungMap, learn_pumped_map, learn_sprung_map
from ces_gap.plant_map.speed_map import SpeedMap, learn_map
from ces_identify.preparation.series import hold_current
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation, find_predictions

F = NDArray[np.float64]
B = NDArray[np.bool_]

CURRENT_AGE_S = 0.5  # [s] a current older than this is not known
EDGE_S = 0.1  # [s] at either end of a stretch, where filters run in
MIN_USABLE_S = 1.0  # [s] of usable samples


@dataclass(frozen=True)
class TraceInputs:
    """What drives the damper: `position` [m], `speed` [m/s] and `current` [A] on a trace's grid, each (n,)."""

    position: F
    speed: F
    current: F
    current_as_logged: bool = False  # a simulation that is run again then gets the logged current, not the grid's

    def with_position(self, position: F, rate_Hz: float) -> TraceInputs:
        """Return the same with another position [m] (n,), and the speed changed by as much as the position is."""
        return replace(self, position=position, speed=self.speed + derivative(position - self.position, rate_Hz))

    def with_current(self, current: F) -> TraceInputs:
        """Return the same with another current [A] (n,)."""
        return replace(self, current=current, current_as_logged=False)


@dataclass(frozen=True)
class Trace:
    """A recording on a uniform grid.

    Arrays over n ticks: `time_s` from the first position sample; `inputs`; `acceleration` [m/s2]; `force` [N] measured;
    `simulated` [N], the simulation on the smoothed position, `simulated_as_logged` [N] on the position as logged.
    `usable` (n,) marks the ticks at which all of them are known and filters have run in; elsewhere they are bridged
    with plain numbers. `low_pass_Hz` is that of the position. `noise_N` is the RMS of the force's noise on the grid:
    white noise as strong as what was logged in the top eighth of frequencies. `map_ticks` (n,) are the ticks from which
    `sprung_map` and `pumped_map` are learnt, the usable ones if None.
    """

    name: str
    rate_Hz: float
    time_s: F
    inputs: TraceInputs
    acceleration: F
    force: F
    simulated: F
    simulated_as_logged: F
    usable: B
    recording: Recording
    low_pass_Hz: float
    noise_N: float
    map_ticks: B | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def step_s(self) -> float:
        """Seconds from tick to tick."""
        return 1.0 / self.rate_Hz

    @cached_property
    def sprung_map(self) -> SprungMap:
        """What the simulated force says of the plant: a map of speed and current behind one spring."""
        return learn_sprung_map(*self._simulated())

    @cached_property
    def pumped_map(self) -> PumpedMap:
        """The same behind a spring that is another while the damper is pushed and moves in."""
        return learn_pumped_map(*self._simulated(), self.sprung_map.compliance)

    def _simulated(self) -> tuple[F, F, F, B, float]:
        ticks = self.usable if self.map_ticks is None else self.map_ticks
        return self.inputs.speed, self.inputs.current, self.simulated, ticks, self.rate_Hz

    def learn_map(self, inputs: TraceInputs, force: F) -> SpeedMap:
        """Return the map of speed and current that explains the `force` [N] (n,) under `inputs` best."""
        return learn_map(inputs.speed, inputs.current, force, self.usable)

    def grid_ns(self) -> NDArray[np.int64]:
        """Return the stamps [ns] of the ticks (n,)."""
        first = int(self.recording.channel("position").stamps_ns[0])
        return np.asarray(first + np.round(self.time_s * 1e9).astype(np.int64), dtype=np.int64)


def make_trace(recording: Recording, simulated_N: F) -> Trace:
    """Return the trace of `recording` and the force [N] simulated at each of its position samples (p,), NaN if none.

    A recording without a force channel gets a force of zeros and no usable tick (as when only replaying). Raises
    GapError if less than a second could be used.
    """
    clock = recording.channel("position").stamps_ns
    seconds = (clock - clock[0]) * 1e-9
    base_Hz, factor = find_rates(seconds, recording.name)
    base = base_times(seconds, base_Hz)
    position, known_x = bridge_gaps(seconds, recording.channel("position").values, base)
    low_pass = find_low_pass_Hz(position, base_Hz)
    position = smooth_out(position, low_pass, base_Hz)
    force, known_f = np.zeros_like(base), np.zeros(len(base), bool)
    if "force" in recording.channels:
        channel = recording.channel("force")
        force, known_f = bridge_gaps((channel.stamps_ns - clock[0]) * 1e-9, channel.values, base)
    simulated, known_s = bridge_gaps(seconds, simulated_N, base)
    current = hold_current(recording, clock[0] + np.round(base * 1e9).astype(np.int64), CURRENT_AGE_S)
    known_i = np.isfinite(current)
    current = np.interp(base, base[known_i], current[known_i]) if known_i.any() else np.zeros_like(base)
    usable = without_edges(known_x & known_f & known_s & known_i, round(EDGE_S * base_Hz))
    keep = slice(None, None, factor)
    rate = base_Hz / factor
    speed = derivative(position, base_Hz)
    return Trace(
        name=recording.name,
        rate_Hz=rate,
        time_s=base[keep],
        inputs=TraceInputs(position[keep], speed[keep], current[keep], current_as_logged=True),
        acceleration=derivative(speed, base_Hz)[keep],
        force=thin_out(force, factor),
        simulated=thin_out(simulated, factor),
        simulated_as_logged=thin_out(simulated, factor),
        usable=usable[keep],
        recording=recording,
        low_pass_Hz=low_pass,
        noise_N=estimate_noise_N(recording, clock, base, factor),
    )


def open_trace(simulation: Simulation, recording: Recording, also_as_logged: bool = True) -> Trace:
    """Return the trace of a recording under a simulation, which is run on the smoothed position if it can be run.

    Without `also_as_logged` it is run once only. Raises what the simulation raises, and GapError.
    """
    recorded = find_predictions(simulation) is not None
    given = make_trace(recording, simulation.force(recording) if also_as_logged or recorded else _nothing(recording))
    if recorded:
        return given
    smooth = smooth_recording(recording, given)
    trace = make_trace(smooth, simulation.force(smooth))
    return replace(trace, simulated_as_logged=given.simulated if also_as_logged else trace.simulated)


def _nothing(recording: Recording) -> F:
    return np.zeros(len(recording.channel("position")))


def resample_to_grid(trace: Trace, simulated_N: F) -> F:
    """Return a force [N] given at each position sample of the trace's recording on its grid (n,)."""
    clock = trace.recording.channel("position").stamps_ns
    seconds = (clock - clock[0]) * 1e-9
    base_Hz, factor = find_rates(seconds, trace.name)
    return thin_out(bridge_gaps(seconds, simulated_N, base_times(seconds, base_Hz))[0], factor)


def smooth_recording(recording: Recording, trace: Trace) -> Recording:
    """Return the recording with the trace's smoothed position at the stamps of the logged one, where it is finite."""
    position = recording.channel("position")
    seconds = (position.stamps_ns - position.stamps_ns[0]) * 1e-9
    values = CubicSpline(trace.time_s, trace.inputs.position)(np.clip(seconds, 0.0, trace.time_s[-1]))
    values = np.where(np.isfinite(position.values), values, position.values)
    return replace(recording, channels={**recording.channels, "position": replace(position, values=values)})


def require_usable(trace: Trace) -> None:
    """Raise GapError if the trace has less than a second in which position, current, force and simulation are known."""
    seconds = float(trace.usable.sum()) / trace.rate_Hz
    if seconds < MIN_USABLE_S:
        raise GapError(
            f"{trace.name}: {seconds:.2f} s with position, current, force and a simulated force together; "
            f"expected at least {MIN_USABLE_S:g} s; check --signals and that the channels overlap in time"
        )
