import numpy as np
import pytest
from residual_series import RATE, coloured, evaluation, series, single_run

from ces_identify.preparation.cost import cost
from ces_identify.validation import cost_interval as module
from ces_identify.validation.cost_interval import (
    Ticks,
    cost_interval,
    influence_block,
    interval_of,
    pooled_cost,
    replicates,
    scored_ticks,
)


def covered(seed, n, error_pole, force_pole):
    """Whether the interval of one synthetic recording holds the true J of 10 %."""
    ticks = Ticks(
        (10.0 * coloured(n, error_pole, seed)) ** 2, 100.0 * coloured(n, force_pole, seed + 10**6), single_run(n)
    )
    length = influence_block(ticks, 5)
    sums = replicates(ticks, length, np.random.default_rng(seed))
    low, high = interval_of(100.0 * np.sqrt(sums[:, 0] / sums[:, 1]), n // length)
    return low <= 10.0 <= high


@pytest.mark.parametrize(("error_pole", "force_pole"), [(0.0, 0.98), (0.9, 0.98), (0.98, 0.98)])
def test_coverage_on_autocorrelated_data(monkeypatch, error_pole, force_pole):
    """Nominal 95 %; block bootstraps fall a little short of it on finite records."""
    monkeypatch.setattr(module, "REPLICATES", 400)
    share = np.mean([covered(seed, 15_000, error_pole, force_pole) for seed in range(150)])
    assert 0.88 <= share <= 0.99


def test_resampling_single_ticks_instead_of_blocks_would_cover_far_too_little(monkeypatch):
    monkeypatch.setattr(module, "REPLICATES", 400)
    monkeypatch.setattr(module, "block_length", lambda x, runs: 1)
    assert np.mean([covered(seed, 5_000, 0.98, 0.98) for seed in range(40)]) < 0.7


def test_the_interval_holds_the_cost_and_narrows_with_the_record():
    widths = []
    for n in (5_000, 40_000):
        one = series(n)
        e = evaluation(one, 50.0 * coloured(n, 0.9, 7))
        interval = cost_interval([e])
        assert interval.low < e.cost < interval.high
        widths.append(interval.high - interval.low)
    assert widths[1] < 0.6 * widths[0]


def test_the_same_seed_gives_the_same_interval():
    one = series(8_000)
    e = evaluation(one, 50.0 * coloured(8_000, 0.9, 7))
    assert cost_interval([e], seed=3) == cost_interval([e], seed=3) != cost_interval([e], seed=4)


def test_every_tick_is_as_likely_in_short_and_long_runs():
    runs = np.array([[0, 40], [40, 2000], [2000, 2100]])
    mark = np.zeros(2100)
    for run in runs:
        squares = mark.copy()
        squares[run[0] : run[1]] = 1.0
        force = np.random.default_rng(0).normal(size=2100)
        sums = replicates(Ticks(squares, force, runs), 100, np.random.default_rng(1))
        assert sums[:, 0].mean() == pytest.approx(run[1] - run[0], rel=0.1)


def test_gaps_and_warm_up_are_left_out():
    one = series(10_000, warm_up=200, segments=[[0, 4000], [4000, 10_000]])
    e = evaluation(one, np.where(one.scored, 50.0 * coloured(10_000, 0.9, 7), 1e6))
    ticks = scored_ticks(e)
    np.testing.assert_array_equal(ticks.runs, [[0, 3800], [3800, 9600]])
    assert cost_interval([e]).high < 20.0


def test_several_recordings_together():
    ones = [series(8_000, seed) for seed in (1, 2)]
    both = [evaluation(one, size * coloured(8_000, 0.9, 7)) for one, size in zip(ones, (30.0, 90.0), strict=True)]
    centred = [one.force - one.force.mean() for one in ones]
    assert pooled_cost(both) == pytest.approx(
        cost(np.concatenate(centred), np.concatenate([c - e.error for c, e in zip(centred, both, strict=True)])),
        rel=1e-4,
    )
    interval = cost_interval(both)
    assert interval.low < pooled_cost(both) < interval.high
    assert pooled_cost(both[:1]) == pytest.approx(both[0].cost)


def test_no_interval_where_there_is_too_little_to_tell():
    one = series(100)
    assert cost_interval([evaluation(one, coloured(100, 0.9, 1))]) is None
    lost = np.full(10_000, 5.0)
    lost[9000:] = np.nan
    assert cost_interval([evaluation(series(), lost)]) is None


def test_block_in_seconds_follows_the_correlation_time():
    slow, fast = (
        cost_interval([evaluation(series(20_000), 50.0 * coloured(20_000, pole, 7))]) for pole in (0.995, 0.3)
    )
    assert slow.block_s > fast.block_s
    assert fast.block_s > 1.0 / RATE
