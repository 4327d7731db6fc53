"""The rules of a bench: what each reads is that of the same damper without noise, and mistakes are one line."""

from dataclasses import replace

import numpy as np
import pytest
from dyno_recordings import (
    HYSTERESIS_A,
    POINTS,
    bench_programme,
    lagging_force,
    recording_of,
    sine_motion,
    stepped_dyno,
    triangle_motion,
    valve_force,
)

from ces_identify.characteristics.characterise import characterise, judge
from ces_identify.characteristics.rules import load_rules
from ces_observer.errors import CesError

NOISE_N, NOISE_M = 8.0, 15e-6  # of the load cell and of the position, as on the virtual rig
FORMS = {
    "as without rules": {},
    "window": {"read_at": "centre"},
    "crossing": {"read_at": "centre", "window": 0},
    "last cycle": {"read_at": "centre", "cycles": "last"},
    "maximum": {"value": "maximum"},
    "maximum of a window": {"read_at": "centre", "value": "maximum"},
}


@pytest.mark.parametrize("rules", FORMS.values(), ids=list(FORMS))
def test_forces_and_hysteresis_are_those_without_noise(rules):
    clean = characterise(bench_programme(), rules=rules)
    noisy = characterise(bench_programme(NOISE_N, NOISE_M), rules=rules)
    assert len(clean.peak_velocity) == len(noisy.peak_velocity) == 2 * 4 * len(POINTS)
    for row, truth in zip(noisy.peak_velocity, clean.peak_velocity, strict=True):
        assert row.force_N == pytest.approx(truth.force_N, rel=0.01)
        assert row.speed_m_s == pytest.approx(truth.speed_m_s, rel=0.01)
    known = [row for row in noisy.over_current if np.isfinite(row.width_N)]
    assert len(known) == 2 * 2 * len(POINTS)  # between the ends of the current, which are reached from one side
    for row in known:
        v = row.speed_m_s
        planted = abs(valve_force(row.current_A + HYSTERESIS_A, v) - valve_force(row.current_A - HYSTERESIS_A, v))
        assert row.width_N == pytest.approx(planted, rel=0.1)
        assert row.lowered_N * np.sign(v) > row.raised_N * np.sign(v)


def test_the_window_and_the_crossing_read_the_centre_of_the_stroke():
    """A spring and a viscous damper: at the centre only the damper is left; the maximum is that of the window."""
    t, x, v = sine_motion(amplitude_m=0.02, frequency_Hz=2.0)
    recording = recording_of(t, x, 0.5, 1000.0 * v + 20_000.0 * x)
    peak, end = 0.02 * 4.0 * np.pi, 20_000.0 * 0.1 * 0.02
    for window, value, force, rel in (
        (0.0, "mean", 1e3 * peak, 2e-3),
        (0.1, "mean", 1e3 * peak, 5e-3),
        (0.1, "maximum", 1e3 * peak + end, 0.03),
    ):
        rules = {"read_at": "centre", "window": window, "value": value}
        compression, rebound = characterise(recording, rules=rules).peak_velocity
        assert compression.force_N == pytest.approx(force, rel=rel)
        assert rebound.force_N == pytest.approx(-force, rel=rel)


def test_the_first_hold_is_on_a_branch_where_the_rules_say_so():
    """Otherwise the lowest current is known from one side only."""
    for rules, known in (({}, 2), ({"first_hold": "raised"}, 3)):
        rows = characterise(bench_programme(), rules=rules).over_current
        slowest = [row for row in rows if row.direction == "compression" and row.speed_m_s < 0.2]
        assert sum(np.isfinite(row.width_N) for row in slowest) == known


def test_range_ratio_and_linearity():
    results = characterise(bench_programme(NOISE_N, NOISE_M))
    for row in results.ranges:
        sign = np.sign(row.speed_m_s)
        soft, hard = (valve_force(np.array(i), row.speed_m_s) for i in (0.3 + HYSTERESIS_A / 2.0, 0.9 - HYSTERESIS_A))
        assert (row.soft_A, row.hard_A) == pytest.approx((0.3, 0.9), abs=1e-3)
        assert row.range_N == pytest.approx(sign * (hard - soft), rel=0.02)
        assert row.ratio == pytest.approx(hard / soft, rel=0.02)
        assert 0.0 < row.range_ci95_N < 0.1 * row.range_N
    for row in results.over_current:
        assert 0.0 <= row.linearity <= 1.0
        assert row.linearity == pytest.approx((row.current_A - 0.3) / 0.6, abs=0.08)


def test_a_valve_that_is_hard_without_current_has_its_range_the_other_way():
    records = [
        recording_of(*sine_motion()[:2], i, 1e3 * (2.0 - i) * sine_motion()[2], seed=n)
        for n, i in enumerate((0.2, 1.0))
    ]
    compression, rebound = characterise(records).ranges
    assert (compression.soft_A, compression.hard_A) == pytest.approx((1.0, 0.2))
    assert (compression.ratio, rebound.ratio) == pytest.approx((1.8, 1.8), rel=1e-3)
    assert compression.range_N > 0.0 < rebound.range_N


def test_a_simulation_has_its_range_beside_the_measured_one_where_it_has_a_force_at_both_ends():
    recording = bench_programme()
    force, current = recording.channel("force").values, recording.channel("current").values
    partial = np.where(current > 0.8, np.nan, force)
    results = characterise(recording, simulations={"softer": [0.9 * force], "partial": [partial]})
    rows = {(row.source, row.direction, row.amplitude_m, row.frequency_Hz): row for row in results.ranges}
    for (source, *point), row in rows.items():
        measured = rows["measured", *point]
        if source == "softer":
            assert row.difference_N == pytest.approx(-0.1 * measured.range_N)
            assert row.difference_ratio == pytest.approx(0.0, abs=1e-9)
        else:
            assert np.isnan(row.difference_N)
    assert all(
        row.difference_N == pytest.approx(-0.1 * row.force_N / 0.9)
        for row in results.over_current
        if row.source == "softer"
    )


def test_the_gas_force_is_added_and_the_raw_force_stays():
    plain, corrected = (characterise(bench_programme(), rules=rules) for rules in ({}, {"gas_force_N": -230.0}))
    for row, truth in zip(corrected.peak_velocity, plain.peak_velocity, strict=True):
        assert row.raw_N == pytest.approx(truth.force_N)
        assert row.force_N == pytest.approx(truth.force_N - 230.0)


def test_only_target_speeds_are_compared_over_current_and_missing_ones_are_told():
    results = characterise(bench_programme(), rules={"speeds_m_s": [0.13, 0.53, 1.047]})
    assert {row.target_m_s for row in results.ranges} == {0.13, 0.53}
    assert len(results.work) == 3 * 4  # other tables keep all
    assert [o.subject for o in results.omissions if o.subject.startswith("target")] == ["target speed 1.047 m/s"]


def test_the_last_cycle_of_each_hold():
    results = characterise(bench_programme(), rules={"cycles": "last"})
    counts = {(round(row.current_A, 1), row.cycles) for row in results.peak_velocity}
    assert counts == {(0.3, 2), (0.5, 2), (0.7, 2), (0.9, 1)}
    assert all(row.cycles > 2 for row in results.work)


LAG_S, DEAD_S = 0.010, 0.003


def lag(t):
    return lagging_force(t, np.array([0.0, 1.0]), np.array([0.0]), LAG_S, DEAD_S)


def ringing(t):
    w, z = 200.0, 0.5
    wd = w * np.sqrt(1.0 - z * z)
    return 1.0 - np.exp(-z * w * t) * (np.cos(wd * t) + z * w / wd * np.sin(wd * t))


def truth_of(response):
    """Return when a response stays beyond 63.2 and 90 %, is settled [s], and its overshoot."""
    t = np.arange(0.0, 0.15, 1e-5)
    y = response(t)
    reached = [t[np.flatnonzero(y < share)[-1] + 1] for share in (0.632, 0.9)]
    near = np.convolve(np.abs(y - 1.0) <= 0.02, np.ones(1000), "valid") == 1000
    return (*reached, t[near.argmax()], max(y.max() - 1.0, 0.0))


RESPONSES = {
    "lag": (lag, False),
    "overshoot": (ringing, False),
    "early dip": (lambda t: lag(t - 0.02) + 0.8 * ((t > 0.004) & (t < 0.009)), True),
}


@pytest.mark.parametrize(("response", "dips"), RESPONSES.values(), ids=list(RESPONSES))
def test_times_are_those_without_noise_and_a_dip_is_no_step(response, dips):
    t63, t90, settled, overshoot = truth_of(response)
    results = characterise(stepped_dyno(response))
    assert len(results.responses) == 4
    for row in results.responses:
        assert row.time_63_s == pytest.approx(t63, abs=1e-3)
        assert row.time_90_s == pytest.approx(t90, abs=1e-3)
        assert row.settled_s == pytest.approx(settled, abs=max(row.settled_ci95_s, 1e-3))
        assert row.overshoot == pytest.approx(overshoot, abs=max(row.overshoot_ci95, 0.01))
        assert row.dips == (row.steps if dips else 0)


def test_a_step_that_fails_is_told_from_a_dip_that_recovers():
    fails = characterise(stepped_dyno(lambda t: 0.0 * t))
    dips = characterise(stepped_dyno(lambda t: 0.8 * ((t > 0.005) & (t < 0.02))))
    for results, reason in ((fails, "changes by less than 15 times its noise"), (dips, "dips and recovers")):
        read = {step.note for step in results.steps if "does not follow" in step.note}
        assert len(read) == 1 and reason in read.pop()


def test_settling_later_than_the_window_can_show_is_not_known():
    results = characterise(stepped_dyno(lambda t: 1.0 - np.exp(-t / 0.02)))
    assert all(np.isnan(row.settled_s) and np.isnan(row.settled_ci95_s) for row in results.responses)


def test_the_start_of_a_step_is_a_share_of_the_change_of_the_current():
    """A coil of 6 ms: times from half of the change are shorter by what the current takes from 10 to 50 %."""
    t, x, v = triangle_motion(duration_s=18.0)
    steady = np.array([0.3, 0.7, 0.3, 0.3, 0.7, 0.3])[np.floor(t / 0.3 + 1e-9).astype(int) % 6]
    changes = np.flatnonzero(np.diff(steady)) + 1
    current = lagging_force(t, np.array([steady[0], *steady[changes]]), t[changes], 0.006, 0.0)
    recording = recording_of(t, x, current, 2000.0 * current * np.tanh(v / 0.01), 2.0)
    early, late = (characterise(recording, rules={"step_start": share}).responses for share in (0.1, 0.5))
    for first, second in zip(early, late, strict=True):
        assert first.time_63_s - second.time_63_s == pytest.approx(0.006 * np.log(0.9 / 0.5), abs=5e-4)


def test_limits_are_judged_where_they_are_given():
    assert not characterise(stepped_dyno(lag)).judged
    results = characterise(stepped_dyno(lag), rules={"limit": {"t90_ms": 40, "t63_ms": 13.5, "settled_ms": 20}})
    verdicts = {(row.limit, row.verdict) for row in results.judged if "0.3 to 0.7 A" in row.subject}
    assert {("t90_ms", "within"), ("t63_ms", "undecided"), ("settled_ms", "outside")} == verdicts
    limits = load_rules({"limit": {"range_N": 500, "ratio": 3}}).limit
    (reach, *_) = characterise(bench_programme()).ranges
    made = judge(limits, (), [replace(reach, range_N=600.0, ratio=np.nan, ratio_ci95=np.nan)])
    assert [row.verdict for row in made] == ["within", "not known"]
    (unknown,) = judge(load_rules({"limit": {"t90_ms": 15}}).limit, (), ())
    assert (unknown.verdict, unknown.subject) == ("not known", "no step was read")


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"windw": 0.1}, "rules: unknown key 'windw'; did you mean 'window'?"),
        ({"limit": {"t90_s": 0.015}}, "rules: limit: unknown key 't90_s'; did you mean 't90_ms'?"),
        ({"limit": {"t90_ms": "15 ms"}}, "limit: t90_ms is '15 ms'; expected a number above 0 to 1000000 ms"),
        ({"read_at": "middle"}, "read_at is 'middle'; expected one of peak_speed, centre"),
        ({"speeds_m_s": [0.131, -1]}, r"speeds_m_s\[1\] is -1; expected a number above 0 to 100 m/s"),
    ],
)
def test_a_mistake_is_one_line(rules, message):
    with pytest.raises(CesError, match=message):
        characterise(recording_of(*sine_motion()[:2], 0.5, 1000.0 * sine_motion()[2]), rules=rules)
