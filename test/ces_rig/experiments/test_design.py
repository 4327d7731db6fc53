"""Design of experiments: commands as files, information, and designs within a rig's limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from iterate_examples import HOT, make_limits, make_task, sine_commands
from scipy.signal import welch

from ces_rig.errors import RigError
from ces_rig.experiments.commands import HEADER, INTERVAL_S, RigCommands, RigLimits, read_commands, write_commands
from ces_rig.experiments.designer import DesignTask, design_experiment, rows_of
from ces_rig.experiments.information import ERROR_VARIANCE, Information


def test_a_written_experiment_is_read_again(tmp_path: Path) -> None:
    commands = sine_commands()
    write_commands(tmp_path / "sine.csv", commands)
    again = read_commands(tmp_path / "sine.csv")
    assert np.abs(again.stroke_m - commands.stroke_m).max() < 1e-8
    assert np.abs(again.current_A - commands.current_A).max() < 1e-5
    assert again.name == "sine"
    assert again.duration_s == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("a,b,c\n0,0,0\n0.001,0,0\n", "first line"),
        (f"{HEADER}\n0,0,0\n0.002,0,0\n", "every 0.001 s"),
        (f"{HEADER}\n0,0,0\n0.001,x,0\n", "three numbers"),
        (f"{HEADER}\n0,0,0\n0.001,nan,0\n", "not a finite number"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, text: str, part: str) -> None:
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with pytest.raises(RigError, match=part):
        read_commands(path)


def test_the_stroke_between_grid_points_is_a_cubic_and_the_current_is_held() -> None:
    time = np.arange(101) * 1e-3
    commands = RigCommands("c", 0.01 * time**3, np.where(time < 0.05, 0.3, 0.7))
    stroke, current = commands.at(0.5e-3)
    fine = np.arange(201) * 0.5e-3
    assert np.abs(stroke - 0.01 * fine**3).max() < 1e-12
    assert set(current) == {0.3, 0.7}
    assert current[99] == 0.3
    assert current[100] == 0.7


COUNT = 12


def slow_covariance(rows: np.ndarray) -> np.ndarray:
    """Return the posterior covariance by inverting the information matrix."""
    return np.linalg.inv(np.eye(COUNT) + rows.T @ rows / ERROR_VARIANCE)


def test_added_rows_give_the_inverse_of_the_information_matrix() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.standard_normal((7, COUNT)), rng.standard_normal((5, COUNT))
    information = Information.none(COUNT).add(first).add(second)
    assert information.covariance == pytest.approx(slow_covariance(np.concatenate([first, second])), abs=1e-10)


def test_the_gain_is_the_fall_of_the_weighted_mean_variance() -> None:
    rng = np.random.default_rng(2)
    known, rows, targets = (rng.standard_normal((n, COUNT)) for n in (4, 6, 30))
    weights = rng.random(30)
    before = Information.none(COUNT).add(known)
    after = before.add(rows)
    fall = np.average(before.variance(targets) - after.variance(targets), weights=weights)
    assert before.gain(rows, before.weigh(targets, weights)) == pytest.approx(fall, rel=1e-9)


def test_more_rows_cover_more() -> None:
    rng = np.random.default_rng(3)
    targets = 0.5 * rng.standard_normal((50, COUNT))
    shares = [Information.none(COUNT).add(rng.standard_normal((n, COUNT))).coverage(targets) for n in (0, 40, 4000)]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)


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
