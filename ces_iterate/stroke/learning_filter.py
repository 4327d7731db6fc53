"""The update of a command from a run's error, and the condition under which repeating it converges.

With the command u = r + a, wanted stroke r, error e = r - y and plant y = G u + d (d repeats), a run is followed by

    a <- P Q (a + L e),   so   a - a* is mapped by   Q (1 - L G)   and then by the projection P onto the limits.

P does not enlarge distances (limits.py) and runs begin and end at rest, so the distance from the limit a* shrinks in
every run if

    |Q (1 - L G)| < 1   at all frequencies and for all plants G considered                                    (1)

(Bristow, Tharayil, Alleyne 2006, IEEE Control Systems 26(3), theorems 3 and 8; Norrlöf, Gunnarsson 2002). L = h / Ĝ
has the phase of the inverse model, Q is real: a low-pass without phase. With G = Ĝ D (1 + W), where D = factors of
gain, bandwidth and delay within the tolerance and |W| <= radius (measured), L G = h D (1 + W) and

    |1 - L G| <= max over D of |1 - h D| + h |D| radius                                                       (2)

The real h(f) minimises (2) at every frequency. Q is 1 up to the learning bandwidth, which ends where (2) reaches
MAX_CONTRACTION, and 0 above. A smaller gain s h with 0 < s <= 1 keeps (1): |1 - s x| <= 1 - s + s |1 - x|.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ces_iterate.stroke.actuator_model import ActuatorModel
from ces_iterate.stroke.errors import StrokeError
from ces_iterate.stroke.frequency_response import MeasuredResponse

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

MAX_CONTRACTION = 0.9  # of the worst plant inside the learning bandwidth
MAX_AMPLIFICATION = 8.0  # of the inverse model, over its value at rest
TAPER = 0.8  # Q falls from 1 to 0 between this share of the learning bandwidth and the bandwidth itself
MIN_BANDWIDTH_HZ = 1.0
STEP_HZ = 0.1
GAINS = np.linspace(0.0, 1.2, 61)  # h to choose from
POINTS = 5  # factors of bandwidth and of delay in the family of plants


@dataclass(frozen=True)
class LearningFilter:
    """h and Q on a grid of frequencies from 0, each (n,), with the worst |1 - L G| and that of the model itself."""

    model: ActuatorModel
    tolerance: float
    frequency_Hz: Array
    gain: Array
    share: Array
    worst: Array
    bandwidth_Hz: float

    @property
    def contraction(self) -> Array:
        """|Q (1 - L G)| of the worst plant, (n,)."""
        return self.share * self.worst

    @property
    def nominal(self) -> Array:
        """|Q (1 - L G)| if the model is exact, (n,)."""
        return np.asarray(self.share * np.abs(1.0 - self.gain))

    def learning(self, frequency_Hz: Array) -> ComplexArray:
        """Return L at the frequencies (n,); 0 above the grid."""
        gain = np.interp(frequency_Hz, self.frequency_Hz, self.gain, right=0.0)
        return np.asarray(gain / self.model.response(frequency_Hz))

    def robustness(self, frequency_Hz: Array) -> Array:
        """Return Q at the frequencies (n,); 0 above the grid."""
        return np.interp(frequency_Hz, self.frequency_Hz, self.share, right=0.0)


def design_filter(
    model: ActuatorModel, measured: MeasuredResponse | None, tolerance: float, to_Hz: float
) -> LearningFilter:
    """Return the filter whose condition (1) holds for all plants within `tolerance` and the `measured` uncertainty.

    Without a measured response (a given model) the tolerance is all that is allowed for. The learning bandwidth is at
    most `to_Hz`. Raises StrokeError if the condition holds nowhere.
    """
    frequency = np.arange(0.0, to_Hz + STEP_HZ, STEP_HZ)
    radius = np.zeros_like(frequency) if measured is None else measured.radius(model, frequency)
    gain, worst = choose_gain(model, radius, tolerance, frequency)
    bandwidth = _find_bandwidth(frequency, worst)
    ratio = (frequency / bandwidth - TAPER) / (1.0 - TAPER)
    share = 0.5 + 0.5 * np.cos(np.pi * np.clip(ratio, 0.0, 1.0))
    share[frequency >= bandwidth] = 0.0
    return LearningFilter(model, tolerance, frequency, gain, share, worst, bandwidth)


def choose_gain(model: ActuatorModel, radius: Array, tolerance: float, frequency_Hz: Array) -> tuple[Array, Array]:
    """Return the gain h that minimises the bound (2) at each frequency, and that bound, each (n,)."""
    nominal = model.response(frequency_Hz)
    bound = np.zeros((len(GAINS), len(frequency_Hz)))
    gains, room = GAINS[:, np.newaxis], np.where(np.isfinite(radius), radius, 1e3)
    for plant in plants_within(model, tolerance):
        factor = plant.response(frequency_Hz) / nominal
        np.maximum(bound, np.abs(1.0 - gains * factor) + gains * np.abs(factor) * room, out=bound)
    cap = MAX_AMPLIFICATION * np.abs(nominal) / abs(model.gain)
    bound[gains > cap] = np.inf
    best = np.argmin(bound, axis=0)
    return GAINS[best], bound[best, np.arange(len(frequency_Hz))]


def plants_within(model: ActuatorModel, tolerance: float) -> list[ActuatorModel]:
    """Return the plants of which `model` may be wrong by the `tolerance`, whichever of the two is the 100 %."""
    low, high = 1.0 - tolerance, 1.0 / (1.0 - tolerance)
    steps = np.geomspace(low, high, POINTS)
    return [model.scale(gain, bandwidth, delay) for gain, bandwidth, delay in product((low, 1.0, high), steps, steps)]


def _find_bandwidth(frequency: Array, worst: Array) -> float:
    """Return the frequency up to which the worst contraction is at most MAX_CONTRACTION."""
    bad = np.flatnonzero(worst > MAX_CONTRACTION)
    bandwidth = float(frequency[bad[0]] if len(bad) else frequency[-1])
    if bandwidth < MIN_BANDWIDTH_HZ:
        raise StrokeError(
            f"convergence cannot be guaranteed above {bandwidth:.1f} Hz: the actuator is too uncertain; "
            "record a longer or larger probe, or lower model_tolerance"
        )
    return bandwidth
