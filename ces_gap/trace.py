"""A recording beside its simulation on one uniform grid: what every part of the diagnosis looks at.

Nothing here is causal: a diagnosis is made offline, so position is smoothed and forces are band-limited without delay.
Measured and simulated force pass the same filter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, firwin, sosfiltfilt, welch

from ces_gap.errors import GapError
from ces_gap.recorded import recorded_in
from ces_identify.preparation.series import held_current
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation

F = NDArray[np.float64]
B = NDArray[np.bool_]

GRID_HZ = 500.0  # [Hz] highest rate of the grid: an effect of a damper shows far below half of it
GAP_S = 0.05  # [s] longer silence of a channel is not bridged
CURRENT_AGE_S = 0.5  # [s] a current older than this is not known
EDGE_S = 0.1  # [s] at either end of a stretch, where filters run in
SMOOTHING_HZ = (15.0, 70.0)  # [Hz] range of the position's low-pass
ABOVE_NOISE = 10.0  # power of the position over its noise floor up to where it is kept
LEAST_S = 1.0  # [s] of usable samples


@dataclass(frozen=True)
class Inputs:
    """What drives the damper: `position` [m], `speed` [m/s] and `current` [A] on a trace's grid, each (n,)."""

    position: F
    speed: F
    current: F

    def moved(self, position: F, rate_Hz: float) -> Inputs:
        """Return the same with another position [m] (n,), and the speed changed by as much as the position is."""
        return Inputs(position, self.speed + derivative(position - self.position, rate_Hz), self.current)

    def powered(self, current: F) -> Inputs:
        """Return the same with another current [A] (n,)."""
        return replace(self, current=current)


@dataclass(frozen=True)
class Trace:
    """A recording on a uniform grid.

    Arrays over n ticks: `time_s` from the first position sample; `inputs`; `acceleration` [m/s2]; `force` [N] measured;
    `simulated` [N], the simulation on the smoothed position, `as_given` [N] on the position as logged. `usable` (n,)
    marks the ticks at which all of them are known and filters have run in; elsewhere they are bridged with plain
    numbers. `low_pass_Hz` is that of the position. `noise_N` is the RMS of the force's noise on the grid: white noise
    as strong as what was logged in the top eighth of frequencies.
    """

    name: str
    rate_Hz: float
    time_s: F
    inputs: Inputs
    acceleration: F
    force: F
    simulated: F
    as_given: F
    usable: B
    recording: Recording
    low_pass_Hz: float
    noise_N: float

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def step_s(self) -> float:
        """Seconds from tick to tick."""
        return 1.0 / self.rate_Hz

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
    base_Hz, factor = _rates(seconds, recording.name)
    base = _base(seconds, base_Hz)
    position, known_x = _bridged(seconds, recording.channel("position").values, base)
    low_pass = _low_pass_Hz(position, base_Hz)
    position = _smoothed(position, low_pass, base_Hz)
    force, known_f = np.zeros_like(base), np.zeros(len(base), bool)
    if "force" in recording.channels:
        channel = recording.channel("force")
        force, known_f = _bridged((channel.stamps_ns - clock[0]) * 1e-9, channel.values, base)
    simulated, known_s = _bridged(seconds, simulated_N, base)
    current = held_current(recording, clock[0] + np.round(base * 1e9).astype(np.int64), CURRENT_AGE_S)
    known_i = np.isfinite(current)
    current = np.interp(base, base[known_i], current[known_i]) if known_i.any() else np.zeros_like(base)
    usable = _run_in(known_x & known_f & known_s & known_i, round(EDGE_S * base_Hz))
    keep = slice(None, None, factor)
    rate = base_Hz / factor
    speed = derivative(position, base_Hz)
    return Trace(
        name=recording.name,
        rate_Hz=rate,
        time_s=base[keep],
        inputs=Inputs(position[keep], speed[keep], current[keep]),
        acceleration=derivative(speed, base_Hz)[keep],
        force=_thinned(force, factor),
        simulated=_thinned(simulated, factor),
        as_given=_thinned(simulated, factor),
        usable=usable[keep],
        recording=recording,
        low_pass_Hz=low_pass,
        noise_N=_noise_N(recording, clock, base, factor),
    )


def open_trace(simulation: Simulation, recording: Recording, as_given: bool = True) -> Trace:
    """Return the trace of a recording under a simulation, which is run on the smoothed position if it can be run.

    Without `as_given` it is run once only. Raises what the simulation raises, and GapError.
    """
    recorded = recorded_in(simulation) is not None
    given = make_trace(recording, simulation.force(recording) if as_given or recorded else _nothing(recording))
    if recorded:
        return given
    smooth = smoothed(recording, given)
    trace = make_trace(smooth, simulation.force(smooth))
    return replace(trace, as_given=given.simulated if as_given else trace.simulated)


def _nothing(recording: Recording) -> F:
    return np.zeros(len(recording.channel("position")))


def on_grid(trace: Trace, simulated_N: F) -> F:
    """Return a force [N] given at each position sample of the trace's recording on its grid (n,)."""
    clock = trace.recording.channel("position").stamps_ns
    seconds = (clock - clock[0]) * 1e-9
    base_Hz, factor = _rates(seconds, trace.name)
    return _thinned(_bridged(seconds, simulated_N, _base(seconds, base_Hz))[0], factor)


def smoothed(recording: Recording, trace: Trace) -> Recording:
    """Return the recording with the trace's smoothed position at the stamps of the logged one, where it is finite."""
    position = recording.channel("position")
    seconds = (position.stamps_ns - position.stamps_ns[0]) * 1e-9
    values = CubicSpline(trace.time_s, trace.inputs.position)(np.clip(seconds, 0.0, trace.time_s[-1]))
    values = np.where(np.isfinite(position.values), values, position.values)
    return replace(recording, channels={**recording.channels, "position": replace(position, values=values)})


def require_usable(trace: Trace) -> None:
    """Raise GapError if the trace has less than a second in which position, current, force and simulation are known."""
    seconds = float(trace.usable.sum()) / trace.rate_Hz
    if seconds < LEAST_S:
        raise GapError(
            f"{trace.name}: {seconds:.2f} s with position, current, force and a simulated force together; "
            f"expected at least {LEAST_S:g} s; check --signals and that the channels overlap in time"
        )


def derivative(values: F, rate_Hz: float) -> F:
    """Return the derivative of uniform samples (n,), central differences of fourth order, lower at the ends."""
    out: F = np.gradient(values) * rate_Hz
    if len(values) > 4:
        out[2:-2] = (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) * (rate_Hz / 12.0)
    return out


def _rates(seconds: F, name: str) -> tuple[float, int]:
    """Return the rate of the position samples [Hz] and by how much the grid is coarser."""
    steps = np.diff(seconds)
    steps = steps[steps > 0.0]
    if len(steps) < 100:
        raise GapError(f"{name}: {len(steps) + 1} position samples; expected at least 100")
    rate = 1.0 / float(np.median(steps))
    rate = round(rate) if abs(rate - round(rate)) < 0.02 * rate else rate
    return float(rate), max(1, round(rate / GRID_HZ - 0.25))


def _base(seconds: F, rate_Hz: float) -> F:
    return np.arange(int(seconds[-1] * rate_Hz + 1e-6) + 1) / rate_Hz


def _bridged(seconds: F, values: F, grid: F) -> tuple[F, B]:
    """Return the values on the grid, gaps bridged, and where (n,) they are known."""
    good = np.isfinite(values)
    if good.sum() < 2:
        return np.zeros_like(grid), np.zeros(len(grid), bool)
    at, first = np.unique(seconds[good], return_index=True)
    after = np.clip(np.searchsorted(at, grid), 1, len(at) - 1)
    known = (grid >= at[0]) & (grid <= at[-1]) & (np.diff(at)[after - 1] <= GAP_S)
    return np.interp(grid, at, values[good][first]), known


def _low_pass_Hz(position: F, rate_Hz: float) -> float:
    """Return up to where the position stands out of its noise [Hz]."""
    frequency, power = welch(position, rate_Hz, nperseg=min(len(position), 2048))
    floor = float(np.median(power[3 * len(power) // 4 :]))
    signal = np.flatnonzero(power > ABOVE_NOISE * floor)
    top = float(frequency[signal[-1]]) if len(signal) else SMOOTHING_HZ[1]
    return float(np.clip(1.5 * top, SMOOTHING_HZ[0], min(SMOOTHING_HZ[1], 0.4 * rate_Hz)))


def _smoothed(position: F, low_pass_Hz: float, rate_Hz: float) -> F:
    sos = butter(4, low_pass_Hz, fs=rate_Hz, output="sos")
    return np.asarray(sosfiltfilt(sos, position, padlen=min(len(position) - 1, round(0.2 * rate_Hz))))


def _thinned(values: F, factor: int) -> F:
    """Return every `factor`-th value behind a symmetric low-pass at half the grid's rate."""
    if factor == 1:
        return values
    taps = _taps(factor)
    padded = np.pad(values, 4 * factor, mode="edge")
    return np.asarray(np.convolve(padded, taps, mode="valid")[::factor])


def _taps(factor: int) -> F:
    return np.asarray(firwin(8 * factor + 1, 0.8 / factor))


def _noise_N(recording: Recording, clock: NDArray[np.int64], base: F, factor: int) -> float:
    """Return the RMS [N] on the grid of white noise as strong as the force logged in the top eighth of frequencies."""
    if "force" not in recording.channels:
        return 0.0
    channel = recording.channel("force")
    values = channel.values[np.isfinite(channel.values)]
    power = welch(values, 2.0, nperseg=min(len(values), 64), average="median")[1]
    level = float(np.median(power[7 * len(power) // 8 : -1]))
    drawn = np.random.default_rng(0).standard_normal(len(channel))  # what resampling leaves of it
    resampled = _thinned(_bridged((channel.stamps_ns - clock[0]) * 1e-9, drawn, base)[0], factor)
    return float(np.sqrt(level) * resampled.std())


def _run_in(known: B, edge: int) -> B:
    """Return `known` without `edge` samples at either end of each stretch."""
    unknown = np.pad((~known).astype(np.float64), edge, constant_values=1.0)
    near: F = np.convolve(unknown, np.ones(2 * edge + 1), mode="valid")
    return np.asarray(near < 0.5)
