"""Designed experiments keep every limit, repeat exactly, suit the actuator, and teach more than random ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from iterate_examples import HOT, make_limits, make_task
from scipy.signal import welch

from ces_rig.errors import RigError
from ces_rig.experiments.commands import INTERVAL_S, RigCommands, RigLimits
from ces_rig.experiments.designer import DesignTask, design_experiment, rows_of

pytestmark = pytest.mark.slow
BOXES = [
    make_limits(),
    make_limits(centre_m=0.05, stroke_m=0.004),
    make_limits(speed_m_s=0.1),
    make_limits(acceleration_m_s2=5.0),
    make_limits(frequency_Hz=2.0, speed_m_s=3.0, acceleration_m_s2=400.0),
    make_limits(low_A=0.5, high_A=0.5),
]


def design(task: DesignTask, seed: int = 1, duration_s: float = 6.0, candidates: int = 30) -> RigCommands:
    return design_experiment(task, "designed", duration_s, seed, candidates)


@pytest.mark.parametrize("limits", BOXES)
def test_no_limit_is_left_and_the_ends_are_at_rest_in_the_centre(limits: RigLimits) -> None:
    commands = design(make_task(limits)[0], candidates=8)
    assert list(limits.excess(commands)) == []
    assert commands.duration_s == pytest.approx(6.0)
    speed, _ = commands.motion()
    assert commands.stroke_m[[0, -1]] == pytest.approx(limits.centre_m, abs=1e-6)
    assert speed[[0, -1]] == pytest.approx(0.0, abs=1e-2)


def test_the_same_seed_gives_the_same_experiment_and_another_seed_another() -> None:
    task, _ = make_task(make_limits())
    first, again, other = design(task), design(task), design(task, seed=2)
    assert np.array_equal(first.stroke_m, again.stroke_m)
    assert np.array_equal(first.current_A, again.current_A)
    assert not np.array_equal(first.stroke_m, other.stroke_m)


@pytest.mark.parametrize("highest_Hz", [4.0, 12.0])
def test_the_actuator_can_follow_the_spectrum(highest_Hz: float) -> None:
    """At most 1 % of the speed's power is above one and a half times the band."""
    commands = design(make_task(make_limits(frequency_Hz=highest_Hz))[0], duration_s=12.0)
    frequency, power = welch(commands.motion()[0], 1.0 / INTERVAL_S, nperseg=2048)
    assert power[frequency > 1.5 * highest_Hz].sum() < 0.01 * power.sum()


def test_a_designed_experiment_teaches_more_than_random_ones() -> None:
    task, _ = make_task(make_limits())

    def left(commands: RigCommands) -> float:
        information = task.information.add(rows_of(commands.stroke_m, commands.current_A, task.limits, task.features))
        return float(information.variance(task.targets).mean())

    random = [left(design(task, seed, candidates=1)) for seed in range(1, 6)]
    assert left(design(task)) < 0.7 * np.median(random)


def test_what_is_known_already_is_not_visited_again() -> None:
    """With all targets of weight at low current, the current stays lower than with all of them at high current."""
    task, pool = make_task(make_limits())
    middle = 0.5 * (task.limits.low_A + task.limits.high_A)
    means = [
        design(replace(task, weights=np.where(wanted, 1.0, 1e-6))).current_A.mean()
        for wanted in (pool.current_A < middle, pool.current_A > middle)
    ]
    assert means[0] < middle < means[1]


def test_every_current_meets_every_speed() -> None:
    """In each third of the current's range the damper moves fast and slowly, in both directions."""
    commands = design(make_task(make_limits())[0], duration_s=15.0)
    speed = commands.motion()[0] / 0.7
    thirds = np.minimum(3 * (commands.current_A - 0.2) / 1.4, 2.99).astype(int)
    for third in range(3):
        here = speed[thirds == third]
        assert min(np.mean(here > 0.15), np.mean(here < -0.15), np.mean(np.abs(here) < 0.15)) > 0.05


def test_heat_limits_the_power() -> None:
    cool, hot = make_limits(), make_limits(heat=HOT)
    task, _ = make_task(hot)
    commands = design(task)
    power = HOT.force_N * np.abs(commands.motion()[0])
    assert HOT.load_after(0.0, power, INTERVAL_S).max() <= HOT.power_W
    free = design(make_task(cool)[0]).motion()[0]
    assert np.abs(commands.motion()[0]).mean() < np.abs(free).mean()


def test_a_damper_that_is_too_hot_is_refused_in_one_line() -> None:
    task, _ = make_task(make_limits(heat=HOT), load_W=1000.0)
    with pytest.raises(RigError, match="no motion keeps the limits"):
        design(task, candidates=3)
