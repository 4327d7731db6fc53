"""The frequency response from command to position, measured from runs that begin and end at rest.

At rest at both ends the spectra of a run have no leakage, so Y = G U + N holds at every frequency. In bands of
frequencies the ratio to a first model is estimated by least squares, which keeps a dead time from smearing it
(Bendat, Piersol 2010, chapter 9; the first model takes the delay's phase out).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_iterate.stroke.actuator_model import ActuatorModel, fit_model
from ces_iterate.stroke.errors import StrokeError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

MIN_COHERENCE = 0.9
MIN_BANDS = 4
MIN_LINES = 4  # of a band
RELATIVE_WIDTH = 0.06  # of a band
FROM_HZ = 0.3
RADIUS = 3.0**0.5  # 95 % of a complex normal error lie within this many standard deviations


@dataclass(frozen=True)
class CommandedRun:
    """A command and the position that followed it, minus their start, both (n,) on a grid of `interval_s`."""

    command_m: Array
    position_m: Array
    interval_s: float


@dataclass(frozen=True)
class MeasuredResponse:
    """Response, relative standard deviation, coherence and width of bands, each (n,), by their mean frequencies."""

    frequency_Hz: Array
    response: ComplexArray
    spread: Array
    coherence: Array
    width_Hz: Array

    def covers(self, frequency_Hz: Array) -> NDArray[np.bool_]:
        """Return where the response was measured, (n,)."""
        nearest = np.abs(frequency_Hz[:, np.newaxis] - self.frequency_Hz).argmin(axis=1)
        return np.asarray(np.abs(frequency_Hz - self.frequency_Hz[nearest]) <= self.width_Hz[nearest])

    def ratio(self, model: ActuatorModel, frequency_Hz: Array) -> ComplexArray:
        """Return measured over modelled response at the frequencies (n,), 1 where it was not measured."""
        ratio = self.response / model.response(self.frequency_Hz)
        parts = (np.interp(frequency_Hz, self.frequency_Hz, part) for part in (ratio.real, ratio.imag))
        real, imaginary = parts
        return np.where(self.covers(frequency_Hz), real + 1j * imaginary, 1.0)

    def radius(self, frequency_Hz: Array) -> Array:
        """Return the relative 95 % radius of the response at the frequencies (n,)."""
        return RADIUS * np.interp(frequency_Hz, self.frequency_Hz, self.spread)


def identify_actuator(runs: Sequence[CommandedRun], to_Hz: float) -> tuple[ActuatorModel, MeasuredResponse]:
    """Return a model and the measured response up to `to_Hz`; raises StrokeError if the runs do not determine them."""
    first = _estimate(runs, to_Hz, ActuatorModel(1.0, _find_delay(runs), 500.0, 0.7))
    rough = fit_model(first.frequency_Hz, first.response, first.spread)
    measured = _estimate(runs, to_Hz, rough)
    return fit_model(measured.frequency_Hz, measured.response, measured.spread), measured


def measure_response(runs: Sequence[CommandedRun], to_Hz: float, model: ActuatorModel) -> MeasuredResponse:
    """Return the response measured relative to a given `model`; raises StrokeError if the runs do not show it."""
    return _estimate(runs, to_Hz, model)


def _estimate(runs: Sequence[CommandedRun], to_Hz: float, model: ActuatorModel) -> MeasuredResponse:
    lines = [_lines(run, to_Hz, model) for run in runs]
    frequency, reference, position = (np.concatenate(parts) for parts in zip(*lines, strict=True))
    order = np.argsort(frequency, kind="stable")
    frequency, reference, position = frequency[order], reference[order], position[order]
    rows = [
        (frequency[part].mean(), *_ratio(reference[part], position[part]), np.ptp(frequency[part]))
        for part in _bands(frequency, max(1.0 / (len(r.command_m) * r.interval_s) for r in runs))
    ]
    found = np.array([row for row in rows if row[3] >= MIN_COHERENCE], dtype=np.complex128).reshape(-1, 5)
    if len(found) < MIN_BANDS:
        raise StrokeError(
            f"the actuator's response was found in {len(found)} bands of frequencies; expected at least {MIN_BANDS}: "
            "use a probe (probe: {duration_s: 10}), or give a model"
        )
    at = found[:, 0].real
    spread, coherence, width = found[:, 2:].real.T
    return MeasuredResponse(at, found[:, 1] * model.response(at), spread, coherence, width)


def _lines(run: CommandedRun, to_Hz: float, model: ActuatorModel) -> tuple[Array, ComplexArray, ComplexArray]:
    """Return frequencies, modelled and measured spectrum of the position between FROM_HZ and `to_Hz`."""
    frequency: Array = np.asarray(np.fft.rfftfreq(len(run.command_m), run.interval_s), dtype=np.float64)
    part = (frequency >= FROM_HZ) & (frequency <= to_Hz)
    spectra = (np.fft.rfft(values - values[0])[part] for values in (run.command_m, run.position_m))
    command, position = spectra
    return frequency[part], model.response(frequency[part]) * command, position


def _bands(frequency: Array, line_Hz: float) -> list[slice]:
    """Return slices of rising frequencies, each at least MIN_LINES lines and RELATIVE_WIDTH wide."""
    bands, start = [], 0
    while start < len(frequency):
        width = max(MIN_LINES * line_Hz, RELATIVE_WIDTH * frequency[start])
        stop = int(np.searchsorted(frequency, frequency[start] + width))
        bands.append(slice(start, max(stop, start + 1)))
        start = bands[-1].stop
    return [band for band in bands if band.stop - band.start >= MIN_LINES]


def _ratio(reference: ComplexArray, position: ComplexArray) -> tuple[complex, float, float]:
    """Return the least-squares ratio position/reference, its relative standard deviation, and the coherence."""
    power = float(np.sum(np.abs(reference) ** 2))
    cross = complex(np.sum(position * reference.conj()))
    whole = float(np.sum(np.abs(position) ** 2))
    if power == 0.0 or whole == 0.0 or cross == 0.0:
        return 1.0, np.inf, 0.0
    coherence = min(abs(cross) ** 2 / (power * whole), 1.0)
    degrees = max(len(reference) - 1, 1)
    return cross / power, float(np.sqrt((1.0 - coherence) / (coherence * degrees))), coherence


def _find_delay(runs: Sequence[CommandedRun]) -> float:
    """Return the lag [s] with the largest correlation between command and position, over all runs."""
    run = max(runs, key=lambda r: float(np.var(r.command_m)))
    size = 2 * len(run.command_m)
    spectra = (np.fft.rfft(values - values.mean(), size) for values in (run.command_m, run.position_m))
    command, position = spectra
    correlation = np.fft.irfft(position * command.conj())[: len(run.command_m) // 4]
    return min(float(np.argmax(correlation)) * run.interval_s, 0.2)
