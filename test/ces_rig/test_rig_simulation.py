"""load_rig: the damper driven with what was recorded comes close to the measured force."""

import numpy as np
import pytest
from dyno_measurements import steady_force

from bench.thesis.costs import cost, noise_floors, simulate_driven
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.errors import RigError
from ces_rig.experiment import (
    load_experiment,
    load_rig,
    measure,
    packaged_experiments,
    parse_experiment,
    simulate_truth,
)


@pytest.mark.parametrize("name", ["sine_4hz", "road"])
def test_noise_floor_and_the_damper_itself(name):
    floor, itself = noise_floors(load_experiment(packaged_experiments()[name]))
    assert 0.3 < floor < 1.0
    assert floor < itself < 2 * floor


def test_a_wrong_damper_costs_more_than_the_right_one():
    experiment = load_experiment(packaged_experiments()["sine_4hz"])
    recording = measure(experiment, simulate_truth(experiment))
    given = {
        "stroke": {"kind": "rest"},
        "current": {"kind": "stroke_following"},
        "damper": {"mount": {"stiffness_N_m": 1e6}},
    }
    force = recording.channel("force").values
    wrong = cost(force, simulate_driven(parse_experiment(given, "x"), recording))
    assert wrong > 3 * cost(force, simulate_driven(experiment, recording))


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("seal: {coulomb_N: 28.0}\n")
    return load_rig(path)


def test_a_slow_stroke_gives_the_steady_force(rig):
    time = np.sort(np.random.default_rng(1).uniform(0, 0.4, 500))
    force = rig(time, -0.04 + 0.2 * time, np.full(500, 0.5))
    middle = float(np.interp(0.2, time, force))
    assert force.shape == time.shape
    assert middle == pytest.approx(steady_force(Damper(), 0.2, 0.5), rel=0.02)


def test_measured_current_is_not_lagged_twice(tmp_path):
    texts = {"measured": "", "commanded": "sensors: {current_source: commanded}\n"}
    base = "stroke: {kind: rest}\ncurrent: {kind: constant, current_A: 0.5}\n"
    forces = {}
    time = np.arange(0, 0.3, 1e-3)
    for name, text in texts.items():
        path = tmp_path / f"{name}.yaml"
        path.write_text(base + text)
        forces[name] = load_rig(path)(time, 0.03 - 0.2 * time, np.where(time < 0.15, 0.29, 0.70))
    after = (time > 0.15) & (time < 0.17)
    assert forces["measured"][after].mean() < forces["commanded"][after].mean() - 50.0
    assert forces["measured"][-1] == pytest.approx(forces["commanded"][-1], rel=0.01)


def test_unordered_and_repeated_times_are_put_in_order(rig):
    time = np.arange(0, 0.3, 1e-3)
    position, current = 0.01 * np.sin(30 * time), np.full(300, 0.5)
    order = np.random.default_rng(1).permutation(300)
    force = rig(time, position, current)
    assert rig(time[order], position[order], current[order]) == pytest.approx(force[order])
    twice = np.repeat(np.arange(300), 2)
    assert rig(time[twice], position[twice], current[twice])[::2] == pytest.approx(force)


@pytest.mark.parametrize(
    ("time", "position", "says"),
    [
        (np.arange(3) * 0.1, np.zeros(3), "3 samples; expected at least 10"),
        (np.zeros(100), np.zeros(100), "1 samples; expected at least 10"),
        (np.arange(100) * 1e-3, np.zeros(99), "expected equal"),
        (np.arange(100) * 1e-3, np.where(np.arange(100) == 7, np.nan, 0.0), "position sample 7 is not finite"),
        (np.arange(100) * 1e-3, np.full(100, 0.3), "the damper's ends are at ±0.06 m"),
    ],
)
def test_what_cannot_be_used_is_refused(rig, time, position, says):
    with pytest.raises(RigError, match=says):
        rig(time, position, np.full(len(time), 0.5))
