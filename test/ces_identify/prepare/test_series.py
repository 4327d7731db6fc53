import numpy as np
import pytest
from samplings import make_sampling

from ces_data.recording import Channel, Recording
from ces_data.samples import measured_at
from ces_identify.prepare.series import hold_current, prepare
from ces_observer.errors import RecordingError

SAMPLING = make_sampling()
MS = 1_000_000


def recording(n=3000, gap_at=None, force_rate=1, spoil=None):
    stamps = np.arange(n) * MS
    if gap_at is not None:
        stamps[gap_at:] += 200 * MS
    x = 0.01 * np.sin(2 * np.pi * 3e-9 * stamps)
    if spoil is not None:
        x[spoil[0]] = spoil[1]
    force = Channel("force", "N", stamps[::force_rate] + 300_000, 1e3 * np.cos(3e-9 * stamps[::force_rate]))
    return Recording(
        "made",
        {
            "position": Channel("position", "m", stamps, x),
            "current": Channel("current", "A", stamps[::5], np.arange(len(stamps[::5])) * 1.0),
            "force": force,
        },
    )


def test_one_tick_per_sample_and_the_warm_up_unscored():
    series = prepare(recording(), SAMPLING)
    assert len(series) == 3000
    np.testing.assert_allclose(series.time_s, np.arange(3000) * 1e-3, atol=1e-9)
    assert not series.scored[:500].any()
    assert series.scored[500:-1].all()
    speed = 0.01 * 6 * np.pi * np.cos(6 * np.pi * series.time_s)
    assert np.abs(series.speed - speed)[500:].max() < 0.01 * np.abs(speed).max()


def test_force_is_interpolated_to_the_ticks():
    series = prepare(recording(), SAMPLING)
    expected = 1e3 * np.cos(3.0 * (series.time_s - 0.3e-3))
    np.testing.assert_allclose(series.force[1:-1], expected[1:-1], atol=0.01)
    assert np.isnan(series.force[0])


def with_force(made, values=None, keep=None):
    force = made.channels["force"]
    force = force if values is None else Channel("force", "N", force.stamps_ns, values)
    return Recording("holes", {**made.channels, "force": force if keep is None else force.select(keep)})


@pytest.mark.parametrize("run", [1, 30])
@pytest.mark.parametrize("absent", [True, False], ids=["missing", "nan"])
def test_force_that_was_not_measured_is_neither_interpolated_nor_scored(run, absent):
    """Ticks lie 0.3 ms before a force sample, so that one of two neighbours is absent at run + 1 ticks."""
    whole = recording()
    lost = np.zeros(3000, bool)
    lost[1000 : 1000 + run] = True
    values = np.where(lost, np.nan, whole.channels["force"].values)
    series = prepare(with_force(whole, None, ~lost) if absent else with_force(whole, values), SAMPLING)
    expected = np.zeros(3000, bool)
    expected[1000 : 1000 + run + 1] = True
    np.testing.assert_array_equal(np.isnan(series.force[500:]), expected[500:])
    np.testing.assert_array_equal(series.scored[500:], ~expected[500:])
    untouched = prepare(whole, SAMPLING)
    np.testing.assert_array_equal(series.force[series.scored], untouched.force[series.scored])


def test_spikes_of_the_force_are_neither_interpolated_nor_scored():
    made = recording()
    values = made.channels["force"].values.copy()
    values[[1000, 2000]] = 999e3, -999e3
    series, untouched = prepare(with_force(made, values), SAMPLING), prepare(made, SAMPLING)
    assert np.flatnonzero(~series.scored[500:-1]).tolist() == [500, 501, 1500, 1501]
    np.testing.assert_array_equal(series.force[series.scored], untouched.force[series.scored])


def test_values_beside_a_hole_count_at_their_own_stamps():
    force = Channel("force", "N", np.arange(10) * MS, np.where(np.arange(10) == 4, np.nan, 1.0))
    np.testing.assert_array_equal(np.flatnonzero(~measured_at(force, force.stamps_ns)), [4])
    np.testing.assert_array_equal(measured_at(force, np.array([-1, 2 * MS + 1, 3 * MS + 1, 9 * MS + 1])), [0, 1, 0, 0])
    assert not measured_at(Channel("force", "N", np.array([0, MS]), np.array([1.0, np.nan])), np.array([0, 1])).any()


@pytest.mark.parametrize("rest", [np.nan, None])
def test_a_force_logged_more_slowly_or_with_jitter_has_no_holes(rest):
    """A table with a force in every tenth row, samples that arrive in bursts, and stamps with jitter."""
    rows, dice = np.arange(1000), np.random.default_rng(1)
    values = np.where(rows % 10 == 0, 1.0, np.nan)
    slow = Channel("force", "N", rows * MS, values)
    slow = slow if rest is not None else slow.select(rows % 10 == 0)
    bursts = Channel("force", "N", (rows // 5) * 5 * MS + rows % 5, np.ones(1000))
    jittered = Channel("force", "N", rows * MS + dice.integers(-300_000, 300_000, 1000), np.ones(1000))
    for channel in (slow, bursts, jittered):
        assert measured_at(channel, np.arange(2 * MS, 900 * MS, 333_333)).all()


def test_current_is_the_newest_at_or_before_each_sample():
    series = prepare(recording(), SAMPLING)
    np.testing.assert_array_equal(series.current[:12], [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2])


def test_an_old_current_is_no_current():
    channel = Channel("current", "A", np.array([0, 10 * MS]), np.array([1.0, np.nan]))
    held = hold_current(Recording("r", {"current": channel}), np.array([-1, 0, 50 * MS, 101 * MS]), 0.1)
    np.testing.assert_array_equal(held, [np.nan, 1.0, 1.0, np.nan])
    nothing = Recording("r", {"current": Channel("current", "A", np.array([0]), np.array([np.nan]))})
    assert np.isnan(hold_current(nothing, np.array([5]), 1.0)).all()


def test_a_constant_current_needs_no_channel():
    made = recording()
    passive = Recording("p", {"position": made.channel("position")}, constants={"current": 0.0})
    assert (prepare(passive, SAMPLING).current == 0.0).all()


def test_a_gap_splits_and_warms_up_anew():
    series = prepare(recording(gap_at=1500), SAMPLING)
    np.testing.assert_array_equal(series.segments, [[0, 1500], [1500, 3000]])
    assert series.scored[1499]
    assert not series.scored[1500:2000].any()
    assert series.scored[2000]
    assert np.isnan(series.force[1500])


def test_bad_samples_are_left_out_and_counted():
    series = prepare(recording(spoil=([700, 701, 900], [np.nan, np.inf, 0.3])), SAMPLING)
    assert len(series) == 3000
    assert series.dropped["position not finite"] == 2
    assert series.dropped["outlier"] == 1
    assert np.abs(series.position).max() < 0.011


def test_a_part_warms_up_anew():
    part = prepare(recording(), SAMPLING).part(0.5, 1.0)
    assert len(part) == 1500
    np.testing.assert_array_equal(part.segments, [[0, 1500]])
    assert not part.scored[:500].any()
    assert part.scored[500:-1].all()


def test_a_long_series_is_thinned_to_stretches_that_warm_up_anew(monkeypatch):
    monkeypatch.setattr("ces_identify.limits.TickLimits.STRETCH_S", 0.7)
    whole = prepare(recording(gap_at=1500), SAMPLING)
    assert whole.thin(1) is whole
    thin = whole.thin(2)
    kept = np.r_[0:700, 1400:2100, 2800:3000]
    np.testing.assert_array_equal(thin.time_s, whole.time_s[kept])
    np.testing.assert_array_equal(thin.segments, [[0, 700], [700, 800], [800, 1400], [1400, 1600]])
    assert np.flatnonzero(thin.scored).tolist() == [*range(500, 700), *range(1300, 1400)]
    np.testing.assert_array_equal(thin.force[thin.scored], whole.force[kept][thin.scored])


def test_too_short_a_stretch_is_refused():
    with pytest.raises(RecordingError, match=r"made: too short: the longest stretch without a gap lasts 0.4 s"):
        prepare(recording(n=400), SAMPLING)


def test_no_current_at_all_is_refused():
    made = recording()
    late = Channel("current", "A", made.channel("position").stamps_ns + 10**12, np.ones(3000))
    with pytest.raises(RecordingError, match="no position sample with a current"):
        prepare(Recording("made", {**made.channels, "current": late}), SAMPLING)
