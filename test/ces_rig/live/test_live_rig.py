"""The live rig: the recorded rig's damper, its script, command, sensors, changes while it runs, and its pace."""

from dataclasses import asdict, replace
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
import yaml

from ces_rig.dampers.stepper import DamperStepper, simulate, spline_speed
from ces_rig.errors import RigError
from ces_rig.experiments.virtual import DamperDescription, load_description
from ces_rig.live.motion import BLOCK, Actuator, Script, make_loop
from ces_rig.live.rig import LiveRig, RigSettings, parse_effect, with_effects
from ces_rig.live.timing import Command, Pace
from ces_rig.sensors import GRID_S
from ces_rig.withheld import plants

COUNT = 2  # grid intervals a tick

TIME = np.arange(0, 0.5 + GRID_S / 2, GRID_S)

STROKE = 0.018 * np.clip(5 * TIME, 0, 1) ** 2 * np.sin(2 * np.pi * 4 * TIME)


def commands(low: float, high: float) -> np.ndarray:
    """Return a command [A] for each time, new at each tick only."""
    ticks = np.random.default_rng(1).uniform(low, high, (len(TIME) - 1) // COUNT)
    return np.concatenate([[low], np.repeat(ticks, COUNT)])


def driven(damper: DamperDescription, command: np.ndarray, step_s: float | None = None) -> np.ndarray:
    """Return the tared force [N] of the damper stepped tick by tick, as the live rig does."""
    stepper, speed = DamperStepper(damper.model, GRID_S, step_s), spline_speed(TIME, STROKE)
    forces = [[stepper.settle(STROKE[0], speed[0], command[0])]]
    parts = (slice(k, k + COUNT) for k in range(1, len(TIME), COUNT))
    forces.extend(stepper.advance(STROKE[part], speed[part], command[part.start]) for part in parts)
    return np.concatenate(forces) - stepper.rest_N


def described(tmp_path, kind: str) -> DamperDescription:
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump({"kind": kind}))
    return load_description(path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", plants.PLANTS)
def test_a_live_plant_equals_the_batch_with_and_without_effects_at_any_step(tmp_path, kind):
    damper = described(tmp_path, kind)
    command = commands(*damper.model.current_A)
    run = simulate(damper.model, GRID_S, STROKE, command)
    force = driven(damper, command)
    np.testing.assert_array_equal(force, run.tared_N)
    assert np.ptp(run.coil_A) > 0.5 * np.ptp(command) / 2
    rough = driven(damper, command, 1e-4 if kind == "hydraulic" else 2e-4)
    assert 0.0 < np.sqrt(np.mean((rough - force) ** 2)) < 0.01 * force.std()
    for name in ("friction", "valve_lag"):
        expected = plants.simulate_signals(damper.model, [parse_effect(name, kind)], TIME, STROKE, command).force_N
        with_it = driven(with_effects(damper, [name]), command)
        np.testing.assert_array_equal(with_it, expected, name)
        assert np.abs(with_it - force).max() > 10.0, name


def test_effects_are_given_by_name_and_numbers():
    effect = parse_effect("friction: {severity: 0.5, coulomb_N: 30}", "hydraulic")
    assert (effect.severity, effect.proportions["coulomb_N"]) == (0.5, 30.0)
    assert 1.05 < effect.proportions["static"] < 1.8
    damper = with_effects(
        DamperDescription(), ["friction: {severity: 2.0, coulomb_N: 30}", "force_offset: {offset_N: 12}"]
    )
    assert damper.model.damper.seal.coulomb_N == 28.0 + 60.0
    assert damper.sensor_effects == (("force_offset", {"offset_N": 12.0}),)


def test_a_kind_that_is_none(tmp_path):
    (tmp_path / "rig.yaml").write_text("kind: leaf_spring")
    with pytest.raises(RigError, match="kind is 'leaf_spring'; expected one of hydraulic, bouc_wen, lookup"):
        load_description(tmp_path / "rig.yaml")


QUIET = RigSettings(noise=0.0)


def positions(rig: LiveRig, seconds: float) -> np.ndarray:
    return np.array([rig.tick().position_m for _ in range(round(seconds * rig.settings.rate_hz))])


@pytest.mark.parametrize("kind", ["rest", "sine", "sweep", "noise", "triangle"])
def test_a_script_goes_on_smoothly_where_its_loop_begins_again(kind):
    loop = make_loop(Script(kind=kind, frequency_Hz=3.3, loop_s=2.0), GRID_S, 1)
    actuator = Actuator(loop, GRID_S)
    count = len(loop.stroke_m) // BLOCK + 2
    moves = [actuator.moves(BLOCK) for _ in range(count)]
    stroke, speed = (np.concatenate(part) for part in zip(*moves, strict=True))
    rounded = {"rest": 0.0, "sweep": 0.92, "triangle": 0.96}  # by the speed's limit, and at the corners
    assert np.abs(stroke).max() == pytest.approx(0.015 * rounded.get(kind, 1.0), rel=0.01)
    middle = (speed[1:] + speed[:-1]) / 2  # the speed is the stroke's, over the seam too
    assert np.diff(stroke) / GRID_S == pytest.approx(middle, abs=0.02)


def test_the_amplitude_changes_live_without_a_jump():
    rig = LiveRig(QUIET)
    before = positions(rig, 1.5)
    rig.change({"script.amplitude_m": 0.005, "script.kind": "triangle"})
    after = positions(rig, 2.0)
    assert np.abs(before).max() == pytest.approx(0.015, rel=1e-3)
    assert 0.0048 < np.abs(after[1000:]).max() < 0.005  # rounded corners
    assert np.abs(np.diff(np.append(before, after))).max() < 0.3e-3  # 0.3 m/s


def test_more_current_makes_more_force_and_silence_brings_the_safe_current_back():
    rig = LiveRig(replace(QUIET, safe_current_A=0.35, command_timeout_s=0.2))
    strong = []
    for _ in range(2000):
        rig.command.set_current(5.0, rig.time_s)
        strong.append(rig.tick().force_N)
    assert rig.coil_A == pytest.approx(1.6, abs=1e-6)  # clipped at what the valve takes
    for _ in range(190):
        rig.tick()
    assert rig.coil_A == pytest.approx(1.6, abs=1e-6)
    for _ in range(100):
        rig.tick()
    assert rig.coil_A == pytest.approx(0.35, abs=1e-3)
    weak = [rig.tick().force_N for _ in range(1000)]
    assert min(strong[1000:]) < 1.5 * min(weak)


def test_a_command_that_is_no_number_is_refused():
    command = Command((0.29, 0.7), 0.4, 0.0)
    assert command.at(0.0) == 0.4
    command.set_current(0.5, 0.0)
    command.set_current(nan, 0.1)
    command.set_current(inf, 0.1)
    assert (command.at(1e6), command.refused) == (0.5, 2)
    command.timeout_s = 1.0
    assert (command.at(0.9), command.at(1.1)) == (0.5, 0.4)


@pytest.mark.slow
def test_sensors_are_those_of_the_recorded_rig():
    rest = Script(kind="rest")
    rig = LiveRig(RigSettings(script=rest))
    samples = [rig.tick() for _ in range(20_000)]
    position = np.array([s.position_m for s in samples])
    force = np.array([s.force_N for s in samples])
    current = [s.current_A for s in samples if s.current_A is not None]
    assert position.std() == pytest.approx(np.hypot(15e-6, 12e-6 / 12**0.5), rel=0.03)
    assert position / 12e-6 == pytest.approx(np.round(position / 12e-6), abs=1e-6)
    assert force.std() == pytest.approx(np.hypot(8.0, 1 / 12**0.5), rel=0.03)
    assert len(current) == 10_000  # 500 Hz
    assert np.std(current) == pytest.approx(np.hypot(1.5e-3, 1e-3 / 12**0.5), rel=0.05)
    again = LiveRig(RigSettings(script=rest))
    assert [again.tick() for _ in range(100)] == samples[:100]
    other = LiveRig(RigSettings(script=rest, seed=2))
    assert [other.tick() for _ in range(100)] != samples[:100]
    rig.change({"dropout": 0.25, "noise": 0.0})
    lost = [rig.tick() for _ in range(8000)]
    assert sum(s.position_m is None for s in lost) == pytest.approx(2000, abs=150)
    assert any(s.position_m is None and s.force_N is not None for s in lost)


def test_effects_of_the_sensors_show_in_the_readings():
    plain, wrong = (
        LiveRig(QUIET),
        LiveRig(
            replace(
                QUIET,
                withheld=("force_offset: {offset_N: 40}", "force_scale: {gain: 0.1, asymmetry: 0}", "force_drift"),
            )
        ),
    )
    for _ in range(500):
        true, seen = plain.tick(), wrong.tick()
    drift = seen.force_N - 1.1 * (true.force_N + 40.0)
    assert 0.5 < drift < 30.0
    assert seen.position_m == true.position_m


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"script.kind": "square"}, "script: kind is 'square'; expected one of rest, sine"),
        ({"script.amplitude_m": 0.08}, r"the stroke reaches 0\.08 m; the damper's ends are at ±0\.06 m"),
        ({"vehicle.road_class": "Z"}, "road_class is 'Z'"),
        ({"noise": -1.0}, "noise is -1.0"),
        ({"rate_hz": 500}, "'rate_hz' cannot change while the rig runs; expected one of noise"),
    ],
)
def test_a_change_that_cannot_be_is_refused_and_changes_nothing(values, says):
    rig = LiveRig(QUIET)
    with pytest.raises(RigError, match=says):
        rig.change({"safe_current_A": 0.6, **values})
    assert rig.settings == QUIET
    assert rig.command.safe_A == 0.4


@pytest.mark.parametrize("rate_hz", [200, 333, 2000])
def test_any_rate_gives_the_same_stroke(rate_hz):
    rig = LiveRig(replace(QUIET, rate_hz=rate_hz))
    stroke = positions(rig, 2.0)
    late = np.arange(len(stroke) // 2, len(stroke))
    expected = 0.015 * np.sin(2 * np.pi * 2.0 * (late + 1) / rate_hz)
    assert stroke[late] == pytest.approx(expected, abs=2e-6)


def test_the_teaching_parameter_file_shows_the_defaults():
    path = Path(__file__).parents[3] / "config" / "rig_live.yaml"
    shown = yaml.safe_load(path.read_text(encoding="utf-8"))["/**"]["ros__parameters"]
    for name, value in {**asdict(RigSettings()), "withheld": [""]}.items():
        assert shown[name] == value, name


def test_pace_catches_up_and_tells_its_lag():
    pace = Pace(1e-3, 100.0)
    assert pace.count_due(100.0005) == 0
    assert pace.count_due(100.0101) == 10
    pace.mark_done(4)
    assert pace.count_due(100.0101) == 6
    assert pace.lag_s(100.0101) == pytest.approx(5.1e-3)
    assert Pace(1e-3, 0.0, factor=5.0).count_due(0.01001) == 50
