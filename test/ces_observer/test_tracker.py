import math

import pytest

from ces_observer import tracker
from ces_observer.model import Sampling
from ces_observer.tracker import Tracker

SAMPLING = Sampling(1000.0, 50.0, 0.005)
MS = 1_000_000


def fed(stamps_ms, position=lambda t: 0.01 * math.sin(2 * math.pi * 3 * t), sampling=SAMPLING):
    t = Tracker(sampling)
    return [(t.advance(round(ms * MS), position(ms * 1e-3)), list(t.ticks), t.ahead) for ms in stamps_ms]


def test_a_steady_stream_gives_one_tick_per_sample_at_its_time():
    rows = fed(range(500))
    assert all(len(ticks) == 1 and abs(ahead) < 1e-6 for _, ticks, ahead in rows)
    assert rows[400][1][0][1] == pytest.approx(0.01 * 6 * math.pi * math.cos(2 * math.pi * 3 * 0.4), abs=2e-3)


def test_jitter_neither_drops_nor_adds_ticks():
    rows = fed([k + 0.3 * math.sin(7.0 * k) for k in range(1, 500)])
    assert {len(ticks) for _, ticks, _ in rows} == {1}


def test_dropped_samples_are_bridged_by_interpolation():
    rows = fed([*range(300), 305, *range(306, 320)])
    assert len(rows[300][1]) == 6
    xs = [x for x, _ in rows[300][1]]
    assert xs == sorted(xs)


@pytest.mark.parametrize("rate", [200.0, 777.0, 3004.8])
def test_a_stream_at_another_rate_gives_ticks_at_the_models_rate(rate):
    rows = fed([k * 1e3 / rate for k in range(int(rate))])
    assert sum(len(ticks) for _, ticks, _ in rows) == pytest.approx(1000, abs=5)
    speed = [v for _, ticks, _ in rows for _, v in ticks]
    worst = max(abs(v - 0.06 * math.pi * math.cos(0.006 * math.pi * k)) for k, v in enumerate(speed) if k > 300)
    assert worst < 0.02 * 0.06 * math.pi


def test_silence_restarts_and_is_not_bridged():
    rows = fed([*range(100), 151])
    assert rows[-1][0] == tracker.RESTARTED
    assert len(rows[-1][1]) == 1


@pytest.mark.parametrize("jump", [60, -60])
def test_a_clock_jump_restarts(jump):
    assert fed([*range(1000, 1100), 1099 + jump])[-1][0] == tracker.RESTARTED


def test_repeated_and_late_stamps_are_left_out():
    assert [row[0] for row in fed([0, 1, 2, 2, 1, 3])][3:] == [tracker.OUT_OF_ORDER, tracker.OUT_OF_ORDER, tracker.OK]


def test_a_spike_is_left_out_and_a_lasting_jump_believed():
    t = Tracker(SAMPLING)
    for k in range(100):
        t.advance(k * MS, 0.0)
    assert t.advance(100 * MS, 0.05) == tracker.OUTLIER
    assert t.advance(101 * MS, 0.0) == tracker.OK
    reasons = [t.advance(k * MS, 0.05) for k in range(102, 113)]
    assert reasons == [tracker.OUTLIER] * tracker.PATIENCE + [tracker.RESTARTED]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_left_out(bad):
    t = Tracker(SAMPLING)
    t.advance(0, 0.0)
    assert t.advance(MS, bad) == tracker.NOT_FINITE
    assert t.ticks == []
    assert t.advance(2 * MS, 0.0) == tracker.OK
