from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from gap_traces import ar, ar_noise, drive, trace_of

from ces_gap.diagnosis import GapRegion, Where
from ces_gap.errors import GapError
from ces_gap.regions.axes import FREQUENCY, OPERATING, REVERSAL, SPEED, STROKE, axis_values
from ces_gap.regions.locate import locate, rms_within_regions
from ces_gap.trace import Trace

NOISE_N = 8.0


def noisy(traces: Sequence[Trace], seed: int = 5, pole: float = 0.6) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [ar_noise(len(t), NOISE_N, pole, rng) for t in traces]


def along(where: Where, axis: str) -> list[GapRegion]:
    return sorted((r for r in where.regions if r.axis == axis), key=lambda r: r.low)


def end_gap(trace: Trace, share: float, height_N: float) -> np.ndarray:
    """A gap at the outer end of the stroke, in a share of the ticks."""
    x = trace.inputs.position
    return np.where(x > np.quantile(x, 1.0 - share), height_N, 0.0)


@pytest.fixture(scope="module")
def traces() -> list[Trace]:
    return [drive(1), drive(2)]


@pytest.mark.parametrize("noise", [NOISE_N, ar(NOISE_N, 0.6), [NOISE_N, NOISE_N], None])
def test_a_gap_in_half_a_percent_of_the_ticks_is_found(traces, noise):
    gap = [end_gap(t, 0.005, 40.0) + e for t, e in zip(traces, noisy(traces), strict=True)]
    where = locate(traces, gap, noise)
    assert where.strongest is not None
    assert (where.strongest.axis, where.strongest.high) == (STROKE, along(where, STROKE)[-1].high)
    assert where.strongest.share_of_samples < 0.01
    assert where.max_p_value < 0.01
    assert where.strongest.q_value < 0.05


def test_that_gap_is_small_in_the_mean_of_all_ticks(traces):
    """The test above means something: over all ticks the gap is an eighth of the noise's energy."""
    rms = np.sqrt(np.mean([np.mean(end_gap(t, 0.005, 40.0) ** 2) for t in traces]))
    assert rms < 0.4 * NOISE_N


def test_shares_add_up_on_every_axis(traces):
    where = locate(traces, [5.0 * np.sign(t.inputs.speed) + e for t, e in zip(traces, noisy(traces), strict=True)], 8.0)
    for axis in (*OPERATING, FREQUENCY):
        assert sum(r.share_of_energy for r in along(where, axis)) == pytest.approx(1.0)
        assert sum(r.share_of_samples for r in along(where, axis)) == pytest.approx(1.0)
    assert [r.share_of_energy for r in where.regions] == sorted(
        (r.share_of_energy for r in where.regions), reverse=True
    )


@pytest.mark.parametrize("noise", [NOISE_N, ar(NOISE_N, 0.6)])
def test_shares_and_rms_are_those_of_the_gap_without_its_noise(traces, noise):
    clean = [200.0 * t.inputs.speed + 3.0 for t in traces]
    truth = locate(traces, clean, 1e-6)
    where = locate(traces, [g + e for g, e in zip(clean, noisy(traces), strict=True)], noise)
    for axis in (*OPERATING, FREQUENCY):
        for true, region in zip(along(truth, axis), along(where, axis), strict=True):
            assert region.share_of_energy == pytest.approx(true.share_of_energy, abs=0.02)
            if axis != FREQUENCY and true.share_of_samples > 0.1 and true.rms_N > NOISE_N:
                assert region.rms_N == pytest.approx(true.rms_N, rel=0.05)


def test_units_are_those_of_the_axes(traces):
    where = locate(traces, noisy(traces), NOISE_N)
    inside = {
        name: np.concatenate([axis_values(t)[name][t.usable] for t in traces])
        for name in OPERATING
        if name != "direction"
    }
    for name, values in inside.items():
        regions = along(where, name)
        assert regions[0].low <= values.min() and values.max() <= regions[-1].high
        seconds = [
            ((values >= r.low) & (values < r.high)).mean() for r in [*regions[:-1], replace(regions[-1], high=np.inf)]
        ]
        assert [r.share_of_samples for r in regions] == pytest.approx(seconds, abs=1e-3)
    assert along(where, FREQUENCY)[-1].high == 250.0
    doubled = locate(traces, [2.0 * g for g in noisy(traces)], 2.0 * NOISE_N)
    for one, two in zip(along(where, SPEED), along(doubled, SPEED), strict=True):
        assert two.rms_N == pytest.approx(2.0 * one.rms_N)
        assert two.ci95_N == pytest.approx((2.0 * one.ci95_N[0], 2.0 * one.ci95_N[1]))


def test_frequency_finds_a_gap_at_12_hz(traces):
    gap = [6.0 * np.sin(2 * np.pi * 12.0 * t.time_s) + e for t, e in zip(traces, noisy(traces), strict=True)]
    where = locate(traces, gap, NOISE_N)
    band = max(along(where, FREQUENCY), key=lambda r: r.share_of_energy)
    assert (band.low, band.high) == (8.0, 16.0)
    assert band.share_of_energy > 0.85
    assert band.rms_N == pytest.approx(6.0 / np.sqrt(2.0), rel=0.1)
    assert band.q_value < 0.001


def test_a_constant_current_is_one_region():
    traces = [drive(3, seconds=6.0, current="constant")]
    (region,) = along(locate(traces, noisy(traces), NOISE_N), "current_A")
    assert (region.share_of_samples, region.q_value) == (1.0, 1.0)
    assert region.low <= 0.8 <= region.high


def test_gap_within_agrees_with_the_regions_and_shrinks_with_the_gap(traces):
    gap = [10.0 * np.sign(t.inputs.speed) + e for t, e in zip(traces, noisy(traces), strict=True)]
    where = locate(traces, gap, ar(NOISE_N, 0.6))
    again = rms_within_regions(where.regions, traces, gap, ar(NOISE_N, 0.6))
    assert again == pytest.approx([r.rms_N for r in where.regions], rel=2e-3, abs=1e-3)
    after = [g - 8.0 * np.sign(t.inputs.speed) for t, g in zip(traces, gap, strict=True)]
    common = [r for r in where.regions if r.share_of_samples > 0.1 and r.axis != FREQUENCY]
    assert max(rms_within_regions(common, traces, after, ar(NOISE_N, 0.6))) < 0.5 * min(r.rms_N for r in common)


def test_a_gap_after_reversals_lies_there():
    t = np.arange(10_000) / 500.0
    trace = trace_of(t, 0.02 * np.sin(2 * np.pi * 2.0 * t), np.full_like(t, 0.8))
    since = axis_values(trace)[REVERSAL]
    where = locate([trace], [np.where(since < 0.02, 25.0, 2.0) + noisy([trace])[0]], NOISE_N)
    soon = [r for r in along(where, REVERSAL) if r.high <= 0.0201]
    assert sum(r.share_of_energy for r in soon) > 0.9
    assert sum(r.share_of_samples for r in soon) == pytest.approx(0.08, abs=0.005)
    assert all(r.q_value < 0.05 for r in soon)


def test_noise_lies_nowhere(traces):
    where = locate(traces, noisy(traces, 8), NOISE_N)
    assert min(r.q_value for r in where.regions) > 0.05


def test_a_gap_at_both_ends_of_the_stroke_lies_in_both_outermost_regions(traces):
    x = np.concatenate([t.inputs.position for t in traces])
    low, high = np.quantile(x, (0.02, 0.98))
    gap = [
        np.where((t.inputs.position < low) | (t.inputs.position > high), 60.0, 0.0) + e
        for t, e in zip(traces, noisy(traces), strict=True)
    ]
    first, *_, last = along(locate(traces, gap, NOISE_N), STROKE)
    assert max(first.q_value, last.q_value) < 0.05
    assert [first.rms_N, last.rms_N] == pytest.approx([60.0, 60.0], rel=0.05)


def test_the_same_seed_gives_the_same_answer(traces):
    gap = noisy(traces)
    assert locate(traces, gap, NOISE_N, 3).regions == locate(traces, gap, NOISE_N, 3).regions
    assert locate(traces, gap, NOISE_N, 3).regions != locate(traces, gap, NOISE_N, 4).regions


def test_a_gap_that_is_not_finite_is_refused(traces):
    broken = noisy(traces)
    broken[1][5000] = np.nan
    with pytest.raises(GapError, match=r"drive2: a gap of shape .* 1 not finite"):
        locate(traces, broken, NOISE_N)
