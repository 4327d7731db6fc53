from dataclasses import replace

import numpy as np
import pytest
from residual_series import RATE, coloured, series

from ces_data.recording import Channel
from ces_identify.prepare.cost import cost
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.prepare.series import prepare
from ces_identify.validation.cycle_noise import CycleNoise, cycle_noise
from ces_rig.experiments.virtual import load_experiment, measure, packaged_experiments, simulate_truth


def cycles(frequency=4.0, noise=10.0, drift=0.0, seconds=20.0, seed=1, current=None, **more):
    """A stroke and a current that repeat, a force that bends sharply, drifts, and is noisy; the truth beside it."""
    n = round(seconds * RATE)
    t = np.arange(n) / RATE
    phase = 2 * np.pi * frequency * t
    random = np.random.default_rng(seed)
    force = 1500.0 * np.tanh(3.0 * np.cos(phase)) * (1.0 + 0.2 * np.sin(phase)) * (1.0 - drift * t / seconds)
    current = 0.5 + 0.15 * np.sin(phase) + 0.001 * random.normal(size=n) if current is None else current
    position = 0.02 * np.sin(phase) + 1e-5 * random.normal(size=n)
    speed = 0.02 * 2 * np.pi * frequency * np.cos(phase)
    noisy = force + noise * random.normal(size=n)
    return series(n, position=position, speed=speed, current=current, force=noisy, **more), force


@pytest.mark.parametrize("frequency", [4.0, 12.0, 3.1, 1.0])
def test_the_noise_of_repeated_cycles_is_found(frequency):
    recorded, clean = cycles(frequency)
    estimate = cycle_noise(recorded)
    assert isinstance(estimate, CycleNoise)
    assert estimate.period_s == pytest.approx(1.0 / frequency, rel=1e-3)
    assert estimate.noise_N == pytest.approx(10.0, rel=0.04)
    assert estimate.floor == pytest.approx(cost(recorded.force, clean), rel=0.05)


def test_a_drift_between_cycles_is_no_noise():
    """A fade by a fifth over the record moves the force 300 N; its cycles differ by 4 N each."""
    estimate = cycle_noise(cycles(drift=0.2)[0])
    assert isinstance(estimate, CycleNoise)
    assert estimate.noise_N == pytest.approx(10.0, rel=0.04)


def test_cycles_across_a_gap_are_not_compared():
    recorded, _ = cycles()
    shifted = recorded.force.copy()
    shifted[5000:] += 800.0
    estimate = cycle_noise(replace(recorded, force=shifted, segments=np.array([[0, 5000], [5000, 10_000]])))
    assert isinstance(estimate, CycleNoise)
    assert estimate.noise_N == pytest.approx(10.0, rel=0.05)


def test_cycles_that_differ_are_left_out():
    recorded, _ = cycles()
    position, force = recorded.position.copy(), recorded.force.copy()
    position[6000:6100] *= 0.2
    force[6000:6100] += 500.0
    estimate = cycle_noise(replace(recorded, position=position, force=force))
    assert isinstance(estimate, CycleNoise)
    assert estimate.noise_N == pytest.approx(10.0, rel=0.05)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (series, "the stroke does not repeat"),
        (lambda: series(position=np.full(10_000, 0.01)), "the stroke does not repeat"),
        (lambda: cycles(current=0.5 + 0.1 * coloured(10_000, 0.999, 3))[0], "from cycle to cycle the current differs"),
        (lambda: cycles(seconds=1.6)[0], "equal cycles"),
    ],
)
def test_no_floor_without_cycles(make, reason):
    estimate = cycle_noise(make())
    assert isinstance(estimate, str) and reason in estimate


def test_a_sweep_does_not_repeat():
    t = np.arange(15_000) / RATE
    sweep = 0.018 * np.sin(2 * np.pi * (2.0 * t + 7.0 * t**2 / 30.0))
    assert isinstance(cycle_noise(series(15_000, position=sweep)), str)


@pytest.mark.slow
def test_the_floor_of_the_rig_is_its_known_noise():
    """Against the noise-free force of the same ticks: what a sensor adds, as it is scored."""
    experiment = load_experiment(packaged_experiments()["sine_4hz"])
    true = simulate_truth(experiment)
    recording = measure(experiment, true)
    force = recording.channel("force")
    _, clean = experiment.sensors.force.sample(true.time_s, true.force_N)
    sampling = choose_sampling([recording])
    recorded = prepare(recording, sampling)
    bare = replace(recording, channels={**recording.channels, "force": Channel("force", "N", force.stamps_ns, clean)})
    known = cost(recorded.force[recorded.scored], prepare(bare, sampling).force[recorded.scored])
    estimate = cycle_noise(recorded)
    assert isinstance(estimate, CycleNoise)
    assert estimate.floor == pytest.approx(known, rel=0.05)
