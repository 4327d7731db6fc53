"""The noise of the measured force: each source finds a planted noise, and knows when it cannot know."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from engine_plant import F, damper
from made_recordings import recording_of
from scipy.signal import butter, lfilter, sosfilt, sosfiltfilt

from ces_gap.sensor_noise import (
    CYCLES,
    HIGH_FREQUENCIES,
    NO_SOURCE,
    QUANTUM,
    STANDSTILL,
    MeasuredNoise,
    NoiseEstimate,
    find_quantum_N,
)
from ces_gap.trace import Trace, make_trace, noise_floor_N

SECONDS, NOISE_N = 20.0, 8.0
Filter = Callable[[F, float], F]


def pass_all(values: F, rate_Hz: float) -> F:
    return values


def smooth(values: F, rate_Hz: float) -> F:
    """A logger's anti-alias filter at 40 Hz."""
    return np.asarray(sosfilt(butter(2, 40.0, fs=rate_Hz, output="sos"), values))


def average(values: F, rate_Hz: float) -> F:
    """An exponential average, whose spectrum is flat near the Nyquist frequency."""
    return np.asarray(lfilter([0.25], [1.0, -0.75], values))


def sine(time: F) -> F:
    return 0.02 * np.sin(2.0 * np.pi * 2.03 * time)


def random(time: F) -> F:
    rng = np.random.default_rng(7)
    tones = [(f, rng.random()) for f in rng.uniform(0.3, 6.0, 12)]
    return np.sum([0.01 / f**0.7 * np.sin(2.0 * np.pi * (f * time + p)) for f, p in tones], axis=0)


def rest(time: F) -> F:
    return np.where(time < 6.0, 0.0, random(time) * np.clip(time - 6.0, 0.0, 1.0))


def measure(
    motion: Callable[[F], F],
    rate_Hz: float,
    passes: Filter = pass_all,
    noise_N: float = NOISE_N,
    quantum_N: float = 1.0,
) -> tuple[MeasuredNoise, float]:
    """Return the noise found, and the true one on the grid [N]."""
    rng = np.random.default_rng(3)
    time = np.arange(round(SECONDS * rate_Hz)) / rate_Hz
    position = motion(time) + 5e-6 * rng.standard_normal(len(time))
    clean = passes(damper(time, motion(time), np.full_like(time, 0.6)), rate_Hz)
    force = clean + passes(noise_N * rng.standard_normal(len(time)), rate_Hz)
    force = quantum_N * np.round(force / quantum_N) if quantum_N else force

    def trace(measured: F) -> Trace:
        recording = recording_of(time, position=position, current=np.full_like(time, 0.6), force=measured)
        return make_trace(recording, np.zeros_like(time))

    noisy = trace(force)
    return noisy.measured_noise, float((noisy.force - trace(clean).force)[noisy.usable].std())


def estimate_of(noise: MeasuredNoise, source: str) -> NoiseEstimate:
    return next(e for e in noise.estimates if e.source == source)


@pytest.mark.parametrize(
    ("motion", "source", "rate_Hz", "passes"),
    [
        (sine, CYCLES, 1000.0, smooth),
        (sine, CYCLES, 200.0, smooth),
        (rest, STANDSTILL, 1000.0, average),
        (rest, STANDSTILL, 200.0, pass_all),
    ],
)
def test_cycles_and_standstill_show_the_noise_behind_any_filter(
    motion: Callable[[F], F], source: str, rate_Hz: float, passes: Filter
) -> None:
    noise, true = measure(motion, rate_Hz, passes)
    assert noise.known and noise.rms_N == pytest.approx(true, rel=0.1)
    assert estimate_of(noise, source).valid and estimate_of(noise, source).rms_N == pytest.approx(true, rel=0.1)


@pytest.mark.parametrize(("motion", "passes"), [(sine, smooth), (random, average), (rest, smooth)])
def test_high_frequencies_cannot_know_behind_a_filter(motion: Callable[[F], F], passes: Filter) -> None:
    estimate = estimate_of(measure(motion, 1000.0, passes)[0], HIGH_FREQUENCIES)
    assert not estimate.valid


def test_without_a_valid_source_the_noise_is_not_known() -> None:
    noise, true = measure(random, 1000.0, smooth)
    assert not noise.known and noise.rms_N < 0.5 * true
    assert noise.describe_source().endswith("not limited by any source")


def test_high_frequencies_show_white_noise_of_any_motion() -> None:
    noise, true = measure(random, 1000.0, noise_N=2.0)
    assert noise.known and noise.describe_source() == HIGH_FREQUENCIES
    assert noise.rms_N == pytest.approx(true, rel=0.1)


@pytest.mark.parametrize("quantum_N", [0.0, 5.0])
@pytest.mark.parametrize("rate_Hz", [200.0, 500.0, 1000.0, 2000.0])
@pytest.mark.parametrize("own_error", [0.0, 0.05])
def test_white_noise_beside_a_simulation_is_right_to_ten_percent(
    rate_Hz: float, quantum_N: float, own_error: float
) -> None:
    """Both as logged and in the narrower band of the grid, also where a rough road reaches the highest frequencies."""
    rng, time = np.random.default_rng(5), np.arange(round(SECONDS * rate_Hz)) / rate_Hz
    position = sosfiltfilt(butter(4, 6.0, fs=rate_Hz, output="sos"), rng.standard_normal(len(time)))
    position *= 0.02 / position.std()
    clean = damper(time, position, np.full_like(time, 0.6))
    force = clean + 6.0 * rng.standard_normal(len(time))
    force = quantum_N * np.round(force / quantum_N) if quantum_N else force
    recording = recording_of(time, position=position, current=np.full_like(time, 0.6), force=force)
    trace = make_trace(recording, (1.0 - own_error) * clean)
    exact = make_trace(recording, clean)
    true = float((exact.force - exact.simulated)[exact.usable].std())
    assert trace.noise_N == pytest.approx(true, rel=0.1)
    assert noise_floor_N([trace], as_logged=True) == pytest.approx(float((force - clean).std()), rel=0.1)


def test_the_colour_of_the_noise_is_stated() -> None:
    white, filtered = (estimate_of(measure(sine, 1000.0, passes)[0], CYCLES).lag1 for passes in (pass_all, smooth))
    assert white == pytest.approx(0.33, abs=0.1) and filtered > white + 0.3  # of the low-pass of the grid


def test_cycles_of_slightly_different_motion_are_corrected_and_others_not_compared() -> None:
    def wander(time: F) -> F:
        return (1.0 + 0.01 * np.sin(2.0 * np.pi * 0.31 * time)) * sine(time)

    def grow(time: F) -> F:
        return (0.5 + 0.05 * time * np.sin(2.0 * np.pi * 0.31 * time)) * sine(time)

    noise, true = measure(wander, 1000.0, smooth)
    assert noise.source == CYCLES and noise.rms_N == pytest.approx(true, rel=0.1)
    assert not estimate_of(measure(grow, 1000.0)[0], CYCLES).valid


def test_the_quantum_is_a_lower_bound() -> None:
    noise, _ = measure(sine, 1000.0, noise_N=0.0, quantum_N=4.0)
    assert noise.rms_N >= estimate_of(noise, QUANTUM).rms_N > 0.5
    assert not estimate_of(noise, HIGH_FREQUENCIES).valid
    assert estimate_of(measure(sine, 1000.0, quantum_N=0.0)[0], QUANTUM).rms_N == 0.0
    assert measure(rest, 1000.0, noise_N=0.0, quantum_N=4.0)[0].source == QUANTUM
    counts = np.round(np.random.default_rng(1).normal(0.0, 300.0, 5000))
    assert find_quantum_N(np.round(counts * 2.4414, 2)) == pytest.approx(2.4414, rel=0.01)  # among rounded numbers


def test_a_recording_without_force_has_no_noise() -> None:
    time = np.arange(4000) / 1000.0
    bare = recording_of(time, position=sine(time), current=time)
    still = recording_of(time, position=sine(time), current=time, force=np.zeros(4000))
    for recording in (bare, still):
        noise = make_trace(recording, np.zeros(4000)).measured_noise
        assert noise.source == NO_SOURCE and noise.rms_N == 0.0 and not noise.known


def test_a_short_recording_does_not_know_its_noise() -> None:
    time = np.arange(150) / 100.0
    short = recording_of(time, position=sine(time), current=time, force=1e3 * sine(time))
    noise = make_trace(short, np.zeros(150)).measured_noise
    assert not noise.known and estimate_of(noise, HIGH_FREQUENCIES).problem == "150 samples"
