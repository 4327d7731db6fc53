"""Samples of any stream become uniform ticks: at their times, without what is late, wild, or beyond the stroke."""

from __future__ import annotations

import math
from dataclasses import replace
from math import ceil, pi, sin
from pathlib import Path

import numpy as np
import pytest
from samplings import make_sampling
from trackers import Tracker

from ces_observer.bank_design import response_s
from ces_observer.estimator import Estimator
from ces_observer.limits import SpeedLimits
from ces_observer.model import load_model
from ces_observer.reasons import BEYOND_STROKE, NOT_FINITE, OK, OUT_OF_ORDER, OUTLIER, RESTARTED, UNSETTLED
from ces_observer.tick import bank, tracker
from ces_observer.tick.tracker import PATIENCE, check_tracker

SAMPLING = make_sampling(stroke_m=(-0.1, 0.3))
MS = 1_000_000
OMEGA = 2 * math.pi * 3


def stroke(t):
    return 0.01 * math.sin(OMEGA * t)


def fed(stamps_ms, position=stroke, sampling=SAMPLING):
    t = Tracker(sampling)
    return [(t.advance(round(ms * MS), position(ms * 1e-3)), list(t.ticks), t.ahead) for ms in stamps_ms]


def speeds_of(rows):
    return np.array([v for _, ticks, _ in rows for _, v in ticks])


def speed_error(rows):
    """The largest error of the speed after 0.3 s, as a share of the largest speed."""
    speed = speeds_of(rows)
    return np.abs(speed / (0.01 * OMEGA) - np.cos(OMEGA * 1e-3 * np.arange(len(speed))))[300:].max()


def test_a_steady_stream_gives_one_tick_per_sample_at_its_time():
    rows = fed(range(500))
    assert all(len(ticks) == 1 and abs(ahead) < 1e-6 for _, ticks, ahead in rows)
    assert speed_error(rows) < 0.01


@pytest.mark.parametrize("spread", [0.3, 0.49])
def test_jitter_neither_drops_nor_adds_ticks(spread):
    dice = np.random.default_rng(1)
    stamps = [k + spread * dice.uniform(-1.0, 1.0) for k in range(1, 1000)]
    rows = fed([0, *stamps])
    assert {len(ticks) for _, ticks, _ in rows} == {1}
    np.testing.assert_allclose([ahead for *_, ahead in rows[1:]], np.array(stamps) - np.arange(1, 1000), atol=1e-5)
    assert speed_error(rows) < 0.01


def test_dropped_samples_are_bridged_by_interpolation():
    rows = fed([*range(300), 305, *range(306, 320)])
    assert len(rows[300][1]) == 6
    np.testing.assert_allclose(np.diff(rows[300][1], 2, axis=0), 0.0, atol=1e-9)


@pytest.mark.parametrize("rate", [100.0, 150.0, 200.0, 333.333, 777.0, 999.7, 1000.4, 2000.0, 3004.8, 10_000.0])
@pytest.mark.parametrize("noise_m", [1e-7, 1e-5])
def test_a_stream_at_another_rate_gives_ticks_at_the_models_rate(rate, noise_m):
    """For long: a mode that such a stream drove away, or a clock that is a little off, would show."""
    sampling = make_sampling(noise_m=noise_m, outlier_m=0.005)
    rows = fed([k * 1e3 / rate for k in range(int(4 * rate))], sampling=sampling)
    assert sum(len(ticks) for _, ticks, _ in rows) == pytest.approx(4000, abs=15)
    assert speed_error(rows) < (0.02 if rate > 300.0 else 0.06)
    assert {outcome for outcome, *_ in rows[1:]} <= {OK, UNSETTLED}


def test_irregular_stamps_and_coarse_positions_give_a_true_speed():
    """A mixture of 0.1 to 10 ticks, and positions in steps of 50 um."""
    dice = np.random.default_rng(2)
    stamps = np.cumsum(10.0 ** dice.uniform(-1.0, 1.0, 3000))
    assert speed_error(fed(stamps)) < 0.1
    coarse = make_sampling(noise_m=50e-6 / math.sqrt(12.0))
    errors = speeds_of(fed(range(4000), lambda t: 50e-6 * round(stroke(t) / 50e-6), coarse))
    errors -= 0.01 * OMEGA * np.cos(OMEGA * 1e-3 * np.arange(4000))
    assert errors[500:].std() < 0.03 * 0.01 * OMEGA


def test_silence_restarts_and_is_not_bridged():
    rows = fed([*range(100), 151])
    assert rows[-1][0] == RESTARTED
    assert len(rows[-1][1]) == 1


@pytest.mark.parametrize("jump", [60, -60])
def test_a_clock_jump_restarts(jump):
    assert fed([*range(1000, 1100), 1099 + jump])[-1][0] == RESTARTED


def test_repeated_and_late_stamps_are_left_out():
    assert [row[0] for row in fed([0, 1, 2, 2, 1, 3])][3:] == [OUT_OF_ORDER, OUT_OF_ORDER, OK]


def at_rest(count=100):
    t = Tracker(SAMPLING)
    for k in range(count):
        t.advance(k * MS, 0.0)
    return t


def test_a_spike_is_left_out_and_a_lasting_jump_believed():
    t = at_rest()
    assert t.advance(100 * MS, 0.05) == OUTLIER
    assert t.advance(101 * MS, 0.0) == OK
    reasons = [t.advance(k * MS, 0.05) for k in range(102, 113)]
    assert reasons == [OUTLIER] * PATIENCE + [RESTARTED]


@pytest.mark.parametrize("beyond", [-0.11, 0.31, 1e30])
def test_a_position_beyond_the_stroke_is_never_believed(beyond):
    """Neither as the first sample, nor after a gap, nor however often it comes; the next good one goes on."""
    t = Tracker(SAMPLING)
    assert t.advance(0, beyond) == BEYOND_STROKE
    assert t.ticks == []
    t = at_rest()
    assert {t.advance(100 * MS + k, beyond) for k in range(5 * PATIENCE)} == {BEYOND_STROKE}
    assert t.advance(101 * MS, 0.0) == OK
    assert t.position == pytest.approx(0.0, abs=1e-9)
    assert t.advance(400 * MS, beyond) == BEYOND_STROKE
    assert t.advance(401 * MS, 0.0) == RESTARTED
    for edge in SAMPLING.stroke_m:
        assert Tracker(SAMPLING).advance(0, edge) == RESTARTED


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_left_out(bad):
    t = Tracker(SAMPLING)
    t.advance(0, 0.0)
    assert t.advance(MS, bad) == NOT_FINITE
    assert t.ticks == []
    assert t.advance(2 * MS, 0.0) == OK


# ----------------------------------------------------------------------------------------------------------- the delay


def late_rows(stamps_ms, delay_ticks, **changes):
    """The ticks as they are known when they come, and `delay_ticks` later; None where they are not."""
    t, now, late = Tracker(make_sampling(delay_s=delay_ticks * 1e-3, **changes)), [], []
    for ms in stamps_ms:
        t.advance(round(ms * MS), stroke(ms * 1e-3))
        assert len(t.late_ticks) == len(t.ticks)
        now += t.ticks
        late += t.late_ticks
    return now, late


def test_each_tick_yields_the_one_a_delay_before():
    dice = np.random.default_rng(3)
    stamps = [0, *(k + dice.uniform(-0.4, 0.4) for k in range(1, 2000))]
    now, late = late_rows(stamps, 4)
    assert late[:4] == [None] * 4
    np.testing.assert_array_equal([x for x, _ in late[4:]], [x for x, _ in now[:-4]])
    true = 0.01 * OMEGA * np.cos(OMEGA * 1e-3 * np.arange(1996))
    late_error, error = (np.array([v for _, v in rows])[300:] - true[300:] for rows in (late[4:], now[:-4]))
    assert late_error.std() < 0.5 * error.std()


def test_a_restart_forgets_what_was_not_known_yet():
    _, late = late_rows([*range(20), *range(100, 120)], 5)
    assert [k for k, tick in enumerate(late) if tick is None] == [*range(5), *range(20, 25)]


def test_a_rejected_sample_yields_no_late_ticks():
    t = Tracker(make_sampling(delay_s=3e-3))
    for k in range(50):
        t.advance(k * MS, 0.0)
    assert t.advance(53 * MS, 0.2) == OUTLIER
    assert t.late_ticks == t.ticks == []
    assert t.advance(53 * MS + 1, 0.0) == OK
    assert len(t.late_ticks) == len(t.ticks) == 4


# ----------------------------------------------------------------------------------------------------- loaded numbers


def fits(arrays, short=(0, 0, 0, 0)):
    return check_tracker(*arrays[:2], *(len(array) - less for array, less in zip(arrays, short, strict=True)))


MOTIONS = [{}, {"motion": "speed", "motion_noise": 0.01}, {"motion": "acceleration", "motion_noise": 0.1}]


@pytest.mark.parametrize("delay_s", [0.0, 3e-3])
@pytest.mark.parametrize("changes", MOTIONS, ids=str)
def test_arrays_of_a_sampling_are_accepted_and_shorter_ones_refused(changes, delay_s):
    arrays = Tracker(make_sampling(delay_s=delay_s, **changes)).arrays
    assert fits(arrays)
    for short in ([1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]):
        assert not fits(arrays, short)


SIZES = [
    bank.DELAY,
    bank.MODES,
    bank.SPANS,
    bank.SPAN_TABLE,
    bank.SEEN,
    bank.GAINS,
    bank.LIKELIHOODS,
    bank.COMPANIONS,
    bank.SMOOTHING,
]
SIZES += [bank.MODE_STATES, bank.RING, bank.BANK_STATES, bank.SAVED]
SIZES += [tracker.MAX_GAP_NS, tracker.LATE_AT, tracker.LATE_KNOWN]


@pytest.mark.parametrize("place", SIZES)
@pytest.mark.parametrize("wrong", [-1, 10**6, 2**62, -(2**62)])
def test_sizes_and_places_that_would_leave_the_arrays_are_refused(place, wrong):
    arrays = Tracker(make_sampling(delay_s=3e-3)).arrays
    arrays[1][place] = wrong * (10**6 if place == tracker.MAX_GAP_NS and wrong == 10**6 else 1)
    assert not fits(arrays)


@pytest.mark.parametrize("place", [bank.TICK_S, tracker.TICKS_PER_NS, tracker.SETTLING_S])
def test_numbers_that_guard_a_division_or_an_index_are_positive(place):
    for wrong in (0.0, -1e-3, math.nan):
        arrays = Tracker(SAMPLING).arrays
        arrays[0][place] = wrong
        assert not fits(arrays)


PHASES = 24
PEAK_M_S = 1.5  # the fastest that the sample model was identified on
FILED = load_model(Path(__file__).parents[3] / "config" / "models" / "sample.json")
MODEL = replace(FILED, sampling=replace(FILED.sampling, max_gap_s=0.1, stroke_m=(-1.0, 1.0)))


def stroke_reach(k: int, hertz: float) -> float:
    """Return the position [m] at k ms."""
    return PEAK_M_S / (2.0 * pi * hertz) * sin(2e-3 * pi * hertz * k)


def rows_begin(hertz: float) -> list[int]:
    """Return when [ms] rows are lost: from 600 ms on, 250 ms or more apart, at every PHASES-th of a turn."""
    begins = [600]
    for phase in range(1, PHASES):
        turns = ceil(hertz * 1e-3 * (begins[-1] + 250)) + phase / PHASES
        begins.append(round(1e3 * turns / hertz))
    return begins


def errors_after(lost: int, hertz: float) -> list[list[float | None]]:
    """Return, for each lost row, the errors of the forces after it, as shares of the largest; None if withheld."""
    begins = rows_begin(hertz)
    gone = {begin + k for begin in begins for k in range(lost)}
    whole, gappy = Estimator(MODEL), Estimator(MODEL)
    true: list[float | None] = []
    error: list[float | None] = []
    for k in range(begins[-1] + 250):
        x = stroke_reach(k, hertz)
        true.append(whole.step(k * MS, x, 0.5))
        force = None if k in gone else gappy.step(k * MS, x, 0.5)
        error.append(abs(force - true[-1]) if force is not None and true[-1] is not None else None)
    largest = max(abs(force) for force in true if force is not None)
    shares = [e if e is None else e / largest for e in error]
    return [shares[begin + lost : begin + 250] for begin in begins]


@pytest.mark.parametrize("lost", [1, 8, 12, 60])
@pytest.mark.parametrize("hertz", [4.0, 12.0, 20.0])
def test_after_lost_samples_the_estimate_is_soon_back_and_true_at_every_phase(hertz: float, lost: int) -> None:
    for errors in errors_after(lost, hertz):
        given = [k for k, error in enumerate(errors) if error is not None]
        assert given[0] <= 26
        assert given == list(range(given[0], len(errors))), "once given, it stays"
        assert max(errors[k] for k in given) < (0.05 if hertz < 12.0 else 0.12)
        assert max(errors[30:]) < 0.03


@pytest.mark.parametrize("hertz", [1.0, 2.0])
def test_on_a_slow_stroke_short_rows_withhold_nothing(hertz: float) -> None:
    for errors in errors_after(12, hertz):
        assert None not in errors
        assert max(errors) < 0.02


def gone_on(lost: int, departed_m: float, after: int = 5) -> list[str]:
    """Return what is said of samples at rest: of one by `departed_m` away after a row of lost ones, and of the next."""
    t = Tracker(MODEL.sampling)
    for k in range(200):
        t.advance(k * MS, 0.0)
    stamps = range(200 + lost, 201 + lost + after)
    return [t.advance(k * MS, departed_m if k == stamps[0] else 0.0) for k in stamps]


def reach_m(lost: int) -> float:
    """Return what a change of speed explains after a row of lost samples at 1 kHz, settling time included [m]."""
    s = MODEL.sampling
    overdue, ramp = (lost + 1 - SpeedLimits.OVERDUE) * 1e-3, SpeedLimits.SETTLING * response_s(s.stroke)
    changed = overdue - ramp / 2.0 if overdue > ramp else overdue**2 / (2.0 * ramp)
    return s.outlier_m + SpeedLimits.MAX_CHANGE * s.speed_m_s * changed


@pytest.mark.parametrize(("lost", "sign"), [(1, 1.0), (5, -1.0), (20, 1.0), (60, -1.0)])
def test_what_no_stroke_could_have_reached_is_an_outlier_and_nothing_else_is(lost: int, sign: float) -> None:
    assert gone_on(lost, 1.001 * sign * reach_m(lost)) == [OUTLIER] + [OK if lost <= 5 else UNSETTLED] * 5
    assert gone_on(lost, 0.999 * sign * reach_m(lost))[0] == UNSETTLED


def test_while_samples_come_in_time_the_reach_does_not_grow() -> None:
    t = Tracker(MODEL.sampling)
    for k in range(200):
        t.advance(k * MS, 0.0)
    jump = 1.1 * MODEL.sampling.outlier_m
    assert [t.advance(k * MS, jump) for k in range(200, 211)] == [OUTLIER] * PATIENCE + [RESTARTED]


def test_outliers_after_a_gap_do_not_end_what_it_explains() -> None:
    t = Tracker(MODEL.sampling)
    for k in range(200):
        t.advance(k * MS, stroke_reach(k, 8.0))
    later = [t.advance(k * MS, stroke_reach(k, 8.0) + (0.5 if k < 225 else 0.0)) for k in range(220, 250)]
    settling = later.count(UNSETTLED)
    assert later == [OUTLIER] * 5 + [UNSETTLED] * settling + [OK] * (25 - settling)
    assert 5 < settling < 20


def test_a_wrong_position_within_reach_costs_a_restart_at_most() -> None:
    """Positions that look like a motion: forces stay in their envelope, and are true again after the warm-up."""
    low, high = MODEL.force_envelope_N
    for departed in (0.005, 0.02, 0.04):
        whole, spoilt = Estimator(MODEL), Estimator(MODEL)
        for k in range(1400):
            x = stroke_reach(k, 8.0)
            true = whole.step(k * MS, x, 0.5)
            if not 700 <= k < 720:
                force = spoilt.step(k * MS, x + (departed if k == 720 else 0.0), 0.5)
                assert force is None or low <= force <= high
        assert force is not None and force == pytest.approx(true, abs=1e-3)


def test_a_start_on_the_fastest_stroke_succeeds_at_once() -> None:
    t = Tracker(MODEL.sampling)
    outcomes = [t.advance(k * MS, stroke_reach(k, 8.0)) for k in range(100)]
    assert outcomes[0] == RESTARTED
    assert set(outcomes[1:]) == {OK, UNSETTLED}  # withheld anyway: warming up
