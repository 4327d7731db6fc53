"""Iterative learning of a stroke: settings and the goal go in; the rig is probed and run until its error is small."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ces_data.arrays import F
from ces_iterate.errors import StrokeError
from ces_iterate.stroke.actuator import ActuatorModel, CommandedRun, ComplexArray, identify_actuator, measure_response
from ces_iterate.stroke.learning_filter import LearningFilter, design_filter
from ces_iterate.stroke.limits import NAMES, StrokeLimits, measure_peaks, project_command
from ces_iterate.stroke.rigs import StrokeRig, position_on_grid
from ces_observer.fields import quantity
from ces_rig.drive.strokes import fade

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
    model_tolerance: float = quantity(0.3, "1", "share by which the model may be wrong", 0.0, 0.6)
    step_m: float = quantity(0.020, "m", "largest change of the command from run to run", 1e-6, 0.5)


@dataclass(frozen=True)
class StrokeGoal:
    """The wanted stroke [m] (n,) on a grid of `interval_s`, and how its command may be learned."""

    wanted_m: F
    interval_s: float
    limits: StrokeLimits
    settings: LearningSettings = field(default_factory=LearningSettings)
    probe: ProbeSettings = field(default_factory=ProbeSettings)
    model: ActuatorModel | None = None


@dataclass(frozen=True)
class LearningRun:
    """One run of the stroke: command and position (n,), the RMS error [m], and how the command came about."""

    command_m: F
    position_m: F
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
    names, highest = (f"{name} [{unit}]" for name, unit in NAMES.items()), map(float, all_peaks.max(axis=0))
    yield from zip(names, wanted, highest, goal.limits.as_tuple(), strict=True)


FROM_HZ = 0.5
FADE_S = 0.5
SHARE = 0.7  # of each limit that the probe uses at most
SEED = 1


def make_probe(duration_s: float, to_Hz: float, interval_s: float, limits: StrokeLimits, like_m: F) -> F:
    """Return a command (n,) that starts and ends at the start of the wanted stroke `like_m` (m,).

    Every line of the spectrum up to `to_Hz` has a random phase and an amplitude that falls as 1/frequency, so that the
    speed is alike at all frequencies. It is scaled to the RMS speed of the wanted stroke, because the damper's force
    and so the actuator's answer depend on the speed, but to at most SHARE of the limits.
    """
    time = np.arange(round(duration_s / interval_s) + 1, dtype=np.float64) * interval_s
    first, last = round(FROM_HZ * duration_s), round(to_Hz * duration_s)
    lines = np.zeros(len(time) // 2 + 1, dtype=np.complex128)
    phases = np.random.default_rng(SEED).uniform(0.0, 2.0 * np.pi, last + 1 - first)
    lines[first : last + 1] = np.exp(1j * phases) / np.arange(first, last + 1)
    waves = np.resize(np.fft.irfft(lines, len(time) - 1), len(time))
    shape = (waves - waves.mean()) * fade(time, FADE_S)
    start = float(like_m[0])
    room = StrokeLimits(limits.stroke_m - abs(start), limits.speed_m_s, limits.acceleration_m_s2)
    peaks = measure_peaks(shape, interval_s)
    allowed = min(SHARE * limit / peak for limit, peak in zip(room.as_tuple(), peaks, strict=True))
    alike = float(np.std(np.diff(like_m)) / np.std(np.diff(shape)))
    return np.asarray(start + min(allowed, alike) * shape)


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
        self._design()
        self.scale, self.stopped, self._idle = 1.0, "", 0
        self.best_index = min(range(len(first)), key=lambda n: first[n].error_m)
        self.repeatability_m = find_repeatability(first)
        size = len(goal.wanted_m) + round(PAD_S / goal.interval_s)
        self._size = size + size % 2
        self._frequency: F = np.asarray(np.fft.rfftfreq(self._size, goal.interval_s), dtype=np.float64)
        half = np.maximum(SMOOTHING_HZ, SMOOTHING * self._frequency) / 2.0
        self._low = np.searchsorted(self._frequency, self._frequency - half)  # lines that are smoothed together
        self._high = np.maximum(np.searchsorted(self._frequency, self._frequency + half, side="right"), self._low + 1)
        mean = np.mean([run.position_m for run in first], axis=0)
        powers = sum(np.abs(self._spectrum(run.position_m - mean)) ** 2 for run in first)
        self._noise = self._smooth(np.asarray(powers) / (len(first) - 1))  # of what differs between equal runs
        self._check_progress(first[self.best_index])

    @property
    def best(self) -> LearningRun:
        """The run with the smallest error so far."""
        return self.runs[self.best_index]

    def next_command(self) -> tuple[F, float]:
        """Return the next command (n,), inside the limits, and the share of it that they changed."""
        goal, run = self.goal, self.best
        error = self._spectrum(goal.wanted_m - run.position_m)
        power = self._smooth(np.abs(error) ** 2)
        repeating = np.clip(1.0 - self._noise / np.maximum(power, 1e-300), 0.0, 1.0)  # share of the power (Wiener)
        change = self.scale * repeating * self.filter.learning(self._frequency) * error
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
            # What differs from the run that it was learned from, without what repeats. The noise of that run is in both
            # differences: where it matters the update was small, and its ratio to the position's change implausible.
            change = run.command_m - best.command_m, run.position_m - best.position_m
            self._seen.append([CommandedRun(*change, self.goal.interval_s)])
            self._design()
        if run.error_m > GROWTH * best.error_m + GROWTH_NOISE * self.repeatability_m:
            self.scale /= 2.0
            self._idle += 1
            self.stopped = DIVERGED if self.scale < MIN_SCALE else ""
            return
        self._idle = 0 if run.error_m < PROGRESS * best.error_m else self._idle + 1
        if run.error_m < best.error_m:
            self.best_index = len(self.runs) - 1
        self._check_progress(self.best)

    def _design(self) -> None:
        """Measure the response from all runs so far and design the filter anew; a model is fitted once."""
        goal = self.goal
        if self.model is None:
            self.model, measured = identify_actuator(self._seen, goal.probe.to_Hz)
        else:
            measured = measure_response(self._seen, goal.probe.to_Hz, self.model)
        self.filter = design_filter(self.model, measured, goal.settings.model_tolerance, goal.probe.to_Hz)

    def _check_progress(self, best: LearningRun) -> None:
        if best.error_m <= self.goal.settings.stop_at * self.repeatability_m:
            self.stopped = CONVERGED
        elif self._idle >= PATIENCE:
            self.stopped = STALLED

    def _spectrum(self, signal: F) -> ComplexArray:
        return np.asarray(np.fft.rfft(signal, self._size))

    def _smooth(self, power: F) -> F:
        total = np.concatenate([[0.0], np.cumsum(power)])
        return np.asarray((total[self._high] - total[self._low]) / (self._high - self._low))


MOVING = 0.02  # speed at the ends of a stroke over its largest one, above which it is not at rest
SEAM = 1e-3  # distance between both ends over the largest movement of a sample, likewise


def learn_stroke(
    rig: StrokeRig, goal: StrokeGoal, on_run: Callable[[LearningRun], None] = lambda run: None
) -> LearnedStroke:
    """Return the command learned on `rig`; `on_run` is called after each run of the stroke.

    Raises StrokeError for a stroke that cannot be learned there.
    """
    require_learnable(goal)
    numbers = iter(range(2 + goal.settings.repeats + goal.settings.max_iterations))

    def run(command_m: F, kind: str) -> LearningRun:
        number = next(numbers)
        goal.limits.require_allowed(command_m, goal.interval_s, f"run {number}")
        position = position_on_grid(rig.run(command_m, number), command_m, goal.interval_s)
        return LearningRun(command_m, position, float(np.sqrt(np.mean((goal.wanted_m - position) ** 2))), kind)

    probe = None
    if goal.model is None and goal.probe.duration_s > 0.0:
        command = make_probe(goal.probe.duration_s, goal.probe.to_Hz, goal.interval_s, goal.limits, goal.wanted_m)
        position = position_on_grid(rig.run(command, next(numbers)), command, goal.interval_s)
        probe = CommandedRun(command, position, goal.interval_s)
    first = [run(goal.wanted_m, FIRST) for _ in range(goal.settings.repeats)]
    for one in first:
        on_run(one)
    learner = StrokeLearner(goal, probe, first)
    while not learner.stopped and len(learner.runs) < len(first) + goal.settings.max_iterations:
        command, limited = learner.next_command()
        learner.add(replace(run(command, LEARNED), scale=learner.scale, limited=limited))
        on_run(learner.runs[-1])
    confirmation = run(learner.best.command_m, REPEATED)
    on_run(confirmation)
    runs, stopped = (*learner.runs, confirmation), learner.stopped or EXHAUSTED
    return LearnedStroke(goal, runs, learner.best_index, stopped, learner.repeatability_m, learner.filter, probe)


def require_learnable(goal: StrokeGoal) -> None:
    """Raise StrokeError for a wanted stroke that breaks the limits or does not begin and end at rest in one place."""
    goal.limits.require_allowed(goal.wanted_m, goal.interval_s, "wanted stroke")
    steps = np.abs(np.diff(goal.wanted_m))
    seam = SEAM * abs(float(goal.wanted_m[-1] - goal.wanted_m[0]))
    if max(float(steps[0]), float(steps[-1]), seam) > MOVING * steps.max() or steps.max() == 0.0:
        raise StrokeError(
            "wanted stroke: does not begin and end at rest in one place, or does not move; "
            "set its fade_s (0.5 s), or add rest to its file"
        )
