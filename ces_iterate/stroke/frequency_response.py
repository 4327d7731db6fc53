"""The frequency response from command to position, measured from runs that begin and end at rest.

At rest at both ends the spectra of a run have no leakage, so Y = G U + N holds at every frequency. In bands of
frequencies the ratio to a first model is estimated by least squares, which keeps a dead time from smearing it
(Bendat, Piersol 2010, chapter 9; the first model takes the delay's phase out).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ces_iterate.stroke.actuator_model import ActuatorModel, fit_model
from ces_iterate.stroke.errors import StrokeError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

MIN_COHERENCE = 0.9
MIN_BANDS = 4
MIN_POWER = (
    1e-6  # of a band's command, over the strongest band's: below, distortions of the strong ones may pass for it
)
MAX_RATIO = 4.0  # of a measured response to a model of which at most the tolerance may be wrong
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


RunGroups = Sequence[Sequence[CommandedRun]]
"""Runs in groups of one kind each; in every band of frequencies the group that shows the response best is used."""


def identify_actuator(groups: RunGroups, to_Hz: float) -> tuple[ActuatorModel, MeasuredResponse]:
    """Return a model and the measured response up to `to_Hz`; raises StrokeError if the runs do not determine them."""
    runs = [run for group in groups for run in group]
    first = measure_response(groups, to_Hz, ActuatorModel(1.0, _find_delay(runs), 500.0, 0.7))
    rough = fit_model(first.frequency_Hz, first.response, first.spread)
    measured = measure_response(groups, to_Hz, rough)
    return fit_model(measured.frequency_Hz, measured.response, measured.spread), measured


def measure_response(groups: RunGroups, to_Hz: float, model: ActuatorModel) -> MeasuredResponse:
    """Return the response measured relative to a given `model`; raises StrokeError if the runs do not show it."""
    line_Hz = max(1.0 / (len(run.command_m) * run.interval_s) for group in groups for run in group)
    bands = _band_edges(to_Hz, line_Hz)
    rows = [row for group in groups if group for row in _estimate(group, bands, model)]
    best: dict[int, BandEstimate] = {}
    for row in sorted(rows, key=lambda row: -row.spread):
        best[row.band] = row
    if len(best) < MIN_BANDS:
        raise StrokeError(
            f"the actuator's response was found in {len(best)} bands of frequencies; expected at least {MIN_BANDS}: "
            "use a probe (probe: {duration_s: 10}), or give a model"
        )
    found = [best[band] for band in sorted(best)]
    at, spread, coherence, width = np.array([(r.frequency_Hz, r.spread, r.coherence, r.width_Hz) for r in found]).T
    ratio = np.array([row.ratio for row in found])
    return MeasuredResponse(at, ratio * model.response(at), spread, coherence, width)


class BandEstimate(NamedTuple):
    """The least-squares ratio of measured to modelled position in one band, by its number."""

    band: int
    frequency_Hz: float
    width_Hz: float
    ratio: complex
    spread: float
    coherence: float
    power: float  # of the command, mean over the lines

    def is_plausible(self) -> bool:
        """Return whether the ratio is coherent and no distortion of another frequency's motion."""
        size = abs(self.ratio)
        return self.coherence >= MIN_COHERENCE and np.isfinite(self.spread) and 1.0 / MAX_RATIO <= size <= MAX_RATIO


def _estimate(runs: Sequence[CommandedRun], edges: Array, model: ActuatorModel) -> list[BandEstimate]:
    """Return the plausible estimates of the bands between the `edges` (n + 1,) from the lines of all `runs`."""
    lines = [_lines(run, float(edges[-1]), model) for run in runs]
    frequency, reference, position = (np.concatenate(parts) for parts in zip(*lines, strict=True))
    command = reference / model.response(frequency)
    number = np.searchsorted(edges, frequency, side="right") - 1
    rows = []
    for band in range(len(edges) - 1):
        part = number == band
        if part.sum() >= MIN_LINES:
            power = float(np.mean(np.abs(command[part]) ** 2))
            where = band, float(frequency[part].mean()), float(np.diff(edges)[band])
            rows.append(BandEstimate(*where, *_ratio(reference[part], position[part]), power))
    least = MIN_POWER * max((row.power for row in rows), default=0.0)
    return [row for row in rows if row.power > least and row.is_plausible()]


def _lines(run: CommandedRun, to_Hz: float, model: ActuatorModel) -> tuple[Array, ComplexArray, ComplexArray]:
    """Return frequencies, modelled and measured spectrum of the position between FROM_HZ and `to_Hz`."""
    frequency: Array = np.asarray(np.fft.rfftfreq(len(run.command_m), run.interval_s), dtype=np.float64)
    part = (frequency >= FROM_HZ) & (frequency <= to_Hz)
    spectra = (np.fft.rfft(values - values[0])[part] for values in (run.command_m, run.position_m))
    command, position = spectra
    return frequency[part], model.response(frequency[part]) * command, position


def _band_edges(to_Hz: float, line_Hz: float) -> Array:
    """Return rising frequencies from FROM_HZ to `to_Hz`, MIN_LINES lines and RELATIVE_WIDTH apart."""
    edges = [FROM_HZ]
    while edges[-1] < to_Hz:
        edges.append(edges[-1] + max((MIN_LINES + 0.5) * line_Hz, RELATIVE_WIDTH * edges[-1]))
    return np.array([*edges[:-1], to_Hz])


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
