"""From a recording to stretches of uniform samples: position, speed without delay, held current, and forces.

The position is low-passed forwards and backwards (2nd-order Butterworth, so 4th order in all and without phase) and
differentiated by central differences of fourth order. Forces are not filtered. The bandwidth is the widest at which the
noise of the position makes at most `NOISE_SHARE` of the RMS speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ces_data.arrays import F, I
from ces_data.recording import Channel, Recording
from ces_data.samples import remove_spikes, without_spikes
from ces_identify.limits import MotionLimits
from ces_identify.numerics.correlation import noise_rms
from ces_identify.prepare.sampling import longest_gap_s, sample_rate
from ces_identify.prepare.series import hold_current, interpolate_force, usable_samples

MEASURED = "measured"
ROUND_S = 1e-9


@dataclass(frozen=True)
class Stretch:
    """Uniform samples without a gap, arrays of shape (n,).

    `time_s` counts from the first position sample of the recording. `forces` holds the force [N] of each source, NaN
    where it has none. `current` [A] is the newest at each sample, logged at the stamps `current_s` [s].
    """

    rate_Hz: float
    time_s: F
    position: F
    speed: F
    current: F
    current_s: F
    forces: Mapping[str, F]


@dataclass(frozen=True)
class RecordingMotion:
    """The stretches of a recording, the bandwidth of its speed, and the noise of speed and force (1 sigma).

    `force_noise_N` is the noise from sample to sample; noise that a filter of the logger removed does not show.
    """

    name: str
    duration_s: float
    rate_Hz: float
    bandwidth_Hz: float
    speed_noise_m_s: float
    force_noise_N: float
    stretches: tuple[Stretch, ...]


def prepare_motion(recording: Recording, simulated: Mapping[str, F], gas_force_N: float = 0.0) -> RecordingMotion:
    """Return a recording's motion; `simulated` are forces [N] at its position samples. Raises RecordingError.

    `gas_force_N` is added to every force.
    """
    recording = without_spikes(recording)
    rate = sample_rate(recording)
    gap_s = longest_gap_s(rate)
    grids = _make_grids(recording, rate, gap_s)
    noise_m = noise_rms(np.concatenate([position for _, position in grids])) if grids else 0.0
    bandwidth = choose_bandwidth([position for _, position in grids], rate, noise_m)
    position = recording.channel("position")
    forced = {MEASURED: recording}
    for name, force_N in simulated.items():
        forced[name] = Recording(recording.name, {"force": Channel("force", "N", position.stamps_ns, force_N)})
    start = int(position.stamps_ns.min())
    stretches = [_make_stretch(forced, times, x, rate, bandwidth, gap_s, start, gas_force_N) for times, x in grids]
    force = recording.channels.get("force")
    return RecordingMotion(
        name=recording.name,
        duration_s=sum(len(times) for times, _ in grids) / rate,
        rate_Hz=rate,
        bandwidth_Hz=bandwidth,
        speed_noise_m_s=noise_m * noise_gain(bandwidth, rate),
        force_noise_N=noise_rms(force.values[np.isfinite(force.values)]) if force is not None else np.nan,
        stretches=tuple(stretches),
    )


def differentiate(position: F, rate_Hz: float, bandwidth_Hz: float) -> tuple[F, F]:
    """Return the smoothed position [m] and the speed [m/s] at uniform samples (n,), both without delay."""
    sos = butter(2, bandwidth_Hz, fs=rate_Hz, output="sos")
    smooth = np.asarray(sosfiltfilt(sos, position, padlen=min(len(position) - 1, round(3.0 * rate_Hz / bandwidth_Hz))))
    speed = np.gradient(smooth)
    speed[2:-2] = (8.0 * (smooth[3:-1] - smooth[1:-3]) - (smooth[4:] - smooth[:-4])) / 12.0
    return smooth, speed * rate_Hz


def noise_gain(bandwidth_Hz: float, rate_Hz: float) -> float:
    """Return the RMS speed [m/s] that white noise of 1 m in the position causes."""
    frequency = np.linspace(0.0, 0.5 * rate_Hz, 2000)
    response = 2.0 * np.pi * frequency / (1.0 + (frequency / bandwidth_Hz) ** 4)
    return float(np.sqrt(np.mean(response**2)))


def choose_bandwidth(positions: list[F], rate_Hz: float, noise_m: float) -> float:
    """Return the bandwidth [Hz] for positions sampled at `rate_Hz` with white noise of `noise_m` RMS."""
    widest = min(MotionLimits.MAX_BANDWIDTH_HZ, MotionLimits.MAX_BANDWIDTH_SHARE * rate_Hz)
    narrowest = min(MotionLimits.MIN_BANDWIDTH_HZ, widest)
    speeds = [differentiate(x, rate_Hz, narrowest)[1] for x in positions]
    rms = float(np.sqrt(np.mean(np.concatenate(speeds) ** 2))) if speeds else 0.0
    choices = [float(b) for b in np.geomspace(widest, narrowest, 24)]
    quiet = (b for b in choices if noise_m * noise_gain(b, rate_Hz) <= MotionLimits.NOISE_SHARE * rms)
    return float(f"{next(quiet, narrowest):.3g}")


def _make_grids(recording: Recording, rate: float, gap_s: float) -> list[tuple[I, F]]:
    """Return stamps [ns] and positions [m] on a uniform grid for each stretch without a gap."""
    samples = usable_samples(recording, MotionLimits.MAX_CURRENT_AGE_S)
    stamps, first = np.unique(samples.stamps_ns, return_index=True)
    position = samples.position[first]
    breaks = np.flatnonzero(np.diff(stamps) > gap_s * 1e9) + 1
    grids = []
    for a, b in pairwise([0, *breaks.tolist(), len(stamps)]):
        seconds = (stamps[a:b] - stamps[a]) * 1e-9
        if b - a > 8 and seconds[-1] >= MotionLimits.MIN_STRETCH_S:
            even = np.arange(int(seconds[-1] * rate + ROUND_S) + 1) / rate
            times = stamps[a] + np.rint(even * 1e9).astype(np.int64)
            grids.append((times, np.asarray(np.interp(even, seconds, remove_spikes(position[a:b])))))
    return grids


def _make_stretch(
    forced: Mapping[str, Recording],
    times: I,
    position: F,
    rate: float,
    bandwidth: float,
    gap_s: float,
    start_ns: int,
    gas_force_N: float,
) -> Stretch:
    recording = forced[MEASURED]
    smooth, speed = differentiate(position, rate, bandwidth)
    logged = recording.channels.get("current")
    return Stretch(
        rate_Hz=rate,
        time_s=_seconds(times, start_ns),
        position=smooth,
        speed=speed,
        current=hold_current(recording, times, MotionLimits.MAX_CURRENT_AGE_S),
        current_s=np.empty(0) if logged is None else _seconds(np.sort(logged.stamps_ns), start_ns),
        forces={source: interpolate_force(given, times, gap_s) + gas_force_N for source, given in forced.items()},
    )


def _seconds(stamps_ns: I, start_ns: int) -> F:
    return np.asarray((stamps_ns - start_ns) * 1e-9, np.float64)
