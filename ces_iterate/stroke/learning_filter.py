"""The update of a command from a run's error, and the condition under which repeating it converges.

With the command u = r + a, wanted stroke r, error e = r - y and plant y = G u + d (d repeats), a run is followed by

    a <- P Q (a + L e),   so   a - a* is mapped by   Q (1 - L G)   and then by the projection P onto the limits.

P does not enlarge distances (limits.py) and runs begin and end at rest, so the distance from the limit a* shrinks in
every run if

    |Q (1 - L G)| < 1   at all frequencies and for all plants G considered                                    (1)

(Bristow, Tharayil, Alleyne 2006, IEEE Control Systems 26(3), theorems 3 and 8; Norrlöf, Gunnarsson 2002). L = h / Ĝ
has the phase of the inverse model, h and Q are real: filters without phase. The plants considered are G = Ĝ D with

* D = factors of gain, bandwidth and delay, all three at once, by which a model may be wrong that is within the
  tolerance of the plant's own values:                               |1 - L G| <= max over D of |1 - h D|       (2)
* where the response was measured, Ĝ is that response, and D the disk of its 95 % radius and MEASURED_TOLERANCE (it
  depends a little on the amplitude):                                |1 - L G| <= |1 - h| + h radius            (3)

The real h(f) minimises (2); where the response was measured it minimises (3) and keeps (2) at most MAX_CONTRACTION.
Q is 1 up to the learning bandwidth, which ends where (2) or (3) exceeds MAX_CONTRACTION, and 0 above. A smaller gain
s h with 0 < s <= 1 keeps (1), because |1 - s x| <= 1 - s + s |1 - x|.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ces_data.arrays import F
from ces_iterate.errors import StrokeError
from ces_iterate.stroke.actuator import ActuatorModel, ComplexArray, MeasuredResponse

MAX_CONTRACTION = 0.98  # of the worst plant inside the learning bandwidth
MEASURED_TOLERANCE = 0.1  # of a measured response, for what its radius does not know
MAX_AMPLIFICATION = 8.0  # of the inverse model, over its value at rest
TAPER = 0.9  # Q falls from 1 to 0 between this share of the learning bandwidth and the bandwidth itself
MIN_BANDWIDTH_HZ = 1.0
STEP_HZ = 0.25
GAINS = np.linspace(0.0, 1.2, 241)  # h to choose from
POINTS = 5  # factors of bandwidth and of delay in the family of plants


@dataclass(frozen=True)
class LearningFilter:
    """Ĝ, h, Q and the bounds (2) and (3) on |1 - L G| on a grid of frequencies from 0, each (n,); (3) is NaN where the
    response was not measured.
    """

    model: ActuatorModel
    tolerance: float
    frequency_Hz: F
    plant: ComplexArray
    gain: F
    share: F
    bound_in_tolerance: F
    bound_measured: F
    bandwidth_Hz: float

    @property
    def contraction(self) -> F:
        """The bound on |Q (1 - L G)| for all plants considered, (n,)."""
        return self.share * np.fmax(self.bound_in_tolerance, self.bound_measured)

    @property
    def nominal(self) -> F:
        """|Q (1 - L G)| if Ĝ is exact, (n,)."""
        return np.asarray(self.share * np.abs(1.0 - self.gain))

    def learning(self, frequency_Hz: F) -> ComplexArray:
        """Return L at the frequencies (n,); 0 above the grid."""
        law = self.gain / self.plant
        real, imaginary = (np.interp(frequency_Hz, self.frequency_Hz, part, right=0.0) for part in (law.real, law.imag))
        return np.asarray(real + 1j * imaginary)

    def robustness(self, frequency_Hz: F) -> F:
        """Return Q at the frequencies (n,); 0 above the grid."""
        return np.interp(frequency_Hz, self.frequency_Hz, self.share, right=0.0)


def design_filter(
    model: ActuatorModel, measured: MeasuredResponse | None, tolerance: float, to_Hz: float
) -> LearningFilter:
    """Return the filter whose condition (1) holds for all plants considered, with a learning bandwidth up to `to_Hz`.

    Raises StrokeError if it holds nowhere.
    """
    frequency = np.arange(0.0, to_Hz + STEP_HZ, STEP_HZ)
    plant, family = model.response(frequency), _family_bound(model, tolerance, frequency)
    if measured is not None:
        plant = plant * measured.ratio(model, frequency)
    disk = _disk_bound(measured, frequency)
    family[GAINS[:, np.newaxis] > MAX_AMPLIFICATION * np.abs(plant) / abs(model.gain)] = np.inf
    kept = np.isfinite(disk) & (family <= MAX_CONTRACTION)
    best = np.where(kept.any(axis=0), np.argmin(np.where(kept, disk, np.inf), axis=0), np.argmin(family, axis=0))
    columns = np.arange(len(frequency))
    bounds = family[best, columns], disk[best, columns]
    bad = np.flatnonzero(np.fmax(*bounds) > MAX_CONTRACTION)
    bandwidth = float(frequency[bad[0]] if len(bad) else frequency[-1])
    if bandwidth < MIN_BANDWIDTH_HZ:
        raise StrokeError(
            f"convergence cannot be guaranteed above {bandwidth:.1f} Hz: the actuator is too uncertain; "
            "record a longer or larger probe, or lower model_tolerance"
        )
    share = 0.5 + 0.5 * np.cos(np.pi * np.clip((frequency / bandwidth - TAPER) / (1.0 - TAPER), 0.0, 1.0))
    share[frequency >= bandwidth] = 0.0
    return LearningFilter(model, tolerance, frequency, plant, GAINS[best], share, *bounds, bandwidth)


def _disk_bound(measured: MeasuredResponse | None, frequency_Hz: F) -> F:
    """Return the bound (3) for every gain h in GAINS and every frequency, NaN where nothing was measured."""
    bound = np.full((len(GAINS), len(frequency_Hz)), np.nan)
    if measured is not None:
        covered = measured.covers(frequency_Hz)
        radius = measured.radius(frequency_Hz[covered]) + MEASURED_TOLERANCE
        bound[:, covered] = np.abs(1.0 - GAINS[:, np.newaxis]) + GAINS[:, np.newaxis] * radius
    return bound


def _family_bound(model: ActuatorModel, tolerance: float, frequency_Hz: F) -> F:
    """Return the bound (2) for every gain h in GAINS and every frequency."""
    bound = np.zeros((len(GAINS), len(frequency_Hz)))
    for plant in plants_within(model, tolerance):
        factor = plant.response(frequency_Hz) / model.response(frequency_Hz)
        np.maximum(bound, np.abs(1.0 - GAINS[:, np.newaxis] * factor), out=bound)
    return bound


def plants_within(model: ActuatorModel, tolerance: float) -> list[ActuatorModel]:
    """Return plants of which the `model` is wrong by up to `tolerance` of the plant's gain, bandwidth and delay."""
    low, high = 1.0 / (1.0 + tolerance), 1.0 / (1.0 - tolerance)
    steps = np.geomspace(low, high, POINTS)
    return [model.scale(gain, bandwidth, delay) for gain, bandwidth, delay in product((low, 1.0, high), steps, steps)]
