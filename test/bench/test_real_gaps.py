"""Diagnoses on measured data, and the changes that bench/gaps/real_gaps.py puts into recordings."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.gaps import real_gaps
from bench.gaps.effects import CHANGES, delay_channel
from bench.gaps.simulations import BandBrake, StaticMap, find_settled, stop_operator
from ces_gap.diagnosis import AMBIGUOUS, NAMED
from ces_identify.recordings.recording import Channel, Recording

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


@measured
def test_a_real_brake_with_play_is_distinguished_from_a_brake_without_play(tmp_path):
    found = real_gaps.brake_without_play(real_gaps.Data(DATA, tmp_path), real_gaps.BRFD_OTHER)
    assert (found.verdict, found.composition.effects) == (NAMED, ("backlash",))
    play_m = found.composition.estimates[0][0].value
    assert 0.0034 < play_m < 0.0052  # from 3.4 mm on the loops have left a tenth of the force
    assert found.composition.shrink > 0.3


@measured
def test_the_lag_of_a_real_valve_is_distinguished_from_a_static_map(tmp_path):
    found = real_gaps.damper_without_lag(real_gaps.Data(DATA, tmp_path))
    assert found.verdict in (NAMED, AMBIGUOUS)
    assert found.causes[0].effects == ("valve_lag",)
    assert "valve_lag" in found.composition.effects
    assert not any("valve_lag" in group for group in found.indistinguishable)
    assert found.composition.shrink > 0.3


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
    parts = [real_gaps.between(sine, a, a + 2.0) for a in (0.0, 2.0, 4.0, 6.0)]
    assert sum(len(p.channel("force")) for p in parts) == len(TIME)
    assert parts[1].channel("current").stamps_ns[0] == 2_000_000_000
