"""What is to be learned and what was: settings, the goal, the runs and the outcome."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ces_iterate.stroke.actuator_model import ActuatorModel
from ces_iterate.stroke.frequency_response import CommandedRun, MeasuredResponse
from ces_iterate.stroke.learning_filter import LearningFilter
from ces_iterate.stroke.limits import StrokeLimits, measure_peaks
from ces_rig.descriptions import quantity

Array = NDArray[np.float64]

CONVERGED, STALLED, EXHAUSTED, DIVERGED = "converged", "no further progress", "out of iterations", "diverged"
FIRST, LEARNED, REPEATED = "first", "learned", "repeated"


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
    step_m: float = quantity(0.020, "m", "largest change of the command from run to run", 1e-6, 0.5)


@dataclass(frozen=True)
class StrokeGoal:
    """The wanted stroke [m] (n,) on a grid of `interval_s`, and how its command may be learned."""

    wanted_m: Array
    interval_s: float
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
    kind: str  # FIRST, LEARNED or REPEATED
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
        return sum(run.kind == LEARNED for run in self.runs)


def find_repeatability(runs: Sequence[LearningRun]) -> float:
    """Return the RMS [m] of what differs between runs of one command, sensor noise included; unbiased in power."""
    positions = np.array([run.position_m for run in runs])
    return float(np.sqrt(np.mean(np.var(positions, axis=0, ddof=1))))


def command_peaks(learned: LearnedStroke) -> Iterator[tuple[str, float, float, float]]:
    """Yield for each limit its name, the peak of the wanted stroke, the highest peak of all commands, and the limit."""
    goal = learned.goal
    wanted = measure_peaks(goal.wanted_m, goal.interval_s)
    all_peaks = np.array([measure_peaks(run.command_m, goal.interval_s) for run in learned.runs])
    yield from zip(
        ("stroke [m]", "speed [m/s]", "acceleration [m/s²]"),
        wanted,
        map(float, all_peaks.max(axis=0)),
        goal.limits.as_tuple(),
        strict=True,
    )
