"""Chooses how positions become the model's ticks: rate, the bank of the speed and its limits, without the force.

The bank (docs/speed.md) needs the noise of the position, the RMS speed and the frequencies of its modes. Noise and
speed come from the recordings' spectra, which bear jitter, gaps, late samples and spikes; the frequencies are those
with the greatest likelihood. The noise of a measured speed or acceleration is its difference from the differentiated
position, and what it holds above the stroke.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import welch

from ces_data.arrays import F
from ces_data.checks.derivatives import compare_derivative, describe_faults
from ces_data.findings import WRONG_MODEL
from ces_data.recording import Recording
from ces_data.samples import remove_spikes
from ces_identify.limits import SamplingLimits, TickLimits
from ces_identify.prepare.series import Tracked, select_samples, track, usable_samples
from ces_observer.bank_design import ACCELERATION, SPEED
from ces_observer.errors import OptionName, RecordingError
from ces_observer.limits import FileLimits
from ces_observer.model import FREQUENCIES_HZ, Sampling

WINDOW_S = 4.0  # [s] of a Welch segment
MIN_NOISE = 1e-6  # of the RMS speed in a tick: the noise of positions without any
MAX_SAMPLES = 30_000  # of a recording, for the likelihood: more change no figure of the noise
SPEEDS = POSITION, MEASURED = ("position", "measured")  # what the speed of a model comes from


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
    if len(steps) < TickLimits.MIN_SAMPLES:
        raise RecordingError(f"{recording.name}: {len(stamps)} position samples; expected at least ten in time order")
    typical = np.median(steps)
    return float(1e9 / steps[np.abs(steps - typical) < 0.5 * typical].mean())


def longest_gap_s(rate_Hz: float) -> float:
    """Return the longest time [s] between samples at a rate that is not a gap."""
    return max(TickLimits.MIN_GAP_S, TickLimits.GAP_SAMPLES / rate_Hz)


def position_spectrum(recording: Recording, max_gap_s: float) -> Spectrum:
    """Return the spectrum (Welch) of the position over all stretches without a gap, spikes removed.

    Raises RecordingError if no stretch is long enough or the position is constant.
    """
    rate = sample_rate(recording)
    samples = usable_samples(recording, 1e6)
    if np.ptp(samples.position) == 0.0:
        raise RecordingError(f"{recording.name}: position does not move; check its topic and field in the signals file")
    window = 2 ** round(np.log2(max(WINDOW_S * rate, SamplingLimits.MIN_SAMPLES)))
    power, weight = np.zeros(window // 2), 0
    breaks = np.flatnonzero(np.abs(np.diff(samples.stamps_ns)) > max_gap_s * 1e9) + 1
    for stamps, position in zip(np.split(samples.stamps_ns, breaks), np.split(samples.position, breaks), strict=True):
        in_time = np.append(True, stamps[1:] > np.maximum.accumulate(stamps)[:-1])
        if in_time.sum() < SamplingLimits.MIN_SAMPLES:
            continue
        time = (stamps[in_time] - stamps[0]) * 1e-9
        even = _resample_evenly(time, remove_spikes(position[in_time]), rate)
        density = welch(even, rate, nperseg=min(window, len(even)), nfft=window, detrend="linear")[1]
        power, weight = power + len(even) * density[1:], weight + len(even)
    if weight == 0:
        least = SamplingLimits.MIN_SAMPLES
        raise RecordingError(f"{recording.name}: no {least} position samples in a row without a gap")
    return Spectrum(rate, np.arange(1, window // 2 + 1) * rate / window, power / weight)


def _resample_evenly(time: F, position: F, rate: float) -> F:
    """Return positions at even times, one per taken or lost sample: a finer grid would attenuate the noise."""
    steps = np.maximum(np.rint(np.diff(time) * rate), 1.0)
    return np.asarray(np.interp(np.linspace(time[0], time[-1], 1 + round(steps.sum())), time, position))


def measure_motion_noise(recording: Recording, sampling: Sampling) -> float:
    """Return the RMS noise of the speed [m/s] or acceleration [m/s2] that `sampling` names; 0 if it names none.

    It is that above the stroke and the difference from the derivative of the position. Raises RecordingError if the
    signal does not fit the position.
    """
    signal = sampling.motion
    if not signal:
        return 0.0
    compared = compare_derivative(recording, signal)
    if compared is None:
        raise RecordingError(f"{recording.name}: too few samples of {signal} to compare it with the position")
    if fault := next((f for f in describe_faults(compared) if f.severity == WRONG_MODEL), None):
        raise RecordingError(f"{recording.name}: {fault.text}")
    return float(np.hypot(compared.error_rms, noise_rms(_spectrum(compared.raw, compared.rate_Hz))))


def _spectrum(values: F, rate: float) -> Spectrum:
    window = min(2 ** round(np.log2(WINDOW_S * rate)), len(values))
    frequency, power = welch(values, rate, nperseg=window, detrend="linear")
    return Spectrum(rate, frequency[1:], power[1:])


NOISES = (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625, 0.03125)  # over that just above the stroke, extrapolated as white
LIKELIHOOD_GAP_TICKS = 3.5


def choose_sampling(
    recordings: Sequence[Recording], rate_Hz: float | None = None, delay_s: float = 0.0, motion: str | None = None
) -> Sampling:
    """Return the sampling rules for models of these recordings; arguments that are not None are kept.

    Noise and modes have the greatest likelihood of the positions. The rate is the lowest position rate among the
    recordings, at most 1000 Hz or 20 times the highest mode; a gap is more than 50 ms or ten sampling intervals. A
    `motion` (default: `choose_motion`) is a second measurement. Raises RecordingError if a position has too
    few samples or is constant, if the rate is above the data's, if the delay is not a whole number of ticks up to
    20 ms, or if a measured speed or acceleration does not fit the position.
    """
    rates = [sample_rate(recording) for recording in recordings]
    _require_rate(recordings, rates, rate_Hz)
    slowest, gap = min(float(f"{r:.4g}") for r in rates), longest_gap_s(min(rates))
    spectra = [position_spectrum(recording, gap) for recording in recordings]
    speed = max(float(f"{_rms([speed_rms(s) for s in spectra]):.3g}"), SamplingLimits.MIN_SPEED_M_S)
    density = float(np.mean([noise_density(s) for s in spectra]))
    ticks, wider_Hz = SamplingLimits.TICKS_A_PERIOD, SamplingLimits.WIDER_HZ
    widest = min(slowest, ticks * wider_Hz[-1]) if rate_Hz is None else rate_Hz
    sampling = Sampling(
        widest, 1.0, speed, believed_stroke(recordings), 1.0, max_gap_s=gap,
        motion=choose_motion(recordings) if motion is None else motion,
    )  # fmt: skip
    if sampling.motion:
        noise = _rms([measure_motion_noise(recording, sampling) for recording in recordings])
        sampling = replace(sampling, motion_noise=float(f"{max(noise, 1e-9):.3g}"))
    chosen, innovation = _most_likely(recordings, sampling, density, (FREQUENCIES_HZ, wider_Hz))
    enough_Hz = max(SamplingLimits.MIN_RATE_HZ, ticks * chosen.frequencies_Hz[-1])
    rate = min(widest, enough_Hz) if rate_Hz is None else rate_Hz
    if rate != widest:
        slower = replace(sampling, rate_Hz=rate)
        chosen, innovation = _most_likely(recordings, slower, density, (chosen.frequencies_Hz,))
    outlier = max(SamplingLimits.OUTLIER_FACTOR * innovation, max(SamplingLimits.OUTLIER_S, 2.0 / rate) * speed)
    return replace(chosen, outlier_m=float(f"{outlier:.3g}"), delay_s=require_delay(delay_s, rate))


def _most_likely(
    recordings: Sequence[Recording], sampling: Sampling, density: float, modes: Sequence[tuple[float, ...]]
) -> tuple[Sampling, float]:
    """Return the sampling with the noise and modes of the greatest likelihood, and the RMS [m] of its innovations.

    `density` [m2/Hz] is that of the noise. The first modes are kept unless others are clearly likelier.
    """
    least = max(MIN_NOISE * sampling.speed_m_s / sampling.rate_Hz, 1e-9)
    white = max(np.sqrt(0.5 * density * sampling.rate_Hz), least)
    limit, candidates = SamplingLimits.HIGHEST_SHARE * sampling.rate_Hz, []
    for frequencies in modes:
        usable = tuple(f for f in frequencies if f <= limit) or (limit,)
        candidates.append(_most_likely_noise(recordings, replace(sampling, frequencies_Hz=usable), white))
    likeliest = max(candidates, key=lambda candidate: candidate[0])
    is_likelier = likeliest[0] > candidates[0][0] + SamplingLimits.MIN_LIKELIHOOD_GAIN
    _, innovation, chosen = likeliest if is_likelier else candidates[0]
    return chosen, innovation


def _most_likely_noise(
    recordings: Sequence[Recording], sampling: Sampling, white: float
) -> tuple[float, float, Sampling]:
    """Return the greatest likelihood over NOISES, the RMS [m] of the innovations there, and the sampling."""
    best = (-np.inf, 0.0, sampling)
    for share in NOISES:
        trial = replace(sampling, noise_m=float(f"{share * white:.3g}"))
        runs = [_track(recording, trial) for recording in recordings]
        innovation = max(float(np.sqrt(np.nanmean(run.innovations**2))) for run in runs)
        likelihood = float(np.mean([run.likelihood for run in runs])) - np.log(trial.noise_m)
        if likelihood < best[0]:
            break  # it has one maximum
        best = likelihood, innovation, trial
    return best


def _track(recording: Recording, sampling: Sampling) -> Tracked:
    """Return the ticks of the beginning of a recording without spikes; short gaps need fewer gains."""
    samples, n = select_samples(recording, sampling), MAX_SAMPLES
    sampling = replace(sampling, max_gap_s=min(sampling.max_gap_s, LIKELIHOOD_GAP_TICKS / sampling.rate_Hz))
    return track(samples.stamps_ns[:n], remove_spikes(samples.position)[:n], sampling, samples.motion[:n])


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def require_delay(delay_s: float, rate_Hz: float) -> float:
    """Return the delay; raises RecordingError unless it is a whole number of ticks up to FileLimits.MAX_DELAY_S."""
    ticks = delay_s * rate_Hz
    if not (0.0 <= delay_s <= FileLimits.MAX_DELAY_S and abs(ticks - round(ticks)) <= SamplingLimits.DELAY_SLACK):
        near = round(ticks) if np.isfinite(ticks) else 1
        raise RecordingError(
            OptionName("delay", delay_s),
            f": expected whole ticks of {1.0 / rate_Hz:g} s (the model's rate is {rate_Hz:g} Hz) from 0 to "
            f"{FileLimits.MAX_DELAY_S:g} s, such as {min(max(near, 1) / rate_Hz, FileLimits.MAX_DELAY_S):g}",
        )
    return round(ticks) / rate_Hz


def delay_text(delay_s: float) -> str:
    """Return how long after its sample a force is known, in words."""
    return f"{1e3 * delay_s:g} ms later" if delay_s else "at once"


def believed_stroke(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return the range [m] in which positions are believed: the recorded stroke, without spikes, and a margin."""
    strokes = [remove_spikes(usable_samples(recording, 1e6).position) for recording in recordings]
    low, high = min(float(x.min()) for x in strokes), max(float(x.max()) for x in strokes)
    margin = max(high - low, SamplingLimits.STROKE_MARGIN_M)
    return float(f"{low - margin:.4g}"), float(f"{high + margin:.4g}")


def _require_rate(recordings: Sequence[Recording], rates: Sequence[float], rate_Hz: float | None) -> None:
    """Raise RecordingError for a rate above that of the slowest positions."""
    slowest, name = min(zip(rates, (recording.name for recording in recordings), strict=True), key=lambda pair: pair[0])
    if rate_Hz is not None and rate_Hz > SamplingLimits.RATE_SLACK * slowest:
        data = f"the positions in {name} are at {slowest:.5g} Hz"
        advice = "; choose at most that, or leave the rate out"
        raise RecordingError(OptionName("rate", rate_Hz), f": {data}{advice}")


def choose_motion(recordings: Sequence[Recording], speed: str | None = None) -> str:
    """Return the signal beside the position that a model uses, empty if none; raises RecordingError.

    It is none for POSITION, the speed for MEASURED. By default it is the one that all recordings have and none as
    optional; the speed if they have both.
    """
    if speed == MEASURED and (lacks := next((r.name for r in recordings if SPEED not in r.channels), "")):
        remedy = "describe 'speed' in the signals file, or remove "
        raise RecordingError(f"{lacks}: no measured speed; {remedy}", OptionName("speed"))
    names = [r.channels.keys() - r.optional for r in recordings] if speed is None else []
    signal = next((name for name in (SPEED, ACCELERATION) if all(name in own for own in names)), "")
    return signal if speed is None else SPEED if speed == MEASURED else ""


def describe_motion(recordings: Sequence[Recording], motion: str) -> str:
    """Return a line on a measured speed or acceleration: whether a model uses it, and how it fits; '' without any."""
    if motion:
        compared = next(filter(None, (compare_derivative(recording, motion) for recording in recordings)), None)
        return f"{compared or motion}; the model uses it, and the observer needs '{motion}' in its signals file"
    if any(SPEED in recording.channels for recording in recordings):
        return "speed: measured, and not used: the model differentiates the position (--speed measured uses it)"
    return ""


def noise_rms(spectrum: Spectrum) -> float:
    """Return the RMS noise of the samples: the noise is as strong as between 100 Hz and the limit."""
    _, noise = split_spectrum(spectrum)
    return float(np.sqrt(noise.sum() * spectrum.frequency[0]))


def noise_density(spectrum: Spectrum) -> float:
    """Return the density [m2/Hz] of the noise just above the stroke."""
    return float(split_spectrum(spectrum)[1].max(initial=0.0, where=spectrum.frequency < _knee(spectrum)))


def _knee(spectrum: Spectrum) -> float:
    return min(SamplingLimits.NOISE_FROM_HZ, SamplingLimits.NOISE_FROM_SHARE * spectrum.rate_Hz)


def speed_rms(spectrum: Spectrum) -> float:
    """Return the RMS speed [m/s] of the stroke."""
    stroke, _ = split_spectrum(spectrum)
    return float(np.sqrt(((2.0 * np.pi * spectrum.frequency) ** 2 * stroke).sum() * spectrum.frequency[0]))


def split_spectrum(spectrum: Spectrum) -> tuple[F, F]:
    """Return the densities of stroke and noise; below NOISE_FROM_HZ the noise has its level just above."""
    knee = _knee(spectrum)
    below = spectrum.frequency < knee
    level = np.median(spectrum.power[~below & (spectrum.frequency < 2.0 * knee)])
    noise = np.where(below, np.minimum(level, spectrum.power), spectrum.power)
    return spectrum.power - noise, noise
