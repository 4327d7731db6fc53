"""Experiments run and repeat, seeds and settings act, mistakes cost one clear line; a rig driven with a recording."""

import numpy as np
import pytest
from dyno_measurements import steady_force

from ces_rig.dampers.hydraulic.parameters import Damper, parse_damper
from ces_rig.errors import RigError
from ces_rig.experiments.virtual import (
    find_experiment,
    load_experiment,
    load_rig,
    measure,
    packaged_experiments,
    parse_experiment,
    run,
    simulate_truth,
    with_seed,
)
from ces_rig.sensors import EPOCH_NS

SHORT = {"duration_s": 1.0, "stroke": {"kind": "noise", "peak_to_peak_m": 0.02}, "current": {"kind": "filtered_noise"}}


def short(**changes):
    return parse_experiment({**SHORT, **changes}, "e.yaml")


def same(a, b):
    return all(
        np.array_equal(a.channel(n).values, b.channel(n).values)
        and np.array_equal(a.channel(n).stamps_ns, b.channel(n).stamps_ns)
        for n in a.channels
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sine_4hz", "road", "fm_binary"])
def test_packaged_experiments_run(name):
    experiment = load_experiment(packaged_experiments()[name])
    recording = run(experiment)
    assert set(recording.channels) == {"position", "current", "force"}
    assert recording.name == name
    assert len(recording.channel("position")) == pytest.approx(1000 * experiment.settings.duration_s, abs=1)
    force = recording.channel("force").values
    assert -4500 < force.min() < -2000
    assert 500 < force.max() < 2000
    assert recording.channel("position").stamps_ns[0] == pytest.approx(EPOCH_NS + 400_000, abs=200_000)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "speed_m_s", "peak_to_peak_m"), [("sine_4hz", 0.314, 0.025), ("sweep", 0.35, 0.0245)])
def test_the_thesis_experiments_move_as_it_says_under_a_controller_inside_its_range(name, speed_m_s, peak_to_peak_m):
    experiment = load_experiment(packaged_experiments()[f"thesis/{name}"])
    true = simulate_truth(experiment)
    assert experiment.settings.name == name
    assert np.ptp(true.stroke_m) == pytest.approx(peak_to_peak_m, rel=0.01)
    assert np.abs(np.gradient(true.stroke_m, true.time_s)).max() == pytest.approx(speed_m_s, rel=0.01)
    assert 0.29 <= true.commanded_A.min() < 0.36
    assert 0.64 < true.commanded_A.max() <= 0.70


def test_a_run_repeats_and_seeds_differ():
    assert same(run(short()), run(short()))
    assert not same(run(short()), run(with_seed(short(), 2)))


def test_tare_takes_the_gas_force_away():
    tared, raw = simulate_truth(short()), simulate_truth(short(tare=False))
    assert raw.force_N - tared.force_N == pytest.approx(np.full(len(raw.time_s), 228.7), abs=0.1)
    assert abs(tared.force_N[0]) < 1.0


def test_logged_current_is_the_coil_s_or_the_command():
    base = {"noise": 0.0, "quantum": 0.0}
    binary = {"kind": "binary"}
    true = simulate_truth(short(current=binary))
    coil = measure(short(current=binary, sensors={"current": base}), true).channel("current").values
    command = measure(short(current=binary, sensors={"current": base, "current_source": "commanded"}), true)
    assert np.isin(np.round(command.channel("current").values, 3), (0.29, 0.7)).mean() > 0.97
    assert np.max(np.abs(coil - command.channel("current").values)) > 0.1


def test_temperature_is_logged_on_demand():
    channel = run(short(sensors={"log_temperature": True})).channel("temperature")
    assert (channel.unit, len(channel)) == ("degC", 11)
    assert channel.values == pytest.approx(np.full(11, 40.0), abs=1.5)


def test_damper_by_file_beside_the_experiment_or_in_place(tmp_path):
    (tmp_path / "d.yaml").write_text("seal: {coulomb_N: 60.0, static_N: 80.0}\n")
    path = tmp_path / "e.yaml"
    path.write_text("stroke: {kind: rest}\ncurrent: {kind: constant, current_A: 0.5}\ndamper: d.yaml\n")
    expected = parse_damper({"seal": {"coulomb_N": 60.0, "static_N": 80.0}}, "x")
    assert load_experiment(path).damper == expected
    assert short(damper={"seal": {"coulomb_N": 60.0, "static_N": 80.0}}).damper == expected


def test_a_stroke_beyond_the_damper_is_refused():
    with pytest.raises(RigError, match=r"the stroke reaches 0\.07 m; the damper's ends are at ±0\.06 m"):
        run(short(stroke={"kind": "sine", "amplitude_m": 0.07, "frequency_Hz": 1.25}, duration_s=3.0))


def test_missing_parts_and_files():
    with pytest.raises(RigError, match="'current' is missing"):
        parse_experiment({"stroke": {"kind": "rest"}}, "e.yaml")
    with pytest.raises(RigError, match="no such file or packaged experiment; packaged are characterise, fm_binary"):
        find_experiment("sine_5hz")
    assert find_experiment("sweep") == packaged_experiments()["sweep"]


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
