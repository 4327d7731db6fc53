"""Groups of what was recorded alike: levels of current, and cycles of one current, amplitude, frequency and centre."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.characteristics.cycles import Cycles
from ces_identify.characteristics.motion import Stretch, noise_rms
from ces_identify.numerics.arrays import F, I

CURRENT_SHARE = 0.03  # of the largest current: less is the same current
CURRENT_NOISE = 8.0  # times the noise of the measured current: less is the same current
SAME_SIZE = 0.03  # relative difference of amplitude and of frequency within a condition
SAME_CENTRE = 0.2  # difference of the centre of the stroke within a condition, of the amplitude


@dataclass(frozen=True)
class Condition:
    """The cycles (indices, shape (n,)) of one current, amplitude and frequency; values are means over the cycles.

    `current_width_A` is the difference between the largest and the smallest mean current of the level's cycles.
    """

    cycles: I
    current_A: float
    current_width_A: float
    amplitude_m: float
    frequency_Hz: float


def current_tolerance(stretches: Sequence[Stretch]) -> float:
    """Return by how much [A] currents may differ and still count as the same."""
    known = [s.current[np.isfinite(s.current)] for s in stretches]
    largest = max((float(np.percentile(np.abs(c), 99.0)) for c in known if len(c)), default=0.0)
    noise = max((noise_rms(_find_changes(c)) for c in known), default=0.0)
    return max(CURRENT_SHARE * largest, CURRENT_NOISE * noise, 1e-9)


def group_values(values: F, tolerance: float) -> list[I]:
    """Return the indices of each group of values (n,) that are close together, in rising order.

    Groups are separated by gaps of at least half the `tolerance`; one wider than twice the tolerance is cut.
    """
    if not len(values):
        return []
    order = np.argsort(values, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(values[order]) > 0.5 * tolerance) + 1)
    return [piece for group in groups for piece in _cut(values, group, tolerance)]


def find_conditions(cycles: Cycles, tolerance_A: float) -> list[Condition]:
    """Return the conditions of used cycles, by current, then by peak speed."""
    amplitude = 0.5 * np.ptp(cycles.position, axis=1)
    frequency = 1.0 / (cycles.time_s[:, -1] - cycles.time_s[:, 0])
    centre = 0.5 * (cycles.position.max(axis=1) + cycles.position.min(axis=1))
    conditions = []
    for level in group_values(cycles.current_A, tolerance_A):
        current = cycles.current_A[level]
        for group in _group_cycles(np.sort(level), amplitude, frequency, centre):
            means = (float(amplitude[group].mean()), float(frequency[group].mean()))
            conditions.append(Condition(group, float(current.mean()), float(np.ptp(current)), *means))
    return sorted(conditions, key=lambda c: (c.current_A, c.amplitude_m * c.frequency_Hz))


def _group_cycles(indices: I, amplitude: F, frequency: F, centre: F) -> Iterator[I]:
    """Yield groups of cycles: each cycle joins the first group whose means it matches."""
    members: list[list[int]] = []
    means: list[F] = []
    for index in indices.tolist():
        values = np.array([np.log(amplitude[index]), np.log(frequency[index]), centre[index] / amplitude[index]])
        limits = (SAME_SIZE, SAME_SIZE, SAME_CENTRE)
        match = next((k for k, mean in enumerate(means) if (np.abs(values - mean) <= limits).all()), None)
        if match is None:
            members.append([index])
            means.append(values)
        else:
            members[match].append(index)
            means[match] += (values - means[match]) / len(members[match])
    yield from (np.array(group, np.int64) for group in members)


def _cut(values: F, group: I, tolerance: float) -> Iterator[I]:
    """Yield a sorted group whole, or in pieces one tolerance wide if it is too wide."""
    if values[group[-1]] - values[group[0]] <= 2.0 * tolerance:
        yield group
        return
    piece = np.floor((values[group] - values[group[0]]) / tolerance).astype(np.int64)
    yield from np.split(group, np.flatnonzero(np.diff(piece)) + 1)


def _find_changes(current: F) -> F:
    """Return the current without repetitions of held samples, which would hide its noise."""
    keep = np.ones(len(current), np.bool_)
    keep[1:] = np.diff(current) != 0.0
    return current[keep] if keep.sum() > 0.1 * len(current) else current
