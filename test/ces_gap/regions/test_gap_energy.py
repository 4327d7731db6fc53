import numpy as np
import pytest
from gap_traces import ar, ar_noise, drive

from ces_gap.regions.energy import ar_spectrum, gap_energy, octaves, split_into_bands


def test_bands_add_up_to_the_series_and_to_its_energy():
    y = np.random.default_rng(0).normal(size=3001) + 4.0
    parts = split_into_bands(y, 500.0, octaves([y], [500.0]))
    assert parts.sum(axis=1) == pytest.approx(y)
    assert (parts**2).sum() == pytest.approx((y**2).sum())


def test_octaves_are_no_narrower_than_a_short_recording_resolves():
    assert octaves([np.zeros(10_000)], [500.0])[:3] == pytest.approx([0.0, 0.5, 1.0])
    assert octaves([np.zeros(500)], [500.0])[:3] == pytest.approx([0.0, 4.0, 8.0])
    assert octaves([np.zeros(1000)], [100.0])[-2:] == pytest.approx([32.0, 50.0])


def test_autoregressive_noise_has_its_spectrum():
    rng = np.random.default_rng(1)
    noise, edges = ar(3.0, 0.8), np.array([0.0, 8.0, 32.0, 100.0, 250.0])
    y = ar_noise(60_000, 3.0, 0.8, rng)
    frequency = np.linspace(0.0, 250.0, 20_000)
    density = ar_spectrum(noise, frequency, 500.0)
    for k, share in enumerate((split_into_bands(y, 500.0, edges) ** 2).sum(axis=0) / (y @ y)):
        inside = (frequency >= edges[k]) & (frequency < edges[k + 1])
        assert density[inside].sum() / density.sum() == pytest.approx(share, rel=0.08)


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
