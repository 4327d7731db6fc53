import numpy as np
import pytest
from gap_traces import ar, ar_noise, drive

from ces_gap.regions.energy import gap_energy, octaves


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
