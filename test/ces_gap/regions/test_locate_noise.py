import numpy as np
import pytest
from gap_traces import ar, ar_noise, drive

from ces_gap.regions.axes import FREQUENCY
from ces_gap.regions.locate import locate

NOISE_N = 8.0


def noisy(traces, seed, pole=0.6):
    rng = np.random.default_rng(seed)
    return [ar_noise(len(t), NOISE_N, pole, rng) for t in traces]


@pytest.mark.parametrize(("pole", "noise"), [(0.0, NOISE_N), (0.6, NOISE_N), (0.9, ar(NOISE_N, 0.9))])
def test_false_discoveries_in_noise_alone_are_as_rare_as_claimed(pole, noise, monkeypatch):
    """In 60 gaps that are noise, about 3 may have any region below 5 %; more than 8 have a chance under 0.3 %."""
    traces = [drive(s, seconds=5.0, rate_Hz=125.0) for s in (1, 2)]
    monkeypatch.setattr("ces_gap.regions.energy.cross_fit_gap", lambda traces, _: [np.zeros(len(t)) for t in traces])
    discoveries = largest = 0
    for seed in range(60):
        where = locate(traces, noisy(traces, seed, pole), noise, seed)
        discoveries += any(r.q_value <= 0.05 for r in where.regions)
        largest += where.max_p_value <= 0.05
    assert discoveries <= 8
    assert largest <= 8


def test_unknown_noise_raises_no_false_alarms_either():
    traces = [drive(1, seconds=5.0, rate_Hz=125.0)]
    discoveries = [min(r.q_value for r in locate(traces, noisy(traces, k), None, k).regions) <= 0.05 for k in range(20)]
    assert sum(discoveries) <= 4


def test_p_values_of_noise_are_spread_evenly():
    traces = [drive(1, seconds=5.0, rate_Hz=125.0)]
    p = [locate(traces, noisy(traces, k), ar(NOISE_N, 0.6), k).max_p_value for k in range(80)]
    assert 0.4 < np.mean(p) < 0.6
    assert 0.35 < np.mean(np.array(p) < 0.5) < 0.65


def test_intervals_cover_the_truth_about_as_often_as_claimed():
    traces = [drive(s, seconds=8.0, rate_Hz=125.0) for s in (1, 2)]
    clean = [80.0 * t.inputs.speed + 4.0 for t in traces]
    truth = {(r.axis, r.low): r.rms_N for r in locate(traces, clean, 1e-6).regions if r.share_of_samples > 0.02}
    covered = []
    for seed in range(40):
        gap = [g + e for g, e in zip(clean, noisy(traces, seed), strict=True)]
        intervals = {(r.axis, r.low): r.ci95_N for r in locate(traces, gap, ar(NOISE_N, 0.6), seed).regions}
        covered += [intervals[k][0] <= true <= intervals[k][1] for k, true in truth.items() if k[0] != FREQUENCY]
    assert 0.90 < np.mean(covered) <= 1.0
