"""Diagnoses on measured data: cases, how they are judged, independent values, changes put into recordings."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.gaps.effects import (
    CHANGES,
    delay_channel,
    read_friction,
    read_loop_stiffness,
    read_offset,
    read_play,
    read_valve_delay,
)
from bench.gaps.real_cases import Data, between
from bench.gaps.real_gaps import DOUBT, NOTHING, PARTLY, RIGHT, WRONG, all_cases, diagnose_case, judge
from bench.gaps.simulations import (
    BandBrake,
    Bingham,
    CurrentMap,
    SpeedPolynomial,
    StaticMap,
    find_settled,
    stop_operator,
)
from ces_data.recording import Channel, Recording
from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN
from ces_gap.inference.verdict import CALIBRATION, TIMING

DATA = Path(os.environ.get("CES_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
measured = pytest.mark.skipif(not DATA.is_dir(), reason=f"measured recordings are not in {DATA} (set CES_DATA)")

RATE_HZ, SECONDS = 1000.0, 8.0
TIME = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
OMEGA = 2.0 * np.pi * 0.5


def recording(position, current, force):
    stamps = np.round(1e9 * TIME).astype(np.int64)
    values = {"position": (position, "m"), "current": (current, "A"), "force": (force, "N")}
    return Recording("made", {n: Channel(n, unit, stamps, v) for n, (v, unit) in values.items()})


def put(effect, before):
    return next(c for c in CHANGES if c.effect == effect).apply(before)


def values(of, name):
    return of.channel(name).values


@pytest.fixture
def sine():
    position = 0.02 * np.sin(OMEGA * TIME)
    return recording(position, np.sin(OMEGA * TIME), 300.0 * np.sign(np.cos(OMEGA * TIME)))


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    return all_cases(Data(DATA, tmp_path_factory.mktemp("bags")))


@measured
def test_the_play_of_a_real_brake_is_named_without_references(cases):
    found = diagnose_case(cases["brake_0.25"])
    assert (found.verdict, found.composition.effects) == (NAMED, ("backlash",))
    play_m = found.composition.estimates[0][0].value
    assert play_m == pytest.approx(read_play(cases["brake_0.25"].prepare()[1][0]), rel=0.4)
    assert found.composition.shrink > 0.3


@measured
def test_the_friction_of_a_real_damper_is_named_without_references(cases):
    case = cases["0A_viscous_slow"]
    found = diagnose_case(case)
    assert judge(case.causes, found.verdict, found.composition.effects) == RIGHT
    assert "friction" in found.composition.effects


@measured
def test_every_measured_recording_is_in_the_table(cases):
    folders = ("brfd_backlash", "utfsm_mr", "dyke_mr")
    logs = {p.stem for folder in folders for p in (DATA / folder).iterdir() if p.suffix in (".csv", ".json")}
    assert {log for case in cases.values() for log in case.logs} == logs


@pytest.mark.parametrize(
    "causes, verdict, effects, expected",
    [
        (("friction",), NAMED, ("friction",), RIGHT),
        (("friction",), NAMED, ("friction", CALIBRATION), RIGHT),
        (("friction",), NAMED, ("inertia", "friction"), PARTLY),
        (("friction",), NAMED, ("inertia",), WRONG),
        (("friction",), AMBIGUOUS, ("inertia",), DOUBT),
        (("friction",), AMBIGUOUS, ("friction",), PARTLY),
        (("friction",), UNKNOWN, ("friction",), NOTHING),
        (("friction",), NO_GAP, (), NOTHING),
        ((), NO_GAP, (), RIGHT),
        ((), NAMED, (CALIBRATION, TIMING), RIGHT),
        ((), NAMED, ("friction",), WRONG),
    ],
)
def test_a_name_is_judged_by_what_is_missing(causes, verdict, effects, expected):
    assert judge(causes, verdict, effects) == expected


def test_a_brake_with_play_has_a_loop_with_that_play():
    brake = BandBrake(8000.0, 9000.0, 2e6, play_m=0.004)
    position = 0.02 * np.sin(OMEGA * TIME)
    assert read_play(recording(position, 0.0 * TIME, brake(TIME, position, 0.0 * TIME))) == pytest.approx(
        0.004 + 2 * 0.1 * 8500.0 / 2e6, rel=0.05
    )


def test_friction_and_offset_are_read_from_a_loop():
    position = 0.02 * np.sin(OMEGA * TIME)
    speed = 0.02 * OMEGA * np.cos(OMEGA * TIME)
    made = recording(position, 0.0 * TIME, 40.0 + 900.0 * speed + 120.0 * np.sign(speed))
    assert read_friction(made) == pytest.approx(120.0, rel=0.02)
    assert read_offset(made) == pytest.approx(40.0, abs=1.0)
    viscous, coulomb = (SpeedPolynomial.fit_sliding(made, friction) for friction in (False, True))
    assert (viscous.offset_N, viscous.linear_Ns_m, viscous.friction_N) == pytest.approx((40.0, 900.0, 0.0), rel=0.02)
    assert coulomb.friction_N == pytest.approx(120.0, rel=0.02)


def test_the_stiffness_of_a_loop_is_that_of_the_spring_before_it_slides():
    position = 0.02 * np.sin(OMEGA * TIME)
    made = recording(position, 0.0 * TIME, stop_operator(position, 2e6, -800.0, 800.0))
    assert read_loop_stiffness(made) == pytest.approx(2e6, rel=0.1)


def test_maps_of_speed_and_current_reproduce_what_they_can_hold():
    position = 0.02 * np.sin(OMEGA * TIME)
    speed = 0.02 * OMEGA * np.cos(OMEGA * TIME)
    made = [
        recording(position, 0.0 * TIME + i, 40.0 + (300.0 + 700.0 * i) * speed + 200.0 * i * np.tanh(200.0 * speed))
        for i in (0.0, 0.5, 1.0)
    ]
    for model in (Bingham.fit(made), CurrentMap.fit(made)):
        simulated = model(TIME, position, 0.0 * TIME + 0.5)
        assert simulated[200:-200] == pytest.approx(values(made[1], "force")[200:-200], abs=8.0)


def test_the_delay_of_a_control_is_read_from_a_damper_with_a_late_control():
    dice = np.random.default_rng(1)
    voltage = np.repeat(dice.integers(0, 2, int(SECONDS / 0.2)), int(0.2 * RATE_HZ)) * 2.0
    position = 0.02 * np.sin(2.0 * np.pi * TIME) + 0.005 * np.sin(2.0 * np.pi * 2.7 * TIME)
    late = values(delay_channel(recording(position, voltage, position), "current", 0.006), "current")
    assert read_valve_delay(
        recording(position, voltage, 1000.0 * np.gradient(position, TIME) * (1.0 + late))
    ) == pytest.approx(0.006, abs=1e-3)


def test_a_brake_is_fitted_past_its_play():
    stiffness, play = 2e6, 0.004
    stretched = stop_operator(
        0.02 * np.sin(OMEGA * TIME), 1.0, -9000.0 / stiffness - play / 2, 8000.0 / stiffness + play / 2
    )
    force = stiffness * np.sign(stretched) * np.maximum(np.abs(stretched) - play / 2, 0.0)
    brake = BandBrake.fit(recording(0.02 * np.sin(OMEGA * TIME), np.zeros_like(TIME), force))
    assert (brake.push_N, brake.pull_N) == pytest.approx((8000.0, 9000.0), rel=1e-6)
    assert brake.stiffness_N_m == pytest.approx(stiffness, rel=0.05)


def test_a_map_is_fitted_where_the_voltage_has_settled():
    dice = np.random.default_rng(1)
    voltage = np.repeat(dice.integers(0, 2, int(SECONDS / 0.2)), int(0.2 * RATE_HZ)) * 2.0
    position = 0.02 * np.sin(2.0 * np.pi * TIME) + 0.005 * np.sin(2.0 * np.pi * 2.7 * TIME)
    speed = np.gradient(position, TIME)
    late = delay_channel(recording(position, voltage, speed), "current", 0.02).channel("current").values
    made = recording(position, voltage, 1000.0 * speed * (1.0 + late))
    static = StaticMap.fit(made)(TIME, position, voltage)
    assert static[200:-200] == pytest.approx((1000.0 * speed * (1.0 + voltage))[200:-200], abs=30.0)
    steady = find_settled(voltage, 40, 0.2)
    assert 0.5 < steady.mean() < 0.9
    assert np.abs(static - made.channel("force").values)[steady].max() < 100.0


def test_friction_resists_and_has_the_size_it_says(sine):
    added = values(put("friction", sine), "force") - values(sine, "force")
    moving = np.abs(np.cos(OMEGA * TIME)) > 0.7
    assert np.abs(added)[moving & (TIME > 1.0)] == pytest.approx(200.0, rel=1e-6)
    assert (np.sign(added) == np.sign(np.cos(OMEGA * TIME)))[moving & (TIME > 1.0)].all()


def test_a_mass_adds_its_inertia(sine):
    added = values(put("inertia", sine), "force") - values(sine, "force")
    assert added[100:-100] == pytest.approx(12.0 * -(OMEGA**2) * 0.02 * np.sin(OMEGA * TIME[100:-100]), abs=0.05)


def test_a_late_position_and_an_early_voltage(sine):
    position, current = values(put("position_delay", sine), "position"), values(put("valve_lag", sine), "current")
    assert position[100:-100] == pytest.approx(0.02 * np.sin(OMEGA * (TIME[100:-100] - 1.2e-3)), abs=1e-6)
    assert current[100:-100] == pytest.approx(np.sin(OMEGA * (TIME[100:-100] + 8e-3)), abs=1e-4)


def test_a_change_leaves_the_other_channels_and_forgets_the_source(sine):
    changed = put("force_scale", replace(sine, source="bag", sha256="0" * 64))
    assert values(changed, "force") == pytest.approx(1.2 * values(sine, "force"))
    assert all((values(changed, n) == values(sine, n)).all() for n in ("position", "current"))
    assert (changed.source, changed.sha256) == ("", "")


def test_parts_of_a_recording_do_not_overlap(sine):
    parts = [between(sine, a, a + 2.0) for a in (0.0, 2.0, 4.0, 6.0)]
    assert sum(len(p.channel("force")) for p in parts) == len(TIME)
    assert parts[1].channel("current").stamps_ns[0] == 2_000_000_000
