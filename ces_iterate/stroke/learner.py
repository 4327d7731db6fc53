"""The learner between runs: the runs so far go in, the next command or the reason to stop comes out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ces_iterate.stroke.actuator_model import ActuatorModel
from ces_iterate.stroke.frequency_response import (
    CommandedRun,
    MeasuredResponse,
    identify_actuator,
    measure_response,
)
from ces_iterate.stroke.goal import CONVERGED, DIVERGED, LEARNED, STALLED, LearningRun, StrokeGoal, find_repeatability
from ces_iterate.stroke.learning_filter import design_filter
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


class StrokeLearner:
    """The state between runs: all runs so far, the best one, the present filter and gain."""

    def __init__(self, goal: StrokeGoal, probe: CommandedRun | None, first: Sequence[LearningRun]) -> None:
        self.goal, self.runs = goal, list(first)
        wanted = [CommandedRun(run.command_m, run.position_m, goal.interval_s) for run in first]
        self._seen: list[Sequence[CommandedRun]] = [wanted, [probe] if probe else []]
        self.model: ActuatorModel | None = goal.model
        self.measured: MeasuredResponse | None = None
        self._design()
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
        step = goal.wanted_m + correction[: len(goal.wanted_m)] - run.command_m
        step *= min(1.0, goal.settings.step_m / max(float(np.abs(step).max()), 1e-300))
        return project_command(run.command_m + step, run.command_m, goal.interval_s, goal.limits)

    def add(self, run: LearningRun) -> None:
        """Take the next run; if its error has grown, the gain is halved and learning continues from the best run."""
        best = self.best
        self.runs.append(run)
        if best.kind == LEARNED:  # before, the motion and with it the damper's force changed too much
            self._seen.append([self._find_change(best, run)])
            self._design()
        if run.error_m > GROWTH * best.error_m + GROWTH_NOISE * self.repeatability_m:
            self.scale /= 2.0
            self._idle += 1
            self.stopped = DIVERGED if self.scale < MIN_SCALE else ""
            return
        self._idle = 0 if run.error_m < PROGRESS * best.error_m else self._idle + 1
        if run.error_m < best.error_m:
            self.best_index = len(self.runs) - 1
        self._judge(self.best)

    def _design(self) -> None:
        """Measure the response from all runs so far and design the filter anew; a model is fitted once."""
        goal = self.goal
        if self.model is None:
            self.model, self.measured = identify_actuator(self._seen, goal.probe.to_Hz)
        elif goal.model is None or goal.settings.correct_model:
            self.measured = measure_response(self._seen, goal.probe.to_Hz, self.model)
        else:
            self.measured = None
        self.filter = design_filter(self.model, self.measured, goal.settings.model_tolerance, goal.probe.to_Hz)

    def _find_change(self, best: LearningRun, run: LearningRun) -> CommandedRun:
        """Return by what `run` differs from the run that it was learned from: without what repeats in the position.

        The noise of that run is in both differences. Where it matters the update was small (`_repeating_share`), and
        its ratio to the position's change implausibly large.
        """
        return CommandedRun(run.command_m - best.command_m, run.position_m - best.position_m, self.goal.interval_s)

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
