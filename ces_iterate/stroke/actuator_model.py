"""A model of an actuator: gain, dead time and a loop of third order, fitted to a measured frequency response."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ces_rig.descriptions import quantity

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

START_DELAYS_S = (0.0, 0.002, 0.005, 0.01, 0.02, 0.05)
START_BANDWIDTHS_HZ = (5.0, 15.0, 40.0, 100.0)
LOWER, UPPER = (0.1, 0.0, 0.5, 0.15, 0.0), (10.0, 0.2, 500.0, 5.0, 0.05)
SCALES = (1.0, 0.005, 30.0, 0.7, 0.002)


@dataclass(frozen=True)
class ActuatorModel:
    """K e^(-s delay) / ((1 + valve s) (1 + 2 damping s/w + s²/w²)), w = 2 pi bandwidth: position over command."""

    gain: float = quantity(1.0, "1", "position over command at rest", LOWER[0], UPPER[0])
    delay_s: float = quantity(0.0, "s", "dead time", LOWER[1], UPPER[1])
    bandwidth_Hz: float = quantity(30.0, "Hz", "natural frequency", LOWER[2], UPPER[2])
    damping: float = quantity(0.7, "1", "damping ratio", LOWER[3], UPPER[3])
    valve_s: float = quantity(0.0, "s", "further time constant", LOWER[4], UPPER[4])

    def response(self, frequency_Hz: Array) -> ComplexArray:
        """Return the frequency response at the frequencies (n,)."""
        ratio = frequency_Hz / self.bandwidth_Hz
        s = 2j * np.pi * frequency_Hz
        loop = (1.0 - ratio**2 + 2j * self.damping * ratio) * (1.0 + self.valve_s * s)
        return np.asarray(self.gain * np.exp(-s * self.delay_s) / loop)

    def scale(self, gain: float = 1.0, bandwidth: float = 1.0, delay: float = 1.0) -> ActuatorModel:
        """Return the model with these factors; a larger bandwidth makes the whole loop faster, the valve included."""
        return replace(
            self,
            gain=gain * self.gain,
            bandwidth_Hz=bandwidth * self.bandwidth_Hz,
            valve_s=self.valve_s / bandwidth,
            delay_s=delay * self.delay_s,
        )

    def as_dict(self) -> dict[str, float]:
        """Return the parameters by name."""
        return asdict(self)


def fit_model(frequency_Hz: Array, response: ComplexArray, spread: Array) -> ActuatorModel:
    """Return the model nearest to a `response` (n,) whose relative standard deviations are `spread` (n,).

    Least squares of the relative error from a grid of delays and bandwidths; the best of the local fits is kept.
    """
    weight = 1.0 / np.maximum(spread, 0.005)
    weight /= np.sqrt(np.mean(weight**2))

    def residuals(parameters: Array) -> Array:
        error = weight * (ActuatorModel(*parameters).response(frequency_Hz) / response - 1.0)
        return np.concatenate([error.real, error.imag])

    starts = [
        np.array([float(np.abs(response[0])), delay, bandwidth, 0.7, 0.001])
        for delay in START_DELAYS_S
        for bandwidth in START_BANDWIDTHS_HZ
    ]
    starts.sort(key=lambda start: float(np.sum(residuals(start) ** 2)))
    fits = [
        least_squares(residuals, np.clip(start, LOWER, UPPER), bounds=(LOWER, UPPER), x_scale=SCALES, loss="soft_l1")
        for start in starts[:3]
    ]
    return ActuatorModel(*map(float, min(fits, key=lambda fit: float(fit.cost)).x))
