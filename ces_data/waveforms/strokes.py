"""The kinds of stroke: a description goes in, positions on a uniform grid come out; and how sequences follow.

A road's is the suspension stroke of a linear quarter vehicle on an ISO 8608 random road, both in the frequency domain,
so that the road's spectrum is exact and the vehicle in steady state. The parts of a sequence, such as the test points
of a dyno, follow one another, each with a duration and times of its own; after the last part the sequence begins again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from ces_data.arrays import F
from ces_observer.errors import CesError
from ces_observer.fields import REQUIRED
from ces_observer.records import OneOf, choice, items, part, quantity, read_record

T = TypeVar("T")
Parts = Sequence[tuple[float, T]]  # duration [s] and shape of each part

KIND = "sequence"
MAX_PARTS = 1000


class Shape(Protocol):
    """A kind of stroke."""

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the position [m] at the uniform times, shape (n,), before fading and offset."""


class Current(Protocol):
    """A kind of current that is known before the damper moves."""

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the commanded current [A] at the uniform times, shape (n,)."""


def duration() -> Any:
    """Declare the duration of a part."""
    return quantity(REQUIRED, "s", "duration of the part", 0.05, 7200.0)


def find_spans(parts: Parts[T], time_s: F) -> Iterator[tuple[T, slice]]:
    """Yield each part, again and again, with the samples of `time_s` (n,) that belong to it."""
    start, end, index = 0, 0.0, 0
    while start < len(time_s):
        duration, part = parts[index % len(parts)]
        end += duration
        stop = int(np.searchsorted(time_s, time_s[0] + end - 1e-9))
        if stop > start:
            yield part, slice(start, stop)
        start, index = max(stop, start), index + 1


def filtered_noise(count: int, rate_Hz: float, order: int, cutoff_Hz: float, lead_s: float, rng: Generator) -> F:
    """Return white noise (count,) behind a Butterworth low-pass that began `lead_s` earlier."""
    lead = round(lead_s * rate_Hz)
    low_pass = butter(order, cutoff_Hz, fs=rate_Hz, output="sos")
    return np.asarray(sosfilt(low_pass, rng.standard_normal(lead + count))[lead:])


Spectrum = NDArray[np.complex128]

ROUGHNESS_M3 = {"A": 16e-6, "B": 64e-6, "C": 256e-6, "D": 1024e-6}  # [m³] at 0.1 cycles/m, ISO 8608 class means
REFERENCE_1_M = 0.1  # [1/m]
MAX_WAVE_M = 100.0  # [m] longest wave of the road
MAX_HZ = 50.0  # [Hz] the tyre's contact patch averages shorter waves


@dataclass(frozen=True)
class QuarterVehicle:
    """Rear end of a heavy motorcycle, at the damper's own lever ratio; its damping is constant."""

    sprung_kg: float = 145.0  # [kg]
    unsprung_kg: float = 17.0  # [kg]
    spring_N_m: float = 18e3  # [N/m]
    damping_Ns_m: float = 1400.0  # [N·s/m]
    tyre_N_m: float = 150e3  # [N/m]
    tyre_damping_Ns_m: float = 250.0  # [N·s/m]

    def stroke_response(self, frequency_Hz: F) -> Spectrum:
        """Return suspension compression over road height, complex, at each frequency."""
        s = 2j * pi * frequency_Hz
        suspension, tyre = self.spring_N_m + self.damping_Ns_m * s, self.tyre_N_m + self.tyre_damping_Ns_m * s
        body = self.sprung_kg * s**2 + suspension
        wheel = self.unsprung_kg * s**2 + suspension + tyre
        wheel_height = tyre * body / (body * wheel - suspension**2)
        return np.asarray(wheel_height * (1.0 - suspension / body), dtype=np.complex128)


REAR = QuarterVehicle()


def road_stroke(road_class: str, vehicle_m_s: float, time_s: F, rng: Generator, vehicle: QuarterVehicle = REAR) -> F:
    """Return the suspension stroke [m], positive in compression, at uniform times, shape (n,)."""
    frequency = np.fft.rfftfreq(len(time_s), time_s[1] - time_s[0])
    band = (frequency >= vehicle_m_s / MAX_WAVE_M) & (frequency <= MAX_HZ)
    wave = np.where(band, frequency, 1.0) / vehicle_m_s  # [1/m]
    density = np.where(band, ROUGHNESS_M3[road_class] * (wave / REFERENCE_1_M) ** -2 / vehicle_m_s, 0.0)  # [m²/Hz]
    complex_normal = rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))
    step = frequency[1] - frequency[0]
    road = len(time_s) * np.sqrt(density * step) / 2.0 * complex_normal
    return np.asarray(np.fft.irfft(road * vehicle.stroke_response(frequency), len(time_s)), dtype=np.float64)


def _amplitude(default: Any = REQUIRED) -> Any:
    return quantity(default, "m", "amplitude", 0.0, 0.5, above=True)


def _frequency(default: Any = REQUIRED, what: str = "frequency") -> Any:
    return quantity(default, "Hz", what, 0.0, 100.0, above=True)


@dataclass(frozen=True)
class Rest:
    """No movement."""

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return zeros."""
        return np.zeros_like(time_s)


@dataclass(frozen=True)
class Sine:
    """One sine."""

    amplitude_m: float = _amplitude()
    frequency_Hz: float = _frequency()

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the sine."""
        return self.amplitude_m * np.sin(2 * pi * self.frequency_Hz * time_s)


@dataclass(frozen=True)
class SumOfSines:
    """Several sines with seeded random phases."""

    amplitudes_m: tuple[float, ...] = _amplitude()
    frequencies_Hz: tuple[float, ...] = _frequency()

    def __post_init__(self) -> None:
        if len(self.amplitudes_m) != len(self.frequencies_Hz):
            lengths = f"{len(self.amplitudes_m)} amplitudes_m and {len(self.frequencies_Hz)} frequencies_Hz"
            raise CesError(f"{lengths}; expected equal lengths")

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the sum."""
        total = np.zeros_like(time_s)
        for amplitude, frequency in zip(self.amplitudes_m, self.frequencies_Hz, strict=True):
            total += amplitude * np.sin(2 * pi * (frequency * time_s + rng.random()))
        return total


@dataclass(frozen=True)
class Sweep:
    """Linear chirp over the whole duration; where the speed limit binds the amplitude falls as 1/frequency."""

    from_Hz: float = _frequency(2.0, "frequency at the start")
    to_Hz: float = _frequency(16.0, "frequency at the end")
    amplitude_m: float = _amplitude(0.018)
    speed_m_s: float = quantity(0.45, "m/s", "limit of the peak speed", 0.0, 10.0, above=True)

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the chirp; its phase is the integral of a frequency that grows linearly."""
        length = time_s[-1] - time_s[0]
        t = time_s - time_s[0]
        frequency = self.from_Hz + (self.to_Hz - self.from_Hz) * t / length
        phase = 2 * pi * (self.from_Hz * t + (self.to_Hz - self.from_Hz) * t**2 / (2 * length))
        limit = self.speed_m_s / (2 * pi * frequency)
        return np.asarray((self.amplitude_m**-4 + limit**-4) ** -0.25 * np.sin(phase))


@dataclass(frozen=True)
class NoiseStroke:
    """White noise through a 10th-order Butterworth low-pass (thesis), scaled to its peak-to-peak value."""

    peak_to_peak_m: float = quantity(0.050, "m", "largest minus smallest position", 0.0, 1.0, above=True)
    cutoff_Hz: float = _frequency(15.0, "cutoff")
    order: int = quantity(10, "1", "order of the Butterworth filter", 1, 16)

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the filtered noise, centred between its extremes; the filter starts 2 s earlier."""
        x = filtered_noise(len(time_s), 1.0 / (time_s[1] - time_s[0]), self.order, self.cutoff_Hz, 2.0, rng)
        return np.asarray((x - (x.max() + x.min()) / 2) * self.peak_to_peak_m / np.ptp(x))


@dataclass(frozen=True)
class RoadStroke:
    """Suspension stroke of a quarter vehicle on an ISO 8608 road."""

    road_class: str = choice("C", "ISO 8608 road class", ("A", "B", "C", "D"))
    vehicle_m_s: float = quantity(16.7, "m/s", "driving speed", 1.0, 60.0)

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the stroke, positive in compression."""
        return road_stroke(self.road_class, self.vehicle_m_s, time_s, rng)


@dataclass(frozen=True)
class FrequencyModulated:
    """A sine whose frequency swings between two values."""

    amplitude_m: float = _amplitude(0.012)
    low_Hz: float = _frequency(1.5, "lowest frequency")
    high_Hz: float = _frequency(8.0, "highest frequency")
    modulation_Hz: float = _frequency(0.2, "frequency of the modulation")

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the sine of the integrated frequency."""
        centre, swing = (self.high_Hz + self.low_Hz) / 2, (self.high_Hz - self.low_Hz) / 2
        modulation = 2 * pi * self.modulation_Hz
        phase = 2 * pi * (centre * time_s - swing / modulation * np.sin(modulation * time_s))
        return np.asarray(self.amplitude_m * np.sin(phase))


@dataclass(frozen=True)
class Triangle:
    """Constant speed back and forth, with rounded corners."""

    amplitude_m: float = _amplitude()
    speed_m_s: float = quantity(REQUIRED, "m/s", "speed between the corners", 0.0, 10.0, above=True)
    corner_s: float = quantity(0.02, "s", "duration of a corner", 1e-3, 1.0)

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the triangle, starting upwards from 0, smoothed by a raised-cosine window."""
        step = time_s[1] - time_s[0]
        half = max(1, round(self.corner_s / step / 2))
        t = np.arange(-half, len(time_s) + half) * step + time_s[0]
        turn = 4 * self.amplitude_m / self.speed_m_s
        triangle = self.amplitude_m * (4 * np.abs((t / turn - 0.25) % 1.0 - 0.5) - 1.0)
        window = np.hanning(2 * half + 3)[1:-1]
        return np.convolve(triangle, window / window.sum(), mode="valid")


@dataclass(frozen=True)
class Common:
    """Settings that all strokes have in common."""

    offset_m: float = quantity(0.0, "m", "position around which the stroke moves", -0.5, 0.5)
    fade_s: float = quantity(0.5, "s", "duration of the smooth fade at both ends", 0.0, 60.0)


@dataclass(frozen=True)
class Stroke:
    """A shape with its common settings."""

    shape: Shape = part(kind=OneOf(lambda: KINDS), inline=True)
    common: Common = part(inline=True)

    def checked(self) -> Self:
        """Return it; a sequence fades in its parts."""
        sequence = isinstance(self.shape, StrokeSequence)
        return replace(self, common=replace(self.common, fade_s=0.0)) if sequence else self

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the position [m] at the uniform times, shape (n,)."""
        return self.common.offset_m + self.shape.samples(time_s, rng) * fade(time_s, self.common.fade_s)


@dataclass(frozen=True)
class StrokePart(Stroke):
    """A stroke in a sequence."""

    shape: Shape = part(kind=OneOf(lambda: SINGLE), inline=True)
    duration_s: float = duration()


@dataclass(frozen=True)
class StrokeSequence:
    """Strokes one after the other; each fades in and out by itself."""

    parts: tuple[StrokePart, ...] = items(1, MAX_PARTS)

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the position [m] at the uniform times (n,)."""
        position = np.zeros_like(time_s)
        for one, span in find_spans([(one.duration_s, one) for one in self.parts], time_s):
            if span.stop - span.start > 1:
                position[span] = one.samples(time_s[span] - time_s[span.start], rng)
        return position


SINGLE: Mapping[str, type[Any]] = {
    "rest": Rest, "sine": Sine, "sum_of_sines": SumOfSines, "sweep": Sweep, "noise": NoiseStroke, "road": RoadStroke,
    "frequency_modulated": FrequencyModulated, "triangle": Triangle,
}  # fmt: skip
KINDS: Mapping[str, type[Any]] = {**SINGLE, KIND: StrokeSequence}


def make_stroke(description: object, where: str) -> Stroke:
    """Return the stroke of the description `{kind: …, its parameters, offset_m, fade_s}`; raises CesError."""
    return read_record(Stroke, description, where, CesError)


def fade(time_s: F, fade_s: float) -> F:
    """Return a factor that rises from 0 to 1 within `fade_s` and falls likewise at the end, twice differentiable."""
    if fade_s == 0.0:
        return np.ones_like(time_s)
    distance = np.minimum(time_s - time_s[0], time_s[-1] - time_s)
    return smooth_step(np.clip(distance / fade_s, 0.0, 1.0))


def smooth_step(u: F) -> F:
    """Return a rise from 0 at u = 0 to 1 at u = 1, twice differentiable."""
    return np.asarray(u**3 * (10.0 + u * (6.0 * u - 15.0)))
