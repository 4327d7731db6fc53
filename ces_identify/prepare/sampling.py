"""Chooses rate, differentiator and outlier threshold from the position samples, without the force.

The differentiator (docs/speed.md) has an order and a bandwidth. They minimise the predicted error of the
speed, distortion of the stroke plus transmitted noise, on the recordings' spectra. As a model also runs on other
strokes, the prediction adds a little wide-band speed to each recording.

The spectra bear jitter, gaps, late samples and spikes. A measured speed or acceleration is checked against the
position, differentiated without delay in the frequency band of the stroke: wrong units and signs are found here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt, welch

from ces_data.arrays import F
from ces_data.recording import Recording
from ces_data.samples import remove_spikes
from ces_identify.prepare.series import select_samples, usable_samples
from ces_observer.adaptive_differentiator import SHARES
from ces_observer.errors import RecordingError
from ces_observer.model import ADAPTIVE, DIFFERENTIATORS, FUSED, KALMAN, MEASURED, Sampling

WINDOW_S = 4.0  # [s] of a Welch segment
MIN_SAMPLES = 64  # of a stretch that enters the spectrum


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
    breaks = np.flatnonzero(np.abs(np.diff(samples.stamps_ns)) > max_gap_s * 1e9) + 1
    for stamps, position in zip(np.split(samples.stamps_ns, breaks), np.split(samples.position, breaks), strict=True):
        in_time = np.append(True, stamps[1:] > np.maximum.accumulate(stamps)[:-1])
        if in_time.sum() < MIN_SAMPLES:
            continue
        time = (stamps[in_time] - stamps[0]) * 1e-9
        even = _resample_evenly(time, remove_spikes(position[in_time]), rate)
        density = welch(even, rate, nperseg=min(window, len(even)), nfft=window, detrend="linear")[1]
        power, weight = power + len(even) * density[1:], weight + len(even)
    if weight == 0:
        raise RecordingError(f"{recording.name}: no {MIN_SAMPLES} position samples in a row without a gap")
    return Spectrum(rate, np.arange(1, window // 2 + 1) * rate / window, power / weight)


def _resample_evenly(time: F, position: F, rate: float) -> F:
    """Return positions at even times, one per taken or lost sample: a finer grid would attenuate the noise."""
    steps = np.maximum(np.rint(np.diff(time) * rate), 1.0)
    return np.asarray(np.interp(np.linspace(time[0], time[-1], 1 + round(steps.sum())), time, position))


BAND_HZ = (1.0, 20.0)  # [Hz] in which sensors of both kinds are trustworthy
SCALE_RANGE = (0.7, 1.4)  # of the signal over the derivative of the position; the rest is a wrong unit
MAX_MEAN = 0.3  # of the signal over its standard deviation; more is gravity or an offset
MIN_CORRELATION = 0.5


def require_consistent_motion(recording: Recording, sampling: Sampling) -> None:
    """Raise RecordingError if the signal that the differentiator measures does not fit the recorded position."""
    signal = sampling.motion_signal
    if not signal:
        return
    samples = select_samples(recording, sampling)
    time = (samples.stamps_ns - samples.stamps_ns[0]) * 1e-9
    rate = (len(time) - 1) / time[-1]
    even = np.linspace(0.0, time[-1], len(time))
    position, raw = (np.interp(even, time, values) for values in (samples.position, samples.motion))
    expected = np.gradient(_pass_band(position, rate)) * rate
    if signal == "acceleration":
        expected = np.gradient(expected) * rate
    measured = _pass_band(raw, rate)
    scale = float(measured @ expected / (expected @ expected))
    correlation = float(np.corrcoef(measured, expected)[0, 1])
    if not abs(correlation) >= MIN_CORRELATION:
        raise RecordingError(
            f"{recording.name}: {signal} does not follow the position (correlation {correlation:.2f} in "
            f"{BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz); check its topic, field and stamps, or identify with "
            "--differentiator kalman"
        )
    if not SCALE_RANGE[0] <= scale <= SCALE_RANGE[1]:
        raise RecordingError(
            f"{recording.name}: {signal} is {scale:.2g} times what the position's derivative says; "
            f"multiply its scale in the signals file by {1.0 / scale:.2g}"
        )
    if abs(raw.mean()) > MAX_MEAN * raw.std():
        raise RecordingError(
            f"{recording.name}: {signal} has a mean of {raw.mean():.3g}, {abs(raw.mean()) / raw.std():.1f} times its "
            f"standard deviation; add {-raw.mean():.3g} to its offset in the signals file"
        )


def _pass_band(values: F, rate: float) -> F:
    band = butter(2, (BAND_HZ[0], min(BAND_HZ[1], 0.4 * rate)), "band", fs=rate, output="sos")
    return np.asarray(sosfiltfilt(band, values - values.mean()))


C = NDArray[np.complex128]

RATE_SLACK = 1.01  # a nominal rate is a little above that of the stamps
HIGHEST_RATE = 1000.0  # [Hz] enough for damping forces, except that
TICKS_A_BANDWIDTH = 8.0  # a differentiator needs so many ticks per period of its bandwidth
OUTLIER_FACTOR = 25.0  # times the standard deviation of the differentiator's innovations
WIDEST = {2: 1.0 / 3.0, 3: 0.15}  # of the sampling rate, by order; docs/speed.md: stable under any jitter
NOISE_FROM_HZ = 100.0  # [Hz] the stroke has no content above this, or a quarter of the sampling rate if lower
EXTRA_SHARE = 0.02  # power of the added wide-band speed, relative to the recording's speed
EXTRA_HZ = 40.0  # [Hz] corner frequency of the added speed
FUSED_HZ = 3.0  # [Hz] with an accelerometer: below, the position determines the speed; above, the acceleration does


def choose_sampling(
    recordings: Sequence[Recording],
    rate_Hz: float | None = None,
    bandwidth_Hz: float | None = None,
    differentiator: str | None = None,
) -> Sampling:
    """Return the sampling rules for models of these recordings; arguments that are not None are kept.

    The rate is the lowest position rate among the recordings, at most 1000 Hz or 8 times the differentiator's
    bandwidth; a gap is more than 50 ms or ten sampling intervals. With a bandwidth, the order is 3. Without one of
    DIFFERENTIATORS, the differentiator is the one that `default_differentiator` returns. Raises RecordingError if a
    position has too few samples or is constant, if the rate is above the data's or the bandwidth above half the rate,
    or if a recording lacks the signal that the differentiator needs.
    """
    kind = differentiator if differentiator in DIFFERENTIATORS else default_differentiator(recordings)
    rates = [sample_rate(recording) for recording in recordings]
    _require_within_rate(recordings, rates, rate_Hz, bandwidth_Hz)
    gap = max(0.05, 10.0 / min(rates))
    spectra = [position_spectrum(recording, gap) for recording in recordings]
    bandwidth, order = bandwidth_Hz, 3
    if bandwidth is None or kind == FUSED:
        bandwidth, order = best_differentiator(spectra)
    highest = max(HIGHEST_RATE, TICKS_A_BANDWIDTH * bandwidth)
    rate = min([highest, *(float(f"{r:.4g}") for r in rates)]) if rate_Hz is None else rate_Hz
    if kind == ADAPTIVE:
        bandwidth = min(bandwidth, min(rates) * WIDEST[order] / max(SHARES))
    elif kind == FUSED:
        bandwidth, order = bandwidth_Hz or FUSED_HZ, 3
    outlier = max(outlier_distance(s, bandwidth, order) for s in spectra)
    sampling = Sampling(
        rate,
        round(bandwidth, 2),
        float(f"{outlier:.3g}"),
        gap,
        order=order,
        differentiator=kind,
        noise_m=float(f"{max(map(noise_rms, spectra)):.3g}") if kind == ADAPTIVE else 0.0,
    )
    for recording in recordings:
        require_consistent_motion(recording, sampling)
    return sampling


def _require_within_rate(
    recordings: Sequence[Recording], rates: Sequence[float], rate_Hz: float | None, bandwidth_Hz: float | None
) -> None:
    """Raise RecordingError for a rate above that of the slowest positions, or a bandwidth above half the rate."""
    slowest, name = min(zip(rates, (recording.name for recording in recordings), strict=True), key=lambda one: one[0])
    data = f"the positions in {name} are at {slowest:.5g} Hz"
    if rate_Hz is not None and rate_Hz > RATE_SLACK * slowest:
        raise RecordingError(f"--rate {rate_Hz:g}: {data}; choose at most that, or leave --rate out")
    rate = slowest if rate_Hz is None else rate_Hz
    if bandwidth_Hz is not None and bandwidth_Hz > RATE_SLACK * rate / 2.0:
        limit = f"above half the model's rate of {rate:.5g} Hz ({data})"
        raise RecordingError(f"--bandwidth {bandwidth_Hz:g}: {limit}; choose less, or leave --bandwidth out")


def default_differentiator(recordings: Sequence[Recording]) -> str:
    """Return the differentiator for these recordings: a signal that all of them have is used.

    A measured speed needs no differentiator; a measured acceleration supports it.
    """
    for kind in (MEASURED, FUSED):
        if all(DIFFERENTIATORS[kind] in recording.channels for recording in recordings):
            return kind
    return KALMAN


def noise_rms(spectrum: Spectrum) -> float:
    """Return the RMS noise [m] of the position samples: the noise is as strong as between 100 Hz and the limit."""
    _, noise = split_spectrum(spectrum)
    return float(np.sqrt(noise.sum() * spectrum.frequency[0]))


def best_differentiator(spectra: Sequence[Spectrum], orders: Sequence[int] = tuple(WIDEST)) -> tuple[float, int]:
    """Return the bandwidth [Hz] and order with the least mean square of the recordings' predicted speed errors."""
    rate = min(s.rate_Hz for s in spectra)
    choices = [(float(b), order) for order in orders for b in np.geomspace(rate / 200.0, rate * WIDEST[order], 60)]
    errors = [np.mean([speed_error(s, b, order) ** 2 for s in spectra]) for b, order in choices]
    return choices[int(np.argmin(errors))]


def speed_error(spectrum: Spectrum, bandwidth: float, order: int) -> float:
    """Return the predicted RMS error of the speed, relative to the RMS speed."""
    stroke, noise = split_spectrum(spectrum)
    omega = 2.0 * np.pi * spectrum.frequency
    speed = omega**2 * stroke
    shape = (stroke > 0.0) / (1.0 + (spectrum.frequency / EXTRA_HZ) ** 4)
    with_extra = speed + EXTRA_SHARE * speed.sum() * shape / shape.sum()
    response, _ = responses(spectrum, bandwidth, order)
    error = abs(1.0 - response / (1j * omega)) ** 2 * with_extra + abs(response) ** 2 * noise
    return float(np.sqrt(error.sum() / speed.sum()))


def outlier_distance(spectrum: Spectrum, bandwidth: float, order: int) -> float:
    """Return the distance [m] from the prediction beyond which a position is an outlier.

    It covers the error of the RMS speed after a restart, so that a restart in motion succeeds.
    """
    stroke, _ = split_spectrum(spectrum)
    speed = np.sqrt(((2.0 * np.pi * spectrum.frequency) ** 2 * stroke).sum() * spectrum.frequency[0])
    return max(OUTLIER_FACTOR * innovation_rms(spectrum, bandwidth, order), float(speed) / (2.0 * np.pi * bandwidth))


def innovation_rms(spectrum: Spectrum, bandwidth: float, order: int) -> float:
    """Return the RMS [m] of the differentiator's one-step prediction errors."""
    _, innovation = responses(spectrum, bandwidth, order)
    return float(np.sqrt((abs(innovation) ** 2 * spectrum.power).sum() * spectrum.frequency[0]))


def split_spectrum(spectrum: Spectrum) -> tuple[F, F]:
    """Return the densities of stroke and noise; below NOISE_FROM_HZ the noise has its level just above."""
    knee = min(NOISE_FROM_HZ, 0.25 * spectrum.rate_Hz)
    below = spectrum.frequency < knee
    level = np.median(spectrum.power[~below & (spectrum.frequency < 2.0 * knee)])
    noise = np.where(below, np.minimum(level, spectrum.power), spectrum.power)
    return spectrum.power - noise, noise


def responses(spectrum: Spectrum, bandwidth: float, order: int) -> tuple[C, C]:
    """Return the differentiator's frequency responses (n,) from position to speed [1/s] and to innovation [1]."""
    gains = _gains(bandwidth / spectrum.rate_Hz, order)
    z: C = np.asarray(np.exp(2j * np.pi * spectrum.frequency / spectrum.rate_Hz), np.complex128)
    d = z - 1.0
    innovation = 1.0 / (1.0 + gains[0] / d + gains[1] * z / d**2 + gains[2] * z * (z + 1.0) / d**3)
    speed = (gains[1] * z / d + 2.0 * gains[2] * z / d**2) * innovation * spectrum.rate_Hz
    return speed, innovation


def _gains(cycles: float, order: int) -> tuple[float, float, float]:
    """Return the gains of position, speed and half acceleration; `cycles` is bandwidth over sampling rate."""
    damping = 0.5 if order == 3 else np.sqrt(0.5)
    pole = np.exp(2.0 * np.pi * cycles * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    real = np.exp(-2.0 * np.pi * cycles) if order == 3 else 0.0
    product, at_one = abs(pole) ** 2 * (real if order == 3 else 1.0), abs(1.0 - pole) ** 2
    if order == 2:
        return 1.0 - product, at_one, 0.0
    third = 0.5 * (1.0 - real) * at_one
    return 1.0 - product, 2.0 + product - 2.0 * pole.real - real - third, third
