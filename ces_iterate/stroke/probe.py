"""The probe: a sum of sines that shows the actuator's frequency response, inside the limits of the rig."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_iterate.stroke.limits import StrokeLimits, measure_peaks
from ces_rig.drive.strokes import fade

Array = NDArray[np.float64]

FROM_HZ = 0.5
FADE_S = 0.5
SHARE = 0.7  # of each limit that the probe uses at most
SEED = 1


def make_probe(duration_s: float, to_Hz: float, interval_s: float, limits: StrokeLimits, like_m: Array) -> Array:
    """Return a command (n,) that starts and ends at the start of the wanted stroke `like_m` (m,).

    Every line of the spectrum up to `to_Hz` has a random phase and an amplitude that falls as 1/frequency, so that the
    speed is alike at all frequencies. It is scaled to the RMS speed of the wanted stroke, because the damper's force
    and so the actuator's answer depend on the speed, but to at most SHARE of the limits.
    """
    time = np.arange(round(duration_s / interval_s) + 1, dtype=np.float64) * interval_s
    first, last = round(FROM_HZ * duration_s), round(to_Hz * duration_s)
    lines = np.zeros(len(time) // 2 + 1, dtype=np.complex128)
    phases = np.random.default_rng(SEED).uniform(0.0, 2.0 * np.pi, last + 1 - first)
    lines[first : last + 1] = np.exp(1j * phases) / np.arange(first, last + 1)
    waves = np.resize(np.fft.irfft(lines, len(time) - 1), len(time))
    shape = (waves - waves.mean()) * fade(time, FADE_S)
    start = float(like_m[0])
    room = StrokeLimits(limits.stroke_m - abs(start), limits.speed_m_s, limits.acceleration_m_s2)
    peaks = measure_peaks(shape, interval_s)
    allowed = min(SHARE * limit / peak for limit, peak in zip(room.as_tuple(), peaks, strict=True))
    alike = float(np.std(np.diff(like_m)) / np.std(np.diff(shape)))
    return np.asarray(start + min(allowed, alike) * shape)
