"""Constructed inputs tick by tick: what they are, how they stand in a model file, and what is proved of them."""

import json
import math
import random
from dataclasses import replace
from itertools import pairwise

import pytest
from constructed_models import ConstructedRun
from hypothesis import given
from hypothesis import strategies as st
from model_examples import make_model

from ces_observer.errors import ModelError
from ces_observer.model import Envelope, parse_model
from ces_observer.structures.constructed_inputs import (
    Frequency,
    Hysteresis,
    Lag,
    TriangularMembership,
    make_memberships,
)
from ces_observer.structures.polynomial import Factor, Term

STOP = Hysteresis("hysteresis", "stop", "position", 0.002)
PLAY = Hysteresis("slack", "play", "position", 0.002)
LAG = Lag("valve", "current", 0.008)
FREQUENCY = Frequency("frequency", 0.25, (0.5, 20.0), 1e-4)
LOW, MID, HIGH = BLEND = make_memberships("by_current", "current", (0.2, 0.5, 1.1))
OF_STOP = make_memberships("by_stop", "hysteresis", (-0.001, 0.0015), STOP)
NAMED = {one.name: one for one in (STOP, PLAY, LAG, FREQUENCY, *BLEND, *OF_STOP)}
ENVELOPE = Envelope((-0.05, 0.05), (-2.0, 2.0), (0.0, 1.5))
FIRST = Factor("force", 1)


def of(name, lag=0, power=1.0, signed=False):
    return Factor(name, lag, power, signed, NAMED[name])


def model(*terms, **changes):
    return make_model(**{"terms": terms, "envelope": ENVELOPE, "force_envelope_N": (-1e9, 1e9), **changes})


def values(one, positions, speeds=None, currents=None, rate_Hz=1000.0):
    run = ConstructedRun([one], rate_Hz)
    zeros = [0.0] * len(positions)
    rows = zip(positions, speeds or zeros, currents or zeros, strict=True)
    return [run.update(row)[-1] for row in rows]


def sine(frequency_Hz, seconds=5.0, amplitude=0.01, rate_Hz=1000.0):
    w, n = 2.0 * math.pi * frequency_Hz, round(seconds * rate_Hz)
    x = [amplitude * math.sin(w * k / rate_Hz) + 0.02 for k in range(n)]
    return x, [amplitude * w * math.cos(w * k / rate_Hz) for k in range(n)]


# ------------------------------------------------------------------------------------------------- what they are


def test_a_stop_tells_the_stroke_since_the_last_reversal():
    there_and_back = [0.010, 0.011, 0.013, 0.020, 0.019, 0.0165, 0.016, 0.0]
    expected = [0.0, 0.001, 0.002, 0.002, 0.001, -0.0015, -0.002, -0.002]
    assert values(STOP, there_and_back) == pytest.approx(expected, abs=1e-15)


def test_a_play_lags_behind_by_its_half_width():
    there_and_back = [0.010, 0.011, 0.013, 0.020, 0.019, 0.015, 0.0]
    expected = [0.010, 0.010, 0.011, 0.018, 0.018, 0.017, 0.002]
    assert values(PLAY, there_and_back) == pytest.approx(expected, abs=1e-15)


@given(st.lists(st.floats(-0.05, 0.05), min_size=1, max_size=60))
def test_stop_and_play_add_up_to_their_signal_and_stay_in_range(positions):
    stops, plays = values(STOP, positions), values(PLAY, positions)
    assert [a + b for a, b in zip(stops, plays, strict=True)] == pytest.approx(positions, abs=1e-12)
    assert all(-0.002 <= h <= 0.002 for h in stops)
    assert all(min(positions) <= p <= max(positions) for p in plays)


def lagged(currents, one=LAG, rate_Hz=1000.0):
    return values(one, [0.0] * len(currents), currents=currents, rate_Hz=rate_Hz)


@pytest.mark.parametrize("rate_Hz", [125.0, 1000.0, 3000.0])
def test_a_lag_starts_at_its_signal_and_answers_a_step_in_its_time_constant(rate_Hz):
    """The same course in time at every rate: that of the differential equation tau y' = s - y."""
    text = lagged([0.2] * 3 + [1.0] * 100, rate_Hz=rate_Hz)
    assert text[:3] == [0.2] * 3
    expected = [1.0 - 0.8 * math.exp(-(k + 1) / (rate_Hz * 0.008)) for k in range(100)]
    assert text[3:] == pytest.approx(expected, rel=1e-12)


@given(st.lists(st.floats(-1.5, 1.5), min_size=1, max_size=60), st.sampled_from([1e-4, 1e-3, 0.008, 5.0]))
def test_a_lag_stays_within_the_range_of_its_signal(currents, time_constant_s):
    one = replace(LAG, time_constant_s=time_constant_s)
    low, high = one.range({"current": (min(currents), max(currents))})
    rounding = 4e-16 * max(map(abs, currents))
    assert all(low - rounding <= y <= high + rounding for y in lagged(currents, one, 200.0))


@pytest.mark.parametrize("frequency_Hz", [1.5, 4.0, 12.0])
def test_the_frequency_of_a_sine_is_estimated(frequency_Hz):
    text = values(FREQUENCY, *sine(frequency_Hz))[3000:]
    assert sum(text) / len(text) == pytest.approx(frequency_Hz, rel=0.05)
    assert all(0.5 * frequency_Hz < f < 2.0 * frequency_Hz for f in text)


def test_the_frequency_follows_a_change_within_a_few_windows():
    x, v = sine(2.0)
    x2, v2 = sine(10.0)
    text = values(FREQUENCY, x + x2, v + v2)
    assert text[4999] == pytest.approx(2.0, rel=0.2)
    assert text[6500] == pytest.approx(10.0, rel=0.1)


def test_standstill_has_the_lowest_frequency_whatever_the_noise():
    dice = random.Random(1)
    x = [0.02 + dice.gauss(0, 5e-6) for _ in range(2000)]
    v = [dice.gauss(0, 2e-4) for _ in range(2000)]
    assert set(values(FREQUENCY, x, v)) == {0.5}
    assert values(replace(FREQUENCY, floor_m=1e-9), x, v)[-1] > 2.0


@given(st.floats(-5.0, 5.0))
def test_hats_add_up_to_one_and_are_alone_at_their_peaks(value):
    assert sum(hat.at(value) for hat in BLEND) == pytest.approx(1.0, abs=1e-15)
    assert [hat.at(0.5) for hat in BLEND] == [0.0, 1.0, 0.0]
    assert all(0.0 <= hat.at(value) <= 1.0 for hat in BLEND)


@given(st.sampled_from([*BLEND, *OF_STOP]), st.floats(-1.5, 1.0), st.floats(0.0, 1.5), st.randoms())
def test_intervals_hold_every_membership_and_every_slope(hat, low, width, dice):
    span = hat.kinks[-1] - hat.kinks[0]
    at = (hat.peak + low * span, hat.peak + (low + width) * span)
    inside = sorted(dice.uniform(*at) for _ in range(20))
    least, most = hat.interval(at)
    assert all(least <= hat.at(u) <= most for u in inside)
    flat, steep = hat.slope_interval(at)
    for a, b in pairwise(inside):
        if b - a > 1e-6 * span:
            slope = (hat.at(b) - hat.at(a)) / (b - a)
            assert flat - 1e-6 / span <= slope <= steep + 1e-6 / span


# ------------------------------------------------------------------------------------------------ in a polynomial


def test_a_polynomial_uses_them_as_it_does_the_signals():
    made = model(
        Term(1e5, (of("hysteresis", 0, 1.0, True),)),
        Term(3e3, (of("hysteresis", 1, 0.5, True), of("by_current_2", 2))),
        Term(0.5, (FIRST, of("by_current_1"))),
    )
    run, stop, force = made.make_predictor(), 0.0, 0.0
    x, i = [0.0, 0.0015, 0.003, 0.0025, -0.09], [0.1, 0.3, 0.4, 0.9, 0.2]
    stops, mid = [], [MID.at(one) for one in i]
    for k in range(5):
        if k:
            stop = min(max(stop + max(x[k], -0.05) - x[k - 1], -0.002), 0.002)  # the last one is clamped
        stops.append(stop)
        before = stops[max(k - 1, 0)]
        late = math.copysign(math.sqrt(abs(before)), before) * mid[max(k - 2, 0)]
        force = 1e5 * stop + 3e3 * late + 0.5 * force * LOW.at(i[k])
        assert run.tick(x[k], 0.0, i[k]) == pytest.approx(force, rel=1e-12)


def test_reset_forgets_them():
    made = model(Term(1e5, (of("hysteresis"),)), Term(1.0, (of("frequency"), of("slack"), of("valve"))))
    run, dice = made.make_predictor(), random.Random(2)
    rows = [(dice.uniform(-0.05, 0.05), dice.uniform(-1, 1), dice.uniform(0, 1)) for _ in range(50)]
    first = [run.tick(*row) for row in rows]
    run.reset()
    assert [run.tick(*row) for row in rows] == first


# -------------------------------------------------------------------------------------------------- in model files

FULL = model(
    Term(1.0, (of("by_stop_2", 3), of("frequency", 0, 0.5))),
    Term(2.0, (of("slack", 1, 1.5, True), of("valve", 2, 2.0))),
    Term(0.4, (FIRST, of("by_current_1", 8))),
)


def test_a_model_without_constructed_inputs_does_not_mention_them():
    assert "constructed" not in make_model().to_json()


def test_two_of_a_name_are_refused():
    other = replace(STOP, half_width=0.1)
    terms = (Term(1.0, (of("hysteresis"),)), Term(1.0, (Factor("hysteresis", 0, 1.0, True, other),)))
    with pytest.raises(ModelError, match="'hysteresis': two different definitions"):
        model(*terms).to_json()


@pytest.mark.parametrize(
    ("at", "change", "message"),
    [
        (1, {"half_width": 0.0}, "half_width is 0.0; expected a number from 1e-09"),
        (1, {"of": "force"}, "of is 'force'; expected one of position, speed, current"),
        (1, {"of": "frequency"}, "of is 'frequency'"),
        (1, {"kind": "spline"}, "kind is 'spline'; expected one of stop, play, lag, frequency, hat"),
        (1, {"name": "speed"}, "name 'speed'; expected up to 40"),
        (1, {"name": "a_p0_5"}, "name 'a_p0_5'"),
        (1, {"name": "x; #"}, "name 'x; #'"),
        (1, {"name": "frequency"}, "name 'frequency' occurs twice"),
        (0, {"range_Hz": [5.0, 5.0]}, r"range_Hz is \[5, 5\]"),
        (0, {"range_Hz": [0.0, 5.0]}, r"range_Hz\[0\] is 0.0; expected a number from 0.001"),
        (3, {"time_constant_s": 0.0}, "time_constant_s is 0.0; expected a number from 0.0001"),
        (3, {"of": "hysteresis"}, "of is 'hysteresis'; expected one of position, speed, current"),
        (4, {"peak": 0.9}, "low None, peak 0.9, high 0.5; expected low < peak < high"),
        (4, {"high": None}, "one not null"),
        (5, {"of": "by_current_1"}, "of is 'by_current_1'"),
    ],
)
def test_what_is_wrong_is_named(at, change, message):
    raw = json.loads(FULL.to_json())
    raw["constructed"][at].update(change)
    with pytest.raises(ModelError, match=message):
        parse_model(json.dumps(raw), "m.json")


def test_a_signal_nobody_defined_and_a_power_of_a_membership_are_refused():
    raw = json.loads(FULL.to_json())
    raw["terms"][0]["factors"][0]["power"] = 2.0
    with pytest.raises(ModelError, match="power is 2; expected 1, as 'by_stop_2' is a membership"):
        parse_model(json.dumps(raw), "m.json")
    del raw["constructed"]
    with pytest.raises(ModelError, match="signal is 'by_stop_2'; expected one of force, speed, current, position"):
        parse_model(json.dumps(raw), "m.json")


# -------------------------------------------------------------------------------------------------- what is proved


def past(coefficient, *inputs, lag=1):
    return Term(coefficient, (Factor("force", lag), *inputs))


def test_a_blend_counts_for_its_worst_sub_model_not_for_their_sum():
    """Memberships taken as free numbers from 0 to 1 would give 0.9 + 0.8 + 0.6."""
    c = model(
        past(0.9, of("by_current_1", 8)), past(-0.8, of("by_current_2", 8)), past(0.6, of("by_current_3", 8))
    ).certify()
    assert c.gain == pytest.approx(0.9, rel=3e-3)


def test_a_blend_of_polynomials_is_bounded_tightly():
    """sum_m w_m |a_m| is largest between the places where sub-models are alone: a dense grid finds where."""
    v = Factor("speed", 0, 1.0, signed=False)
    i = Factor("current", 8, 1.0, signed=False)
    made = model(
        past(0.5, of("by_current_1", 8), i), past(0.9, of("by_current_2", 8), i), past(0.1, of("by_current_2", 8), v)
    )
    grid = [k * 1e-4 for k in range(15001)]
    largest = max(0.5 * LOW.at(u) * u + 0.9 * MID.at(u) * u + 0.2 * MID.at(u) for u in grid)
    assert largest <= made.certify().gain <= largest * 1.003


def test_a_blend_over_a_lag_counts_for_its_worst_sub_model_and_is_one_variable_with_it():
    """Products of the lag and of its memberships are bounded together: the largest is found on a grid of the lag."""
    by_valve = make_memberships("by_valve", "valve", (0.2, 0.5, 1.1), LAG)
    inside = [Factor(hat.name, 0, 1.0, False, hat) for hat in by_valve]
    made = model(past(0.9, inside[0]), past(-0.8, inside[1]), past(0.3, inside[2], of("valve", 0, 2.0)))
    grid = [k * 1e-4 for k in range(15001)]
    largest = max(abs(0.9 * LOW.at(u) - 0.8 * MID.at(u) + 0.3 * HIGH.at(u) * u * u) for u in grid)
    assert largest == pytest.approx(0.9)
    assert largest <= made.certify().gain <= largest * 1.003


def test_one_unstable_sub_model_is_detected_in_any_narrow_region():
    narrow = TriangularMembership("region", "current", 0.7, 0.7001, 0.7002)
    bad = model(past(0.5), past(0.51, Factor("region", 8, 1.0, False, narrow)))
    assert not bad.is_stable()
    assert bad.certify().gain == pytest.approx(1.01, rel=3e-3)
    assert model(past(0.5), past(0.49, Factor("region", 8, 1.0, False, narrow))).is_stable()


def test_constructed_inputs_are_bounded_by_their_own_ranges():
    c = model(
        past(100.0, of("hysteresis", 0, 1.0, True)),
        past(0.01, of("frequency", 2)),
        past(0.1, of("valve", 1, 2.0)),
        Term(10.0, (of("slack"),)),
    ).certify()
    assert c.gain == pytest.approx(100.0 * 0.002 + 0.01 * 20.0 + 0.1 * 1.5**2, rel=3e-3)
    assert c.drive_N == pytest.approx(10.0 * 0.05, rel=0.06)


@pytest.mark.parametrize("seed", range(4))
def test_no_run_leaves_the_proved_bound(seed):
    """Against inputs that jump through the whole envelope, and beyond, at every tick."""
    dice = random.Random(seed)
    pasts = [past(dice.uniform(-0.9, 0.9), of(hat.name, 3)) for hat in BLEND]
    pasts.append(past(dice.uniform(-0.04, 0.04), of("by_stop_1"), of("hysteresis", 0, 0.5, True)))
    drive = [Term(dice.uniform(-900, 900), (of(name),)) for name in NAMED]
    made = model(*pasts, *drive)
    certificate = made.certify()
    assert certificate.holds
    run, largest = made.make_predictor(), 0.0
    for _ in range(3000):
        largest = max(
            largest, abs(run.tick(dice.uniform(-0.06, 0.06), dice.uniform(-3, 3), dice.choice([0.0, 0.2, 0.5, 2.0])))
        )
    assert 0.02 * certificate.force_N < largest <= certificate.force_N
