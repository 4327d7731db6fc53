"""Learns the command of a stroke run by run: a rig and what is wanted go in, the command and its history come out.

First the wanted stroke itself is commanded, at least twice: the runs' differences show the repeatability, the noise
that no learning removes. After each further run the error, weighted by how much of it repeats, updates the command.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ces_iterate.stroke.actuator_model import ActuatorModel
from ces_iterate.stroke.alignment import position_on_grid
from ces_iterate.stroke.errors import StrokeError
from ces_iterate.stroke.frequency_response import CommandedRun, MeasuredResponse, identify_actuator, measure_response
from ces_iterate.stroke.learning_filter import LearningFilter, design_filter
from ces_iterate.stroke.limits import StrokeLimits, measure_peaks, project_command
from ces_iterate.stroke.probe import make_probe
from ces_iterate.stroke.rig import StrokeRig, with_command
from ces_rig.descriptions import quantity
from ces_rig.experiment import Experiment

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

PAD_S = 1.0  # [s] of zeros behind a signal, so that filters without phase do not wrap around
SMOOTHING_HZ, SMOOTHING = 0.5, 0.05  # width of the smoothed powers: at least, and over frequency
GROWTH = 1.05  # of the error, over the best one, that counts as divergence
GROWTH_NOISE = 0.1  # of the repeatability, allowed on top
PROGRESS = 0.97  # an error above this share of the best one is no progress
PATIENCE = 2  # runs without progress before stopping
MIN_SCALE = 1 / 16  # of the gain, below which learning stops
MOVING = 0.02  # speed at the ends of a stroke over its largest one, above which it is not at rest

CONVERGED, STALLED, EXHAUSTED, DIVERGED = "converged", "stalled", "out of iterations", "diverged"


@dataclass(frozen=True)
class ProbeSettings:
    """The run that identifies the actuator before learning."""

    duration_s: float = quantity(10.0, "s", "duration; 0: no probe, the first runs of the stroke identify", 0.0, 600.0)
    to_Hz: float = quantity(60.0, "Hz", "highest frequency", 2.0, 200.0)


@dataclass(frozen=True)
class LearningSettings:
    """How to learn."""

    max_iterations: int = quantity(8, "1", "most updates of the command", 1, 50)
    repeats: int = quantity(2, "1", "first runs of the wanted stroke, for the repeatability", 2, 10)
    stop_at: float = quantity(1.15, "1", "error over repeatability at which learning stops", 1.0, 10.0)
    correct_model: bool = True  # use the response that the first runs show, where they do, instead of a given model's
    model_tolerance: float = quantity(0.3, "1", "share by which the model may be wrong", 0.0, 0.6)
    step_m: float = quantity(0.010, "m", "largest change of the command from run to run", 1e-6, 0.5)


@dataclass(frozen=True)
class StrokeGoal:
    """The wanted stroke [m] (n,) on a grid of `interval_s`, run as the `experiment` with other commands."""

    wanted_m: Array
    interval_s: float
    experiment: Experiment
    limits: StrokeLimits
    settings: LearningSettings = field(default_factory=LearningSettings)
    probe: ProbeSettings = field(default_factory=ProbeSettings)
    model: ActuatorModel | None = None


@dataclass(frozen=True)
class LearningRun:
    """One run of the stroke: command and position (n,), the RMS error [m], and how the command came about."""

    command_m: Array
    position_m: Array
    error_m: float
    kind: str  # first, learned, repeated
    scale: float = 1.0  # of the learning gain
    limited: float = 0.0  # share of the samples that the limits changed


@dataclass(frozen=True)
class LearnedStroke:
    """The outcome: runs in order, the index of the best one, why learning stopped, and what it was based on."""

    goal: StrokeGoal
    runs: tuple[LearningRun, ...]
    best: int
    stopped: str
    repeatability_m: float
    learning_filter: LearningFilter
    measured: MeasuredResponse | None
    probe: CommandedRun | None

    @property
    def first(self) -> LearningRun:
        """The first run, of the wanted stroke itself."""
        return self.runs[0]

    @property
    def learned(self) -> LearningRun:
        """The run with the smallest error; its command is the result."""
        return self.runs[self.best]

    @property
    def confirmation(self) -> LearningRun:
        """A fresh run of the learned command: an error that no choice has flattered."""
        return self.runs[-1]

    @property
    def iterations(self) -> int:
        """Number of updates of the command."""
        return sum(run.kind == "learned" for run in self.runs)


def learn_stroke(rig: StrokeRig, goal: StrokeGoal) -> LearnedStroke:
    """Return the command learned on `rig`; raises StrokeError for a stroke that cannot be learned there."""
    require_learnable(goal)
    probe = _run_probe(rig, goal)
    start = 0 if probe is None else 1
    first = [_run(rig, goal, goal.wanted_m, start + n, "first") for n in range(goal.settings.repeats)]
    model, measured = _identify(goal, probe, first)
    learner = Learner(goal, design_filter(model, measured, goal.settings.model_tolerance, goal.probe.to_Hz), first)
    for number in range(start + len(first), start + len(first) + goal.settings.max_iterations):
        if learner.stopped:
            break
        command, limited = learner.next_command()
        run = _run(rig, goal, command, number, "learned")
        learner.add(replace(run, scale=learner.scale, limited=limited))
    confirmation = _run(rig, goal, learner.best.command_m, start + len(learner.runs), "repeated")
    runs, stopped = (*learner.runs, confirmation), learner.stopped or EXHAUSTED
    return LearnedStroke(
        goal, runs, learner.best_index, stopped, learner.repeatability_m, learner.filter, measured, probe
    )


def require_learnable(goal: StrokeGoal) -> None:
    """Raise StrokeError for a wanted stroke that breaks the limits or does not begin and end at rest in one place."""
    goal.limits.require_allowed(goal.wanted_m, goal.interval_s, "wanted stroke")
    speed = np.abs(np.diff(goal.wanted_m))
    ends = max(float(speed[0]), float(speed[-1]), abs(float(goal.wanted_m[-1] - goal.wanted_m[0])) * 1e-3)
    if ends > MOVING * speed.max() or speed.max() == 0.0:
        raise StrokeError(
            "wanted stroke: does not begin and end at rest in one place, or does not move; "
            "set its fade_s (0.5 s), or add rest to its file"
        )


class Learner:
    """The state between runs: all runs so far, the best one and the present gain."""

    def __init__(self, goal: StrokeGoal, learning_filter: LearningFilter, first: Sequence[LearningRun]) -> None:
        self.goal, self.filter, self.runs = goal, learning_filter, list(first)
        self.scale, self.stopped, self._idle = 1.0, "", 0
        self.best_index = min(range(len(first)), key=lambda n: first[n].error_m)
        self.repeatability_m = find_repeatability(first)
        size = len(goal.wanted_m) + round(PAD_S / goal.interval_s)
        self._size = size + size % 2
        self._frequency = np.fft.rfftfreq(self._size, goal.interval_s)
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


def find_repeatability(runs: Sequence[LearningRun]) -> float:
    """Return the RMS [m] of what differs between runs of one command, sensor noise included; unbiased in power."""
    positions = np.array([run.position_m for run in runs])
    return float(np.sqrt(np.mean(np.var(positions, axis=0, ddof=1))))


def errors(run: LearningRun, goal: StrokeGoal) -> Array:
    """Return wanted minus measured position [m] (n,)."""
    return goal.wanted_m - run.position_m


def command_peaks(learned: LearnedStroke) -> Iterator[tuple[str, float, float, float]]:
    """Yield for each limit its name, the peak of the wanted stroke, the highest peak of all commands, and the limit."""
    goal = learned.goal
    wanted = measure_peaks(goal.wanted_m, goal.interval_s)
    all_peaks = np.array([measure_peaks(run.command_m, goal.interval_s) for run in learned.runs])
    yield from zip(("stroke [m]", "speed [m/s]", "acceleration [m/s²]"), wanted, map(float, all_peaks.max(axis=0)),
                   goal.limits.as_tuple(), strict=True)  # fmt: skip


def _run_probe(rig: StrokeRig, goal: StrokeGoal) -> CommandedRun | None:
    if goal.model is not None or goal.probe.duration_s == 0.0:
        return None
    command = make_probe(goal.probe.duration_s, goal.probe.to_Hz, goal.interval_s, goal.limits, goal.wanted_m)
    recording = rig.run(with_command(goal.experiment, command, goal.interval_s, 0))
    return CommandedRun(command, position_on_grid(recording, command, goal.interval_s), goal.interval_s)


def _run(rig: StrokeRig, goal: StrokeGoal, command_m: Array, number: int, kind: str) -> LearningRun:
    recording = rig.run(with_command(goal.experiment, command_m, goal.interval_s, number))
    position = position_on_grid(recording, command_m, goal.interval_s)
    return LearningRun(command_m, position, float(np.sqrt(np.mean((goal.wanted_m - position) ** 2))), kind)


def _identify(
    goal: StrokeGoal, probe: CommandedRun | None, first: Sequence[LearningRun]
) -> tuple[ActuatorModel, MeasuredResponse | None]:
    runs = [CommandedRun(run.command_m, run.position_m, goal.interval_s) for run in first]
    if goal.model is None:
        return identify_actuator([*runs, probe] if probe else runs, goal.probe.to_Hz)
    correct = goal.settings.correct_model
    return goal.model, measure_response(runs, goal.probe.to_Hz, goal.model) if correct else None


def _smoothing_edges(frequency: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    half = np.maximum(SMOOTHING_HZ, SMOOTHING * frequency) / 2.0
    low = np.searchsorted(frequency, frequency - half)
    return low, np.maximum(np.searchsorted(frequency, frequency + half, side="right"), low + 1)


def _smooth(power: Array, edges: tuple[NDArray[np.intp], NDArray[np.intp]]) -> Array:
    low, high = edges
    total = np.concatenate([[0.0], np.cumsum(power)])
    return np.asarray((total[high] - total[low]) / (high - low))
