"""Identification of an actuator: runs go in, its frequency response and a model come out.

The model is a gain, a dead time and a loop of third order, fitted to the response measured in bands of frequencies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ces_data.arrays import F, Mask
from ces_iterate.errors import StrokeError
from ces_observer.fields import quantity

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

    def response(self, frequency_Hz: F) -> ComplexArray:
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


def fit_model(frequency_Hz: F, response: ComplexArray, spread: F) -> ActuatorModel:
    """Return the model nearest to a `response` (n,) whose relative standard deviations are `spread` (n,).

    Least squares of the relative error from a grid of delays and bandwidths; the best of the local fits is kept.
    """
    weight = 1.0 / np.maximum(spread, 0.005)
    weight /= np.sqrt(np.mean(weight**2))

    def residuals(parameters: F) -> F:
        error = weight * (ActuatorModel(*parameters).response(frequency_Hz) / response - 1.0)
        return np.concatenate([error.real, error.imag])

    grid, gain = product(START_DELAYS_S, START_BANDWIDTHS_HZ), float(np.abs(response[0]))
    starts = [np.array([gain, delay, bandwidth, 0.7, 0.001]) for delay, bandwidth in grid]
    starts.sort(key=lambda start: float(np.sum(residuals(start) ** 2)))
    fits = [
        least_squares(residuals, np.clip(start, LOWER, UPPER), bounds=(LOWER, UPPER), x_scale=SCALES, loss="soft_l1")
        for start in starts[:3]
    ]
    return ActuatorModel(*map(float, min(fits, key=lambda fit: float(fit.cost)).x))


MIN_COHERENCE = 0.9
MIN_BANDS = 4
MIN_POWER = 1e-6  # of a band's command, over the strongest band's: below, distortions of these may pass for it
MAX_RATIO = 4.0  # of a measured response to a model of which at most the tolerance may be wrong
MIN_LINES = 4  # of a band
RELATIVE_WIDTH = 0.06  # of a band
FROM_HZ = 0.3
RADIUS = 3.0**0.5  # 95 % of a complex normal error lie within this many standard deviations


@dataclass(frozen=True)
class CommandedRun:
    """A command and the position that followed it, minus their start, both (n,) on a grid of `interval_s`."""

    command_m: F
    position_m: F
    interval_s: float


@dataclass(frozen=True)
class MeasuredResponse:
    """Response, relative standard deviation and width of bands, each (n,), by their mean frequencies."""

    frequency_Hz: F
    response: ComplexArray
    spread: F
    width_Hz: F

    def covers(self, frequency_Hz: F) -> Mask:
        """Return where the response was measured, (n,)."""
        nearest = np.abs(frequency_Hz[:, np.newaxis] - self.frequency_Hz).argmin(axis=1)
        return np.asarray(np.abs(frequency_Hz - self.frequency_Hz[nearest]) <= self.width_Hz[nearest])

    def ratio(self, model: ActuatorModel, frequency_Hz: F) -> ComplexArray:
        """Return measured over modelled response at the frequencies (n,), 1 where it was not measured."""
        ratio = self.response / model.response(self.frequency_Hz)
        real, imaginary = (np.interp(frequency_Hz, self.frequency_Hz, part) for part in (ratio.real, ratio.imag))
        return np.where(self.covers(frequency_Hz), real + 1j * imaginary, 1.0)

    def radius(self, frequency_Hz: F) -> F:
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
    edges = [FROM_HZ]  # rising up to `to_Hz`, MIN_LINES lines and RELATIVE_WIDTH apart
    while edges[-1] < to_Hz:
        edges.append(edges[-1] + max((MIN_LINES + 0.5) * line_Hz, RELATIVE_WIDTH * edges[-1]))
    bands = np.array([*edges[:-1], to_Hz])
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
    at, spread, width = np.array([(r.frequency_Hz, r.spread, r.width_Hz) for r in found]).T
    ratio = np.array([row.ratio for row in found])
    return MeasuredResponse(at, ratio * model.response(at), spread, width)


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


def _estimate(runs: Sequence[CommandedRun], edges: F, model: ActuatorModel) -> list[BandEstimate]:
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


def _lines(run: CommandedRun, to_Hz: float, model: ActuatorModel) -> tuple[F, ComplexArray, ComplexArray]:
    """Return frequencies, modelled and measured spectrum of the position between FROM_HZ and `to_Hz`."""
    frequency: F = np.asarray(np.fft.rfftfreq(len(run.command_m), run.interval_s), dtype=np.float64)
    part = (frequency >= FROM_HZ) & (frequency <= to_Hz)
    command, position = (np.fft.rfft(values - values[0])[part] for values in (run.command_m, run.position_m))
    return frequency[part], model.response(frequency[part]) * command, position


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
    command, position = (np.fft.rfft(values - values.mean(), size) for values in (run.command_m, run.position_m))
    correlation = np.fft.irfft(position * command.conj())[: len(run.command_m) // 4]
    return min(float(np.argmax(correlation)) * run.interval_s, 0.2)
