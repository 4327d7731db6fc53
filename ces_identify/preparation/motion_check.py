"""Checks a measured speed or acceleration against the recorded position: wrong units and signs are found here.

The position is differentiated without delay in the frequency band of the stroke, and compared by least squares.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ces_identify.numerics.arrays import F
from ces_identify.preparation.series import select_samples
from ces_identify.recordings.recording import Recording
from ces_observer.errors import RecordingError
from ces_observer.model import Sampling

BAND_HZ = (1.0, 20.0)  # [Hz] in which sensors of both kinds are trustworthy
SCALE_RANGE = (0.7, 1.4)  # of the signal over the derivative of the position; the rest is a wrong unit
MAX_MEAN = 0.3  # of the signal over its standard deviation; more is gravity or an offset
MIN_CORRELATION = 0.5


def require_consistent_motion(recording: Recording, sampling: Sampling) -> None:
    """Raise RecordingError if the signal that the differentiator measures does not fit the recorded position."""
    if not sampling.motion_signal:
        return
    samples = select_samples(recording, sampling)
    time = (samples.stamps_ns - samples.stamps_ns[0]) * 1e-9
    rate = (len(time) - 1) / time[-1]
    even = np.linspace(0.0, time[-1], len(time))
    position, motion = (np.interp(even, time, values) for values in (samples.position, samples.motion))
    expected = np.gradient(_pass_band(position, rate)) * rate
    if sampling.motion_signal == "acceleration":
        expected = np.gradient(expected) * rate
    measured = _pass_band(motion, rate)
    _require_fit(recording.name, sampling.motion_signal, expected, measured, motion)


def _pass_band(values: F, rate: float) -> F:
    band = butter(2, (BAND_HZ[0], min(BAND_HZ[1], 0.4 * rate)), "band", fs=rate, output="sos")
    return np.asarray(sosfiltfilt(band, values - values.mean()))


def _require_fit(name: str, signal: str, expected: F, measured: F, raw: F) -> None:
    scale = float(measured @ expected / (expected @ expected))
    correlation = float(np.corrcoef(measured, expected)[0, 1])
    low, high = SCALE_RANGE
    if not abs(correlation) >= MIN_CORRELATION:
        raise RecordingError(
            f"{name}: {signal} does not follow the position (correlation {correlation:.2f} in {BAND_HZ[0]:g} to "
            f"{BAND_HZ[1]:g} Hz); check its topic, field and stamps, or identify with --differentiator kalman"
        )
    if not low <= scale <= high:
        raise RecordingError(
            f"{name}: {signal} is {scale:.2g} times what the position's derivative says; "
            f"multiply its scale in the signals file by {1.0 / scale:.2g}"
        )
    if abs(raw.mean()) > MAX_MEAN * raw.std():
        raise RecordingError(
            f"{name}: {signal} has a mean of {raw.mean():.3g}, {abs(raw.mean()) / raw.std():.1f} times its standard "
            f"deviation; add {-raw.mean():.3g} to its offset in the signals file"
        )
