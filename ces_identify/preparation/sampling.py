"""The choice of rate, differentiator and outlier threshold from the position samples alone; no force is looked at.

The differentiator (docs/differentiator.md) has two numbers, an order and a bandwidth. They are those for which the
predicted error of the speed, distortion of the stroke plus noise let through, is least on the recordings' spectra.
A recording holds only the strokes it happened to be made with, and a model runs on others, so the prediction grants
each recording a little wide-band speed that it does not hold.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ces_identify.preparation.position_spectrum import Spectrum, position_spectrum, sample_rate
from ces_identify.recordings.recording import Recording
from ces_observer.model import Sampling

F = NDArray[np.float64]

HIGHEST_RATE = 1000.0  # [Hz] damping forces have no content that calls for more, but for
TICKS_A_BANDWIDTH = 8.0  # that a differentiator this much slower than the ticks keeps its shape on them
OUTLIER_FACTOR = 25.0  # times the standard deviation of the differentiator's innovations
WIDEST = {2: 1.0 / 3.0, 3: 0.15}  # of the sampling rate, by order; docs/differentiator.md: stable under any jitter
NOISE_FROM_HZ = 100.0  # [Hz] where no stroke of a damper is left; a quarter of the sampling rate if that is lower
UNSEEN_SHARE = 0.02  # of a recording's speed power, granted as speed it does not hold
UNSEEN_HZ = 40.0  # [Hz] to which that speed reaches


def choose_sampling(
    recordings: Sequence[Recording],
    rate_Hz: float | None = None,
    bandwidth_Hz: float | None = None,
    max_gap_s: float | None = None,
    warm_up_s: float = 0.5,
    order: int | None = None,
) -> Sampling:
    """Return the sampling rules for models of these recordings; numbers given are kept.

    The rate is the lowest position rate among the recordings, at most 1000 Hz or 8 times the differentiator's
    bandwidth; a gap is more than 50 ms or ten sampling intervals. With a bandwidth given and no order, the order is 3.
    Raises RecordingError if a position has too few samples or does not move.
    """
    rates = [sample_rate(recording) for recording in recordings]
    gap = max(0.05, 10.0 / min(rates)) if max_gap_s is None else max_gap_s
    spectra = [position_spectrum(recording, gap) for recording in recordings]
    if bandwidth_Hz is None:
        bandwidth_Hz, order = best_differentiator(spectra, tuple(WIDEST) if order is None else (order,))
    order = 3 if order is None else order
    highest = max(HIGHEST_RATE, TICKS_A_BANDWIDTH * bandwidth_Hz)
    rate = min([highest, *(float(f"{r:.4g}") for r in rates)]) if rate_Hz is None else rate_Hz
    outlier = max(outlier_distance(s, bandwidth_Hz, order) for s in spectra)
    return Sampling(rate, round(bandwidth_Hz, 2), float(f"{outlier:.3g}"), gap, warm_up_s=warm_up_s, order=order)


def best_differentiator(spectra: Sequence[Spectrum], orders: Sequence[int] = tuple(WIDEST)) -> tuple[float, int]:
    """Return the bandwidth [Hz] and order of least predicted speed error, in the mean square over the recordings."""
    rate = min(s.rate_Hz for s in spectra)
    choices = [(float(b), order) for order in orders for b in np.geomspace(rate / 200.0, rate * WIDEST[order], 60)]
    errors = [np.mean([speed_error(s, b, order) ** 2 for s in spectra]) for b, order in choices]
    return choices[int(np.argmin(errors))]


def speed_error(spectrum: Spectrum, bandwidth: float, order: int) -> float:
    """Return the predicted RMS error of the speed as a share of the RMS speed."""
    stroke, noise = split_spectrum(spectrum)
    omega = 2.0 * np.pi * spectrum.frequency
    speed = omega**2 * stroke
    shape = (stroke > 0.0) / (1.0 + (spectrum.frequency / UNSEEN_HZ) ** 4)
    speed_and_unseen = speed + UNSEEN_SHARE * speed.sum() * shape / shape.sum()
    response, _ = responses(spectrum, bandwidth, order)
    error = abs(1.0 - response / (1j * omega)) ** 2 * speed_and_unseen + abs(response) ** 2 * noise
    return float(np.sqrt(error.sum() / speed.sum()))


def outlier_distance(spectrum: Spectrum, bandwidth: float, order: int) -> float:
    """Return how far [m] from its prediction a position is an outlier.

    No less than what the RMS speed leaves to catch up with after a restart, so that a restart in motion succeeds.
    """
    stroke, _ = split_spectrum(spectrum)
    speed = np.sqrt(((2.0 * np.pi * spectrum.frequency) ** 2 * stroke).sum() * spectrum.frequency[0])
    return max(OUTLIER_FACTOR * innovation_rms(spectrum, bandwidth, order), float(speed) / (2.0 * np.pi * bandwidth))


def innovation_rms(spectrum: Spectrum, bandwidth: float, order: int) -> float:
    """Return the RMS [m] of the differentiator's one-step prediction errors."""
    _, innovation = responses(spectrum, bandwidth, order)
    return float(np.sqrt((abs(innovation) ** 2 * spectrum.power).sum() * spectrum.frequency[0]))


def split_spectrum(spectrum: Spectrum) -> tuple[F, F]:
    """Return the densities of the stroke and of the noise, whose level below NOISE_FROM_HZ is that just above it."""
    knee = min(NOISE_FROM_HZ, 0.25 * spectrum.rate_Hz)
    below = spectrum.frequency < knee
    level = np.median(spectrum.power[~below & (spectrum.frequency < 2.0 * knee)])
    noise = np.where(below, np.minimum(level, spectrum.power), spectrum.power)
    return spectrum.power - noise, noise


def responses(
    spectrum: Spectrum, bandwidth: float, order: int
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the differentiator's frequency responses (n,) from position to speed [1/s] and to innovation [1]."""
    gains = _gains(bandwidth / spectrum.rate_Hz, order)
    z = np.exp(2j * np.pi * spectrum.frequency / spectrum.rate_Hz)
    d = z - 1.0
    innovation = 1.0 / (1.0 + gains[0] / d + gains[1] * z / d**2 + gains[2] * z * (z + 1.0) / d**3)
    speed = (gains[1] * z / d + 2.0 * gains[2] * z / d**2) * innovation * spectrum.rate_Hz
    return np.asarray(speed, np.complex128), np.asarray(innovation, np.complex128)


def _gains(cycles: float, order: int) -> tuple[float, float, float]:
    """Gains of position, speed and half acceleration at `cycles` of the bandwidth to a sampling interval."""
    damping = 0.5 if order == 3 else np.sqrt(0.5)
    pole = np.exp(2.0 * np.pi * cycles * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    real = np.exp(-2.0 * np.pi * cycles) if order == 3 else 0.0
    product_, at_one = abs(pole) ** 2 * (real if order == 3 else 1.0), abs(1.0 - pole) ** 2
    if order == 2:
        return 1.0 - product_, at_one, 0.0
    third = 0.5 * (1.0 - real) * at_one
    return 1.0 - product_, 2.0 + product_ - 2.0 * pole.real - real - third, third
