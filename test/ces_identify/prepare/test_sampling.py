"""The sampling rules fit the recordings: their noise, speed and strokes, at any rate and unit, wild samples or not."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from ces_data.recording import Channel, Recording
from ces_data.samples import remove_spikes
from ces_identify.prepare.sampling import choose_sampling, position_spectrum, require_delay
from ces_identify.prepare.series import track
from ces_observer.errors import RecordingError
from ces_observer.model import FREQUENCIES_HZ
from ces_observer.tick.tracker import OK


def stroke(seed, rate, seconds, low_pass=12.0, amplitude=0.012):
    """Low-pass white stroke [m] and its speed [m/s]."""
    white = np.random.default_rng(seed).standard_normal(round((seconds + 2.0) * rate))
    x = sosfiltfilt(butter(4, low_pass, fs=rate, output="sos"), white)
    x *= amplitude / x.std()
    return x[round(rate) : -round(rate)], np.gradient(x, 1.0 / rate)[round(rate) : -round(rate)]


def recording(position, rate, jitter_s=0.0, seed=0, name="made"):
    late = jitter_s * np.random.default_rng(seed).standard_normal(len(position))
    stamps = np.rint((np.arange(len(position)) / rate + late) * 1e9).astype(np.int64)
    return Recording(name, {"position": Channel("position", "m", np.sort(stamps), position)}, {"current": 0.0})


def noisy(seed, rate, noise, *shape):
    x, v = stroke(seed, rate, 20.0, *shape)
    return x + np.random.default_rng(seed + 1).normal(0, noise, len(x)), v


@pytest.mark.parametrize(
    ("rate", "noise", "low_pass"), [(200.0, 20e-6, 5.0), (1000.0, 15e-6, 12.0), (1000.0, 60e-6, 3.0)]
)
def test_noise_and_speed_are_recovered(rate, noise, low_pass):
    x, v = noisy(1, rate, noise, low_pass)
    sampling = choose_sampling([recording(x, rate)])
    assert sampling.noise_m == pytest.approx(noise, rel=0.25)
    assert sampling.speed_m_s == pytest.approx(v.std(), rel=0.05)
    assert sampling.rate_Hz == rate


def test_the_noise_is_that_of_the_mean_in_a_tick():
    """Ten samples for one tick."""
    x, _ = noisy(3, 10_000.0, 30e-6)
    sampling = choose_sampling([recording(x[:100_000], 10_000.0)], 1000.0)
    assert sampling.noise_m == pytest.approx(30e-6 / np.sqrt(10.0), rel=0.25)


def test_modes_reach_as_far_as_the_stroke_and_ticks_follow():
    usual, wide = (choose_sampling([recording(noisy(5, 3000.0, 2e-6, f, 0.002)[0], 3000.0)]) for f in (12.0, 80.0))
    assert (usual.frequencies_Hz, usual.rate_Hz) == (FREQUENCIES_HZ, 1000.0)
    assert wide.frequencies_Hz[-1] > 100.0
    assert 1000.0 < wide.rate_Hz <= 3000.0


def test_units_do_not_matter():
    x, _ = noisy(7, 1000.0, 15e-6)
    metres, inches = (choose_sampling([recording(scale * x, 1000.0)]) for scale in (1.0, 39.37))
    assert inches.frequencies_Hz == metres.frequencies_Hz
    assert inches.noise_m == pytest.approx(39.37 * metres.noise_m, rel=0.01)
    assert inches.outlier_m == pytest.approx(39.37 * metres.outlier_m, rel=0.01)


@pytest.mark.parametrize("size", [3e-4, 0.5])
def test_wild_samples_do_not_disturb_the_choice(size):
    x, _ = noisy(9, 1000.0, 15e-6)
    random = np.random.default_rng(12)
    wild = x.copy()
    for place in random.choice(len(x) - 10, 100, replace=False):
        wild[place : place + random.integers(1, 3)] += size * random.choice([-1.0, 1.0])
    clean, dirty = choose_sampling([recording(x, 1000.0)]), choose_sampling([recording(wild, 1000.0)])
    assert dirty.noise_m == pytest.approx(clean.noise_m, rel=0.3)
    assert dirty.outlier_m == pytest.approx(clean.outlier_m, rel=0.3)
    assert dirty.stroke_m == pytest.approx(clean.stroke_m, rel=0.05)


def test_gaps_jitter_and_late_stamps_do_not_disturb_the_choice():
    x, _ = noisy(11, 1000.0, 15e-6)
    even = choose_sampling([recording(x, 1000.0)])
    rec = recording(x, 1000.0, jitter_s=15e-6)
    stamps = rec.channel("position").stamps_ns.copy()
    stamps[7000:] += 300_000_000
    stamps[9000:9003] -= 5_000_000
    mask = np.random.default_rng(16).random(len(x)) > 0.02
    rough = Recording("rough", {"position": Channel("position", "m", stamps[mask], x[mask])}, {"current": 0.0})
    sampling = choose_sampling([rough])
    assert (sampling.rate_Hz, sampling.frequencies_Hz) == (pytest.approx(1000.0, rel=0.01), even.frequencies_Hz)
    assert sampling.noise_m == pytest.approx(even.noise_m, rel=0.4)


@pytest.mark.parametrize(("rate", "low_pass"), [(200.0, 2.0), (1000.0, 12.0), (3000.0, 2.0)])
def test_a_start_in_motion_succeeds_even_without_noise(rate, low_pass):
    x, v = stroke(23, rate, 20.0, low_pass)
    fastest = int(np.argmax(abs(v[: len(v) // 2])))
    sampling = choose_sampling([recording(x, rate)])
    tracked = track(recording(x, rate).channel("position").stamps_ns[fastest:], x[fastest:], sampling)
    assert (tracked.status[round(0.5 * rate) :] == OK).all()


def test_positions_are_believed_within_a_stroke_and_a_margin():
    """At least 50 mm, or the length of the recorded stroke."""
    for amplitude in (0.005, 0.1):
        x = amplitude * np.sin(2.0 * np.pi * 3.0 * np.arange(5000) / 1000.0)
        low, high = choose_sampling([recording(x + 0.2, 1000.0)]).stroke_m
        margin = max(2.0 * amplitude, 0.05)
        assert (low, high) == pytest.approx((0.2 - amplitude - margin, 0.2 + amplitude + margin), abs=1e-3)


@pytest.mark.parametrize(
    ("rate", "message"),
    [(1e5, "rate=100000: the positions in slow are at 500 Hz"), (520.0, "rate=520: the positions in slow are at")],
)
def test_a_rate_above_the_data_is_refused(rate, message):
    both = [recording(noisy(21, hz, 1e-5)[0], hz, name=name) for hz, name in ((1000.0, "fast"), (500.0, "slow"))]
    with pytest.raises(RecordingError, match=message):
        choose_sampling(both, rate)
    assert choose_sampling(both, 250.0).rate_Hz == 250.0


def test_a_delay_is_whole_ticks_up_to_20_ms():
    made = recording(noisy(23, 1000.0, 1e-5)[0], 1000.0)
    assert choose_sampling([made], 500.0, 0.02).delay_ticks == 10
    with pytest.raises(RecordingError, match=r"delay=0.003: expected whole ticks of 0.002 s .*, such as 0.004$"):
        choose_sampling([made], 500.0, 0.003)
    assert require_delay(0.003, 1000.4) == 3.0 / 1000.4, "a rate that is measured is not round"
    for delay in (0.0005, 0.0033, 0.021, -0.001, float("nan")):
        with pytest.raises(RecordingError, match=r"expected whole ticks of 0\.001 s") as error:
            require_delay(delay, 1000.0)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("rate", [200.0, 1000.0, 3004.8])
def test_level_of_white_noise_and_power_of_a_sine(rate):
    time = np.arange(round(60.0 * rate)) / rate
    noise = np.random.default_rng(1).normal(0.0, 2e-5, len(time))
    spectrum = position_spectrum(recording(noise + 0.01 * np.sin(2 * np.pi * 4.0 * time), rate), 1.0)
    above = spectrum.frequency > 0.1 * rate
    assert spectrum.power[above].mean() == pytest.approx(2e-5**2 / (0.5 * rate), rel=0.05)
    assert spectrum.power[~above].sum() * spectrum.frequency[0] == pytest.approx(0.5 * 0.01**2, rel=0.02)


@pytest.mark.parametrize("run", [1, 2, 3])
def test_spikes_are_replaced_and_the_rest_is_left(run):
    x = np.sin(np.arange(2000) * 0.02) + np.random.default_rng(13).normal(0, 1e-4, 2000)
    dirty = x.copy()
    dirty[300 : 300 + run] += 4.0
    dirty[900 : 900 + run] -= 0.5
    clean = remove_spikes(dirty)
    assert abs(clean - x).max() < 3e-3
    assert np.count_nonzero(clean != x) <= 2 * run + 4


def test_a_position_that_does_not_move_is_refused():
    with pytest.raises(RecordingError, match="still: position does not move"):
        position_spectrum(recording(np.full(5000, 0.01), 1000.0, name="still"), 0.1)


def test_too_short_a_stretch_is_refused():
    with pytest.raises(RecordingError, match="64 position samples in a row"):
        position_spectrum(recording(np.sin(np.arange(40) * 0.1), 1000.0), 0.1)
