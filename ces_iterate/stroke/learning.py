"""Learns the command of a stroke run by run: a rig and a goal go in, the command and its history come out.

First the wanted stroke itself is commanded, at least twice: the runs' differences show the repeatability, the noise
that no learning removes. After each further run the error, weighted by how much of it repeats, updates the command.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ces_iterate.stroke.alignment import position_on_grid
from ces_iterate.stroke.errors import StrokeError
from ces_iterate.stroke.frequency_response import CommandedRun
from ces_iterate.stroke.goal import EXHAUSTED, FIRST, LEARNED, REPEATED, LearnedStroke, LearningRun, StrokeGoal
from ces_iterate.stroke.learner import StrokeLearner
from ces_iterate.stroke.probe import make_probe
from ces_iterate.stroke.rig import StrokeRig

Array = NDArray[np.float64]
OnRun = Callable[[LearningRun], None]

MOVING = 0.02  # speed at the ends of a stroke over its largest one, above which it is not at rest
SEAM = 1e-3  # distance between both ends over the largest movement of a sample, likewise


def learn_stroke(rig: StrokeRig, goal: StrokeGoal, on_run: OnRun = lambda run: None) -> LearnedStroke:
    """Return the command learned on `rig`; `on_run` is called after each run of the stroke.

    Raises StrokeError for a stroke that cannot be learned there.
    """
    require_learnable(goal)
    numbers = iter(range(2 + goal.settings.repeats + goal.settings.max_iterations))

    def run(command_m: Array, kind: str) -> LearningRun:
        return _run(rig, goal, command_m, next(numbers), kind)

    probe = _run_probe(rig, goal, numbers)
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
    return LearnedStroke(
        goal, runs, learner.best_index, stopped, learner.repeatability_m, learner.filter, learner.measured, probe
    )


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


def _run_probe(rig: StrokeRig, goal: StrokeGoal, numbers: Iterator[int]) -> CommandedRun | None:
    if goal.model is not None or goal.probe.duration_s == 0.0:
        return None
    command = make_probe(goal.probe.duration_s, goal.probe.to_Hz, goal.interval_s, goal.limits, goal.wanted_m)
    recording = rig.run(command, next(numbers))
    return CommandedRun(command, position_on_grid(recording, command, goal.interval_s), goal.interval_s)


def _run(rig: StrokeRig, goal: StrokeGoal, command_m: Array, number: int, kind: str) -> LearningRun:
    goal.limits.require_allowed(command_m, goal.interval_s, f"run {number}")
    position = position_on_grid(rig.run(command_m, number), command_m, goal.interval_s)
    return LearningRun(command_m, position, float(np.sqrt(np.mean((goal.wanted_m - position) ** 2))), kind)
