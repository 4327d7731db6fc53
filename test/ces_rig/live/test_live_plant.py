"""A live plant is the recorded rig's damper: the same commands give the same forces, of every kind."""

import numpy as np
import pytest
import yaml

from ces_rig.dampers.stepper import DamperStepper, simulate, spline_speed
from ces_rig.errors import RigError
from ces_rig.experiment import (
    DamperDescription,
    load_description,
    load_experiment,
    packaged_experiments,
    simulate_truth,
)
from ces_rig.live.rig import CommandDelay, LiveRig, RigSettings, parse_effect, with_effects
from ces_rig.sensors import GRID_S
from ces_rig.withheld import plants

COUNT = 2  # grid intervals a tick
ROUNDING_N = {
    "hydraulic": 0.0,
    "bouc_wen": 0.0,
    "calibration": 1e-9,
    "monotube": 0.0,
}  # the last has a dead time to interpolate
TIME = np.arange(0, 0.5 + GRID_S / 2, GRID_S)
STROKE = 0.018 * np.clip(5 * TIME, 0, 1) ** 2 * np.sin(2 * np.pi * 4 * TIME)


def commands(low: float, high: float) -> np.ndarray:
    """Return a command [A] for each time, new at each tick only."""
    ticks = np.random.default_rng(1).uniform(low, high, (len(TIME) - 1) // COUNT)
    return np.concatenate([[low], np.repeat(ticks, COUNT)])


def driven(damper: DamperDescription, command: np.ndarray, step_s: float | None = None) -> np.ndarray:
    """Return the tared force [N] of the damper stepped tick by tick, as the live rig does."""
    stepper, speed = DamperStepper(damper.model, GRID_S, step_s), spline_speed(TIME, STROKE)
    dead_time = CommandDelay(damper.model.delay_s / GRID_S, COUNT, command[0])
    forces = [[stepper.settle(STROKE[0], speed[0], command[0])]]
    for k in range(1, len(TIME), COUNT):
        late = dead_time.after(command[k])
        forces.append(stepper.advance(STROKE[k : k + COUNT], speed[k : k + COUNT], command[k], late))
    return np.concatenate(forces) - stepper.rest_N


def described(tmp_path, kind: str) -> DamperDescription:
    path = tmp_path / "rig.yaml"
    given = {"kind": kind} | ({"delay_s": 0.0033} if kind == "calibration" else {})
    path.write_text(yaml.safe_dump(given))
    return load_description(path)


@pytest.mark.parametrize("kind", plants.PLANTS)
def test_a_live_plant_equals_the_batch(tmp_path, kind):
    damper = described(tmp_path, kind)
    command = commands(*damper.model.current_A)
    run = simulate(damper.model, GRID_S, STROKE, command)
    assert np.abs(driven(damper, command) - run.tared_N).max() <= ROUNDING_N[kind]
    assert np.ptp(run.coil_A) > 0.5 * np.ptp(command) / 2


@pytest.mark.parametrize("kind", plants.PLANTS)
def test_twice_the_step_stays_within_the_integrators_tolerance(tmp_path, kind):
    damper = described(tmp_path, kind)
    command = commands(*damper.model.current_A)
    force = driven(damper, command)
    rough = driven(damper, command, 1e-4 if kind == "hydraulic" else 2e-4)
    assert 0.0 < np.sqrt(np.mean((rough - force) ** 2)) < 0.01 * force.std()


@pytest.mark.parametrize("kind", plants.PLANTS)
@pytest.mark.parametrize("name", ["friction", "valve_lag"])
def test_withheld_effects_are_those_of_the_blind_test(tmp_path, kind, name):
    damper = described(tmp_path, kind)
    command = commands(*damper.model.current_A)
    expected = plants.simulate_signals(damper.model, [parse_effect(name, kind)], TIME, STROKE, command).force_N
    with_it = driven(with_effects(damper, [name]), command)
    assert np.abs(with_it - expected).max() <= ROUNDING_N[kind]
    assert np.abs(with_it - driven(damper, command)).max() > 10.0


def test_an_experiment_live_equals_the_recorded_one():
    experiment = load_experiment(packaged_experiments()["noise"])
    true = simulate_truth(experiment)
    first = {"safe_current_A": true.commanded_A[0], "command_timeout_s": 0.0}
    rig = LiveRig(RigSettings(drive="experiment", experiment="noise", noise=0.0, rate_hz=2000, **first))
    forces, strokes, coils = [], [], []
    for k in range(1, 4000):
        rig.command.set_current(true.commanded_A[k], rig.time_s)
        sample = rig.tick()
        forces.append(sample.force_N)
        strokes.append(sample.position_m)
        coils.append(rig.coil_A)
    assert np.array_equal(strokes, true.stroke_m[1:4000])
    assert np.array_equal(coils, true.coil_A[1:4000])
    assert np.array_equal(forces, true.force_N[1:4000])
    assert true.force_N[:4000].std() > 300.0


def test_effects_are_given_by_name_and_numbers():
    effect = parse_effect("friction: {severity: 0.5, coulomb_N: 30}", "hydraulic")
    assert (effect.severity, effect.proportions["coulomb_N"]) == (0.5, 30.0)
    assert 1.05 < effect.proportions["static"] < 1.8
    damper = with_effects(
        DamperDescription(), ["friction: {severity: 2.0, coulomb_N: 30}", "force_offset: {offset_N: 12}"]
    )
    assert damper.model.damper.seal.coulomb_N == 28.0 + 60.0
    assert damper.sensor_effects == (("force_offset", {"offset_N": 12.0}),)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("frction", "no effect 'frction' on a live hydraulic damper; expected one of friction,"),
        ("cell_resonance", "no effect 'cell_resonance'"),
        ("foaming", "no effect 'foaming'"),
        ("friction: {coulomb: 3}", "unknown key 'coulomb'; known are severity, coulomb_N"),
        ("friction: {severity: -1}", "severity -1.0; expected a number of at least 0"),
        ("friction: 3", "expected a name, or for example"),
        ("friction: {severity: high}", "expected a name, or for example"),
        ("[", "expected a name, or for example"),
        ("inertia: {severity: 1000}", "moving_mass_kg is"),
    ],
)
def test_mistakes_in_effects_are_one_line(text, says):
    with pytest.raises(RigError, match=says) as caught:
        with_effects(DamperDescription(), [text])
    assert "\n" not in str(caught.value)


def test_a_kind_that_is_none(tmp_path):
    (tmp_path / "rig.yaml").write_text("kind: leaf_spring")
    with pytest.raises(RigError, match="kind is 'leaf_spring'; expected one of hydraulic, bouc_wen, calibration"):
        load_description(tmp_path / "rig.yaml")
