"""The learner between runs: the runs so far go in, the next command or the reason to stop comes out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ces_iterate.stroke.goal import CONVERGED, DIVERGED, STALLED, LearningRun, StrokeGoal, find_repeatability
from ces_iterate.stroke.learning_filter import LearningFilter
from ces_iterate.stroke.limits import project_command

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

PAD_S = 1.0  # [s] of zeros behind a signal, so that filters without phase do not wrap around
SMOOTHING_HZ, SMOOTHING = 0.5, 0.05  # width of the smoothed powers: at least, and over frequency
GROWTH = 1.05  # of the error, over the best one, that counts as divergence
GROWTH_NOISE = 0.1  # of the repeatability, allowed on top
PROGRESS = 0.97  # an error above this share of the best one is no progress
PATIENCE = 2  # runs without progress before stopping
MIN_SCALE = 1 / 16  # of the gain, below which learning stops


class Learner:
    """The state between runs: all runs so far, the best one and the present gain."""

    def __init__(self, goal: StrokeGoal, learning_filter: LearningFilter, first: Sequence[LearningRun]) -> None:
        self.goal, self.filter, self.runs = goal, learning_filter, list(first)
        self.scale, self.stopped, self._idle = 1.0, "", 0
        self.best_index = min(range(len(first)), key=lambda n: first[n].error_m)
        self.repeatability_m = find_repeatability(first)
        size = len(goal.wanted_m) + round(PAD_S / goal.interval_s)
        self._size = size + size % 2
        self._frequency: Array = np.asarray(np.fft.rfftfreq(self._size, goal.interval_s), dtype=np.float64)
        self._edges = _smoothing_edges(self._frequency)
        self._noise = self._noise_power(first)
        self._judge(first[self.best_index])

    @property
    def best(self) -> LearningRun:
        """The run with the smallest error so far."""
        return self.runs[self.best_index]

    def next_command(self) -> tuple[Array, float]:
        """Return the next command (n,), inside the limits, and the share of it that they changed."""
        goal, run = self.goal, self.best
        error = self._spectrum(goal.wanted_m - run.position_m)
        change = self.scale * self._repeating_share(error) * self.filter.learning(self._frequency) * error
        learned = self._spectrum(run.command_m - goal.wanted_m) + change
        correction = np.fft.irfft(self.filter.robustness(self._frequency) * learned, self._size)
        wanted = goal.wanted_m + correction[: len(goal.wanted_m)]
        return project_command(wanted, run.command_m, goal.interval_s, goal.limits, goal.settings.step_m)

    def add(self, run: LearningRun) -> None:
        """Take the next run; if its error has grown, the gain is halved and learning continues from the best run."""
        best = self.best
        self.runs.append(run)
        if run.error_m > GROWTH * best.error_m + GROWTH_NOISE * self.repeatability_m:
            self.scale /= 2.0
            self._idle += 1
            self.stopped = DIVERGED if self.scale < MIN_SCALE else ""
            return
        self._idle = 0 if run.error_m < PROGRESS * best.error_m else self._idle + 1
        if run.error_m < best.error_m:
            self.best_index = len(self.runs) - 1
        self._judge(self.best)

    def _judge(self, best: LearningRun) -> None:
        if best.error_m <= self.goal.settings.stop_at * self.repeatability_m:
            self.stopped = CONVERGED
        elif self._idle >= PATIENCE:
            self.stopped = STALLED

    def _repeating_share(self, error: ComplexArray) -> Array:
        """Return the estimated share of the error's power that is not noise, (m,), within 0 to 1 (Wiener)."""
        power = _smooth(np.abs(error) ** 2, self._edges)
        return np.clip(1.0 - self._noise / np.maximum(power, 1e-300), 0.0, 1.0)

    def _noise_power(self, first: Sequence[LearningRun]) -> Array:
        """Return the smoothed power of what differs between runs of one command."""
        mean = np.mean([run.position_m for run in first], axis=0)
        powers = sum(np.abs(self._spectrum(run.position_m - mean)) ** 2 for run in first)
        return _smooth(np.asarray(powers) / (len(first) - 1), self._edges)

    def _spectrum(self, signal: Array) -> ComplexArray:
        return np.asarray(np.fft.rfft(signal, self._size))


def _smoothing_edges(frequency: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    half = np.maximum(SMOOTHING_HZ, SMOOTHING * frequency) / 2.0
    low = np.searchsorted(frequency, frequency - half)
    return low, np.maximum(np.searchsorted(frequency, frequency + half, side="right"), low + 1)


def _smooth(power: Array, edges: tuple[NDArray[np.intp], NDArray[np.intp]]) -> Array:
    low, high = edges
    total = np.concatenate([[0.0], np.cumsum(power)])
    return np.asarray((total[high] - total[low]) / (high - low))
