"""A speed or acceleration measured beside the position, against the differentiated position: unit, sign, lag, noise.

Both are compared in the frequency band of the stroke. A signal that is late by a fraction of a period looks like one
with noise, so its lag is found first, by the largest correlation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ces_data.arrays import F
from ces_data.findings import WARNING, WRONG_MODEL, DelayFinding, Finding
from ces_data.limits import DerivativeLimits, StatisticLimits
from ces_data.recording import Recording
from ces_data.samples import remove_spikes
from ces_observer.signals import MOTIONS, UNITS

BAND_HZ = (1.0, 20.0)  # [Hz] in which sensors of both kinds are trustworthy
MAX_S = 60.0  # of the stretch that is compared
REACH_S, RESOLUTION_S = 0.02, 5e-5  # of the lag; half a period of 20 Hz is 25 ms, and a turned sign looks like it


@dataclass(frozen=True)
class DerivativeComparison:
    """A signal over the derivative of the position: `scale` and `correlation` once `late_s` is taken out.

    `raw` (n,) are the values at `rate_Hz`, `error_rms` that of their difference from the derivative as logged.
    """

    signal: str
    scale: float
    correlation: float
    late_s: float
    error_rms: float
    raw: F
    rate_Hz: float

    def __str__(self) -> str:
        side = "after" if self.late_s > 0.0 else "before"
        lag = f"{1e3 * abs(self.late_s):.1f} ms {side}" if abs(self.late_s) >= RESOLUTION_S else "in time with"
        return f"{self.signal}: {self.scale:.3g} times the differentiated position, and {lag} it"


def compare_derivative(recording: Recording, signal: str) -> DerivativeComparison | None:
    """Return the comparison of "speed" or "acceleration" with the position; None if there is too little of one."""
    channels = [recording.channels[name].in_order() for name in ("position", signal) if name in recording.channels]
    if len(channels) < 2 or min(map(len, channels)) < StatisticLimits.MANY:
        return None
    position, measured = channels
    begin = max(int(c.stamps_ns[0]) for c in channels)
    end = min(*(int(c.stamps_ns[-1]) for c in channels), begin + round(MAX_S * 1e9))
    count = int(np.ptp(np.searchsorted(position.stamps_ns, (begin, end))))
    if end <= begin or count < StatisticLimits.MANY:
        return None
    rate = count * 1e9 / (end - begin)
    even = begin + np.arange(count) * (1e9 / rate)
    place = np.interp(even, position.stamps_ns, remove_spikes(position.values))
    raw = np.interp(even, measured.stamps_ns, measured.values)
    expected, likened = _pass_band(place, rate), _pass_band(raw, rate)
    for _ in range(1 + MOTIONS.index(signal)):  # both averaged over the same two intervals (Simpson's rule)
        expected = np.gradient(expected) * rate
        likened = np.convolve(np.pad(likened, 1, "edge"), [1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0], "valid")
    power, own = float(expected @ expected), float(likened @ likened)
    if power == 0.0 or own == 0.0:
        return None
    late_s, product = _find_lag(expected, likened, rate)
    error = float(np.std(likened - expected))
    return DerivativeComparison(signal, product / power, product / np.sqrt(power * own), late_s, error, raw, rate)


def _find_lag(expected: F, measured: F, rate: float) -> tuple[float, float]:
    """Return by how much `measured` is late [s], and the product of both without that, of the largest size."""
    finer, size = int(np.ceil(1.0 / (RESOLUTION_S * rate))), 2 * len(expected)
    spectrum = np.fft.rfft(measured, size) * np.conj(np.fft.rfft(expected, size))
    products = finer * np.fft.irfft(spectrum, size * finer)
    reach = min(round(REACH_S * rate * finer), len(products) // 2 - 1)
    near = np.concatenate([products[-reach:], products[: reach + 1]])
    at = int(np.argmax(np.abs(near)))
    return (at - reach) / (rate * finer), float(near[at])


def _pass_band(values: F, rate: float) -> F:
    band = butter(2, (BAND_HZ[0], min(BAND_HZ[1], 0.4 * rate)), "band", fs=rate, output="sos")
    return np.asarray(sosfiltfilt(band, values - values.mean()))


def derivative_findings(recording: Recording) -> Iterator[Finding]:
    """Yield what is wrong with a measured speed and acceleration; of an optional one it makes no model wrong."""
    for signal in MOTIONS:
        compared = compare_derivative(recording, signal)
        if compared is not None:
            yield from describe_faults(compared, WARNING if signal in recording.optional else WRONG_MODEL)


def describe_faults(compared: DerivativeComparison, severity: str = WRONG_MODEL) -> Iterator[Finding]:
    """Yield the fault of a signal that contradicts the position, with its remedy, or its lag."""
    signal, scale, raw = compared.signal, compared.scale, compared.raw
    where = "in the signals file"
    if not abs(compared.correlation) >= DerivativeLimits.MIN_CORRELATION:
        text = f"does not follow the position (correlation {compared.correlation:.2f} in {BAND_HZ[0]:g} to "
        text += f"{BAND_HZ[1]:g} Hz); check its topic, field and stamps, or drop it from the signals file"
    elif not DerivativeLimits.SCALE_RANGE[0] <= scale <= DerivativeLimits.SCALE_RANGE[1]:
        text = (
            f"is {scale:.2g} times what the position's derivative says; multiply its scale {where} by {1 / scale:.2g}"
        )
    elif abs(raw.mean()) > DerivativeLimits.MAX_MEAN * raw.std():
        text = f"has a mean of {raw.mean():.3g} {UNITS[signal]}, {abs(raw.mean()) / raw.std():.1f} times its standard "
        text += f"deviation; add {-raw.mean():.3g} to its offset {where}"
    elif abs(compared.late_s) >= DerivativeLimits.LATE_S:
        side = "after" if compared.late_s > 0.0 else "before"
        text = f"logged {1e3 * abs(compared.late_s):.1f} ms {side} the differentiated position; add "
        text += f"{compared.late_s:.4f} to the key delay (default 0) of {signal} {where}"
        yield DelayFinding(WARNING, f"{signal}: {text}", signal)
        return
    else:
        return
    yield Finding(severity, f"{signal}: {text}", signal)
