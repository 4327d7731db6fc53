"""Where a gap lies: axes and bands; planted gaps are found in their regions, noise in none, intervals hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from gap_traces import ar, ar_noise, drive, trace_of
from scipy.stats import gamma, norm

from ces_gap.diagnosis import GapRegion, Where
from ces_gap.errors import GapError
from ces_gap.regions.axes import (
    CURRENT,
    DIRECTION,
    ELAPSED,
    FREQUENCY,
    HEAT,
    OPERATING,
    REVERSAL,
    SPEED,
    STROKE,
    axis_edges,
    axis_values,
    region_indices,
)
from ces_gap.regions.energy import gap_energy, octaves
from ces_gap.regions.locate import (
    locate,
    normal_scores,
    rms_within_regions,
)
from ces_gap.trace import Trace, TraceInputs, usable_inputs

T = np.arange(5000) / 500.0


def sine(frequency_Hz: float = 2.0) -> Trace:
    return trace_of(T, 0.02 * np.sin(2 * np.pi * frequency_Hz * T), np.full_like(T, 0.8))


def test_time_since_reversal_is_a_saw_tooth_of_half_periods():
    trace = sine()
    since = axis_values(trace)[REVERSAL]
    expected = np.mod(trace.time_s - 0.125, 0.25)
    assert np.median(np.abs(since - expected)[trace.usable]) <= trace.step_s
    assert since[trace.usable].max() <= 0.25 + trace.step_s


def test_direction_is_that_of_the_speed_and_positive_in_compression():
    trace = sine()
    direction = axis_values(trace)[DIRECTION]
    moving = trace.usable & (np.abs(trace.inputs.speed) > 0.02)
    assert (direction == np.sign(trace.inputs.speed))[moving].all()


def test_noise_near_standstill_is_no_reversal():
    rng = np.random.default_rng(0)
    trace = sine(0.5)
    speed = trace.inputs.speed + 0.0003 * rng.normal(size=len(trace))
    shaken = replace(trace, inputs=TraceInputs(trace.inputs.position, speed, trace.inputs.current))
    turns = np.diff(axis_values(shaken)[DIRECTION])[trace.usable[1:]] != 0.0
    crossings = np.diff(np.sign(speed))[trace.usable[1:]] != 0.0
    assert turns.sum() == 10
    assert crossings.sum() > 10


def test_a_damper_at_rest_has_no_reversal():
    trace = sine()
    still = replace(trace, inputs=TraceInputs(trace.inputs.position, np.zeros(len(trace)), trace.inputs.current))
    assert axis_values(still)[REVERSAL] == pytest.approx(trace.time_s)


def test_heat_is_the_work_of_the_force():
    trace = sine()
    heat = axis_values(trace)[HEAT]
    amplitude = 2 * np.pi * 2.0 * 0.02
    assert heat[-1] == pytest.approx(0.5 * 1500.0 * 1.8 * amplitude**2 * 10.0, rel=0.02)
    assert (np.diff(heat) >= 0.0).all()


@pytest.mark.parametrize("axis", [STROKE, SPEED, REVERSAL, ELAPSED, HEAT])
def test_edges_hold_all_values_in_a_handful_of_regions_none_empty(axis):
    values = np.concatenate([axis_values(t)[axis][t.usable] for t in (drive(1), drive(2))])
    edges = axis_edges(axis, values)
    assert edges[0] <= values.min() and values.max() <= edges[-1]
    assert 4 <= len(edges) - 1 <= 13
    assert np.bincount(region_indices(edges, values)).min() >= 0.003 * len(values)


def test_every_level_of_a_stepped_current_is_a_region():
    values = np.random.default_rng(0).choice([0.0, 0.4, 0.8, 1.6], 5000)
    assert axis_edges(CURRENT, values) == pytest.approx([0.0, 0.2, 0.6, 1.2, 1.6])


def test_octaves_are_no_narrower_than_a_short_recording_resolves():
    assert octaves([np.zeros(10_000)], [500.0])[:3] == pytest.approx([0.0, 0.5, 1.0])
    assert octaves([np.zeros(500)], [500.0])[:3] == pytest.approx([0.0, 4.0, 8.0])
    assert octaves([np.zeros(1000)], [100.0])[-2:] == pytest.approx([32.0, 50.0])


@pytest.mark.slow
def test_energy_of_noise_is_nothing_on_average_in_every_band():
    traces = [drive(1), drive(2)]
    gaps = [[ar_noise(len(t), 8.0, 0.6, np.random.default_rng(k)) for t in traces] for k in range(4)]
    means = np.mean([gap_energy(traces, g, ar(8.0, 0.6)).band.mean(axis=0) for g in gaps], axis=0)
    assert np.abs(means).max() < 0.02 * 8.0**2


def test_bands_sum_to_the_energy_of_the_ticks():
    traces = [drive(1), drive(2)]
    gap = [90.0 * t.inputs.speed + ar_noise(len(t), 8.0, 0.6, np.random.default_rng(k)) for k, t in enumerate(traces)]
    energy = gap_energy(traces, gap, ar(8.0, 0.6))
    assert energy.band.sum() == pytest.approx(energy.tick.sum())
    true = np.mean(np.concatenate([(90.0 * t.inputs.speed[t.usable]) ** 2 for t in traces]))
    assert energy.tick.mean() == pytest.approx(true, rel=0.06)


NOISE_N = 8.0
NOISE, SILENCE = ar(NOISE_N, 0.6), ar(1e-6, 0.0)


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


def test_a_gap_in_half_a_percent_of_the_ticks_is_found(traces):
    gap = [end_gap(t, 0.005, 40.0) + e for t, e in zip(traces, noisy(traces), strict=True)]
    where = locate(traces, gap, NOISE)
    assert where.strongest is not None
    assert (where.strongest.axis, where.strongest.high) == (STROKE, along(where, STROKE)[-1].high)
    assert where.strongest.share_of_samples < 0.01
    assert where.max_p_value < 0.01
    assert where.strongest.q_value < 0.05


def test_shares_add_up_on_every_axis(traces):
    gap = [5.0 * np.sign(t.inputs.speed) + e for t, e in zip(traces, noisy(traces), strict=True)]
    where = locate(traces, gap, NOISE)
    for axis in (*OPERATING, FREQUENCY):
        assert sum(r.share_of_energy for r in along(where, axis)) == pytest.approx(1.0)
        assert sum(r.share_of_samples for r in along(where, axis)) == pytest.approx(1.0)
    assert [r.share_of_energy for r in where.regions] == sorted(
        (r.share_of_energy for r in where.regions), reverse=True
    )


def test_shares_and_rms_are_those_of_the_gap_without_its_noise(traces):
    clean = [200.0 * t.inputs.speed + 3.0 for t in traces]
    truth = locate(traces, clean, SILENCE)
    where = locate(traces, [g + e for g, e in zip(clean, noisy(traces), strict=True)], NOISE)
    for axis in (*OPERATING, FREQUENCY):
        for true, region in zip(along(truth, axis), along(where, axis), strict=True):
            assert region.share_of_energy == pytest.approx(true.share_of_energy, abs=0.02)
            if axis != FREQUENCY and true.share_of_samples > 0.1 and true.rms_N > NOISE_N:
                assert region.rms_N == pytest.approx(true.rms_N, rel=0.05)


def test_frequency_finds_a_gap_at_12_hz(traces):
    gap = [6.0 * np.sin(2 * np.pi * 12.0 * t.time_s) + e for t, e in zip(traces, noisy(traces), strict=True)]
    where = locate(traces, gap, NOISE)
    band = max(along(where, FREQUENCY), key=lambda r: r.share_of_energy)
    assert (band.low, band.high) == (8.0, 16.0)
    assert band.share_of_energy > 0.85
    assert band.rms_N == pytest.approx(6.0 / np.sqrt(2.0), rel=0.1)
    assert band.q_value < 0.001


def test_a_constant_current_is_one_region():
    traces = [drive(3, seconds=6.0, current="constant")]
    (region,) = along(locate(traces, noisy(traces), NOISE), "current_A")
    assert (region.share_of_samples, region.q_value) == (1.0, 1.0)
    assert region.low <= 0.8 <= region.high


def test_gap_within_agrees_with_the_regions_and_shrinks_with_the_gap(traces):
    gap = [10.0 * np.sign(t.inputs.speed) + e for t, e in zip(traces, noisy(traces), strict=True)]
    where = locate(traces, gap, NOISE)
    again = rms_within_regions(where.regions, traces, gap, NOISE)
    assert again == pytest.approx([r.rms_N for r in where.regions], rel=2e-3, abs=1e-3)
    after = [g - 8.0 * np.sign(t.inputs.speed) for t, g in zip(traces, gap, strict=True)]
    common = [r for r in where.regions if r.share_of_samples > 0.1 and r.axis != FREQUENCY]
    assert max(rms_within_regions(common, traces, after, NOISE)) < 0.5 * min(r.rms_N for r in common)


def test_a_gap_after_reversals_lies_there():
    t = np.arange(10_000) / 500.0
    trace = trace_of(t, 0.02 * np.sin(2 * np.pi * 2.0 * t), np.full_like(t, 0.8))
    since = axis_values(trace)[REVERSAL]
    where = locate([trace], [np.where(since < 0.02, 25.0, 2.0) + noisy([trace])[0]], NOISE)
    soon = [r for r in along(where, REVERSAL) if r.high <= 0.0201]
    assert sum(r.share_of_energy for r in soon) > 0.9
    assert sum(r.share_of_samples for r in soon) == pytest.approx(0.08, abs=0.005)
    assert all(r.q_value < 0.05 for r in soon)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_answer(traces):
    gap = noisy(traces)
    assert locate(traces, gap, NOISE, 3).regions == locate(traces, gap, NOISE, 3).regions
    assert locate(traces, gap, NOISE, 3).regions != locate(traces, gap, NOISE, 4).regions


def test_a_gap_that_is_not_finite_is_refused(traces):
    broken = noisy(traces)
    broken[1][5000] = np.nan
    with pytest.raises(GapError, match=r"drive2: a gap of shape .* 1 not finite"):
        locate(traces, broken, NOISE)


@pytest.mark.slow
@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_false_discoveries_in_noise_alone_are_as_rare_as_claimed(pole):
    """In 40 gaps that are noise, about 2 may have any region below 5 %; more than 6 have a chance under 0.4 %."""
    traces = [drive(s, seconds=5.0, rate_Hz=125.0) for s in (1, 2)]
    discoveries = largest = 0
    for seed in range(40):
        where = locate(traces, noisy(traces, seed, pole), ar(NOISE_N, pole), seed)
        discoveries += any(r.q_value <= 0.05 for r in where.regions)
        largest += where.max_p_value <= 0.05
    assert discoveries <= 6
    assert largest <= 6


@pytest.mark.slow
def test_intervals_cover_the_truth_about_as_often_as_claimed():
    traces = [drive(s, seconds=8.0, rate_Hz=125.0) for s in (1, 2)]
    clean = [80.0 * t.inputs.speed + 4.0 for t in traces]
    truth = {(r.axis, r.low): r.rms_N for r in locate(traces, clean, SILENCE).regions if r.share_of_samples > 0.02}
    covered = []
    for seed in range(25):
        gap = [g + e for g, e in zip(clean, noisy(traces, seed), strict=True)]
        intervals = {(r.axis, r.low): r.ci95_N for r in locate(traces, gap, NOISE, seed).regions}
        covered += [intervals[k][0] <= true <= intervals[k][1] for k, true in truth.items() if k[0] != FREQUENCY]
    assert 0.90 < np.mean(covered) <= 1.0


@pytest.mark.slow
def test_maps_show_where_the_gap_is_and_hide_fields_with_too_few_ticks():
    traces = [drive(1), drive(2)]
    fast = [(np.abs(t.inputs.speed) > 0.1) & (t.inputs.position > 0.0) for t in traces]
    gap = [40.0 * f + ar_noise(len(f), 8.0, 0.6, np.random.default_rng(k)) for k, f in enumerate(fast)]
    maps = locate(traces, gap, NOISE).maps
    assert [m.axes for m in maps] == [(SPEED, STROKE), (SPEED, CURRENT), (SPEED, REVERSAL)]
    for m in maps:
        assert m.rms_N.shape == (len(m.edges[1]) - 1, len(m.edges[0]) - 1)
    ticks = np.histogram2d(*(usable_inputs(traces, n) for n in ("position", "speed")), bins=maps[0].edges[::-1])[0]
    assert np.array_equal(np.isnan(maps[0].rms_N), ticks < 25)
    speed, stroke = (np.convolve(e, (0.5, 0.5), mode="valid") for e in maps[0].edges)
    full = ticks > 100
    hot = full & (stroke[:, None] > 0.004) & (np.abs(speed) > 0.13)
    assert maps[0].rms_N[hot] == pytest.approx(40.0, rel=0.1)
    assert np.median(maps[0].rms_N[full & (stroke[:, None] < 0.0)]) < 6.0


def test_scores_resolve_the_tail_of_a_skewed_null():
    rng = np.random.default_rng(4)
    draws = rng.gamma(3.0, size=(4000, 1)) - 3.0
    value = np.array([9.0])
    true = gamma.sf(12.0, 3.0)
    scored = float(norm.sf(normal_scores(value, draws, 0.0)[0][0]))
    assert scored == pytest.approx(true, rel=0.5)
    assert norm.sf(9.0 / 3.0**0.5) < 0.01 * true  # the normal distribution would have it far too rare
