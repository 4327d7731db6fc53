"""The power spectral density of a recorded position, from which the differentiator is chosen.

The position samples may have jitter, gaps, late samples and spikes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from ces_identify.numerics.arrays import F, I
from ces_identify.preparation.series import usable_samples
from ces_identify.recordings.recording import Recording
from ces_observer.errors import RecordingError

WINDOW_S = 4.0  # [s] of a Welch segment
MIN_SAMPLES = 64  # of a stretch that enters the spectrum
SPIKE_FACTOR = 5.0  # times the robust standard deviation of a sample's distance from its neighbours' parabola
SPIKE_PASSES = 5  # for spikes so close together that they hide each other


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density `power` (n,) [m2/Hz] of a position sampled at `rate_Hz`, over `frequency`."""

    rate_Hz: float
    frequency: F
    power: F


def sample_rate(recording: Recording) -> float:
    """Return the mean rate of the position samples [Hz], without lost samples and repeated stamps."""
    stamps = recording.channel("position").stamps_ns
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    if len(steps) < 10:
        raise RecordingError(f"{recording.name}: {len(stamps)} position samples; expected at least ten in time order")
    typical = np.median(steps)
    return float(1e9 / steps[np.abs(steps - typical) < 0.5 * typical].mean())


def position_spectrum(recording: Recording, max_gap_s: float) -> Spectrum:
    """Return the spectrum (Welch) of the position over all stretches without a gap, spikes removed.

    Raises RecordingError if no stretch is long enough or the position is constant.
    """
    rate = sample_rate(recording)
    samples = usable_samples(recording, 1e6)
    if np.ptp(samples.position) == 0.0:
        raise RecordingError(f"{recording.name}: position does not move; check its topic and field in the signals file")
    window = 2 ** round(np.log2(max(WINDOW_S * rate, MIN_SAMPLES)))
    power, weight = np.zeros(window // 2), 0
    for time, position in _stretches(samples.stamps_ns, samples.position, max_gap_s):
        if len(time) < MIN_SAMPLES:
            continue
        even = _resample_evenly(time, remove_spikes(position), rate)
        density = welch(even, rate, nperseg=min(window, len(even)), nfft=window, detrend="linear")[1]
        power, weight = power + len(even) * density[1:], weight + len(even)
    if weight == 0:
        raise RecordingError(f"{recording.name}: no {MIN_SAMPLES} position samples in a row without a gap")
    return Spectrum(rate, np.arange(1, window // 2 + 1) * rate / window, power / weight)


def _stretches(stamps_ns: I, position: F, max_gap_s: float) -> list[tuple[F, F]]:
    """Return times [s] and positions of the stretches without a gap, without late samples."""
    breaks = np.flatnonzero(np.abs(np.diff(stamps_ns)) > max_gap_s * 1e9) + 1
    stretches = []
    for stamps, values in zip(np.split(stamps_ns, breaks), np.split(position, breaks), strict=True):
        late = np.zeros(len(stamps), bool)
        late[1:] = stamps[1:] <= np.maximum.accumulate(stamps)[:-1]
        stretches.append(((stamps[~late] - stamps[0]) * 1e-9, values[~late]))
    return stretches


def _resample_evenly(time: F, position: F, rate: float) -> F:
    """Return positions at even times, one per taken or lost sample: a finer grid would attenuate the noise."""
    steps = np.maximum(np.rint(np.diff(time) * rate), 1.0)
    return np.asarray(np.interp(np.linspace(time[0], time[-1], 1 + round(steps.sum())), time, position))


def remove_spikes(position: F) -> F:
    """Return `position` with spikes of up to three samples replaced by interpolation.

    A spike is far from the parabola through the three samples before it and from that through the three after.
    """
    low, high = np.percentile(position, (1.0, 99.0))
    places, good, clean = np.arange(len(position)), np.ones(len(position), bool), position
    for _ in range(SPIKE_PASSES):
        distance = _parabola_distance(clean)
        spikes = distance > max(SPIKE_FACTOR * 1.4826 * float(np.median(distance)), 0.002 * (high - low))
        if not spikes.any():
            break
        good &= ~spikes
        clean = np.asarray(np.interp(places, places[good], position[good]))
    return clean


def _parabola_distance(x: F) -> F:
    """Return distances (n,) to the nearer of the parabolas through the three samples before and the three after."""
    before, after = np.full(len(x), np.inf), np.full(len(x), np.inf)
    before[3:] = abs(x[3:] - (3.0 * x[2:-1] - 3.0 * x[1:-2] + x[:-3]))
    after[:-3] = abs(x[:-3] - (3.0 * x[1:-2] - 3.0 * x[2:-1] + x[3:]))
    return np.asarray(np.minimum(before, after))
