"""Diagnoses on measured data: cases, how they are judged, independent values, changes put into recordings."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_recordings import recording_of

from bench.gaps.effects import CHANGES, read_friction, read_offset, read_play
from bench.gaps.real_cases import Data
from bench.gaps.real_gaps import (
    DOUBT,
    NOTHING,
    PARTLY,
    RIGHT,
    WRONG,
    CaseAnswer,
    all_cases,
    diagnose_case,
    judge,
    table,
)
from bench.gaps.simulations import BandBrake, SpeedPolynomial
from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN
from ces_gap.inference.judgement import CALIBRATION, TIMING

DATA = Path(os.environ.get("CES_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
measured = pytest.mark.skipif(not DATA.is_dir(), reason=f"measured recordings are not in {DATA} (set CES_DATA)")

RATE_HZ, SECONDS = 1000.0, 8.0
TIME = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
OMEGA = 2.0 * np.pi * 0.5


def recording(position, current, force):
    return recording_of(TIME, position=position, current=current, force=force)


def put(effect, before):
    return next(c for c in CHANGES if c.effect == effect).apply(before)


def values(of, name):
    return of.channel(name).values


@pytest.fixture
def sine():
    position = 0.02 * np.sin(OMEGA * TIME)
    return recording(position, np.sin(OMEGA * TIME), 300.0 * np.sign(np.cos(OMEGA * TIME)))


@pytest.fixture(scope="module")
def cases():
    return all_cases(Data(DATA))


@measured
@pytest.mark.slow
def test_the_play_of_a_real_brake_is_found_without_references(cases):
    """An elastic part that is soft while the force is small leaves as little on held-out parts, which is said."""
    found = diagnose_case(cases["brake_0.25"])
    assert found.composition.effects == ("backlash",) and {*found.alternatives} <= {"compressibility"}
    play_m = found.composition.estimates[0][0].value
    assert play_m == pytest.approx(read_play(cases["brake_0.25"].prepare()[1][0]), rel=0.4)
    assert found.composition.shrink > 0.3


@measured
@pytest.mark.slow
def test_the_friction_of_a_real_damper_is_found_without_references(cases):
    """It closes three quarters of the gap; what a learner without physics closes beside it is said."""
    case = cases["0A_viscous_slow"]
    found = diagnose_case(case)
    assert judge(case.causes, found.verdict, found.composition.effects) in (RIGHT, PARTLY)
    assert "friction" in found.composition.effects


@measured
def test_every_measured_recording_is_in_the_table(cases):
    folders = ("brfd_backlash", "utfsm_mr", "dyke_mr")
    logs = {p.stem for folder in folders for p in (DATA / folder).iterdir() if p.suffix in (".csv", ".json")}
    assert logs <= {log for case in cases.values() for log in case.logs}


def test_answers_about_one_simulation_and_truth_share_a_row():
    named = CaseAnswer("brake, 1 Hz", "play", "named: backlash", RIGHT, 0.45, (("gap_m", 0.0041),))
    other = CaseAnswer("brake, 2 Hz", "play", "unknown", NOTHING, 0.1, ())
    none = CaseAnswer("damper, 1 Hz", "nothing", "no gap", RIGHT, None, ())
    rows = table([named, other, none]).splitlines()[2:]
    assert rows == [
        "|brake|play|1 named: backlash; 1 unknown|1 right; 1 none|10…45|gap_m 0.0041|",
        "|damper|nothing|no gap|right|||",
    ]


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


def test_friction_resists_and_has_the_size_it_says(sine):
    added = values(put("friction", sine), "force") - values(sine, "force")
    moving = np.abs(np.cos(OMEGA * TIME)) > 0.7
    assert np.abs(added)[moving & (TIME > 1.0)] == pytest.approx(200.0, rel=1e-6)
    assert (np.sign(added) == np.sign(np.cos(OMEGA * TIME)))[moving & (TIME > 1.0)].all()


def test_a_change_leaves_the_other_channels_and_forgets_the_source(sine):
    changed = put("force_scale", replace(sine, source="bag", sha256="0" * 64))
    assert values(changed, "force") == pytest.approx(1.2 * values(sine, "force"))
    assert all((values(changed, n) == values(sine, n)).all() for n in ("position", "current"))
    assert (changed.source, changed.sha256) == ("", "")
