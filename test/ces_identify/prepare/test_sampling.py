"""The sampling rules fit the recordings: near the best differentiator, at any rate and unit, wild samples or not."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from ces_data.recording import Channel, Recording
from ces_identify.numerics import kernels
from ces_identify.prepare.sampling import (
    EXTRA_SHARE,
    WIDEST,
    best_differentiator,
    choose_sampling,
    innovation_rms,
    position_spectrum,
    speed_error,
)
from ces_observer.errors import RecordingError


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


def true_error(rec, speed, bandwidth, order):
    """RMS speed error as a share of the RMS speed, from the differentiator itself at samples without jitter."""
    c = rec.channel("position")
    rate = 1e9 / np.median(np.diff(c.stamps_ns))
    ticks, *_ = kernels.track(c.stamps_ns, c.values, rate, bandwidth, 10**9, 1e9, order)
    late = slice(round(rate), None)
    return np.std((ticks[: len(speed), 1] - speed[: len(ticks)])[late]) / np.std(speed[late])


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "noise"), [(200.0, 2e-6), (1000.0, 100e-6), (3000.0, 5e-6)])
def test_predicted_error_is_the_error_but_for_the_speed_not_held(rate, noise):
    x, v = stroke(1, rate, 30.0)
    rec = recording(x + np.random.default_rng(2).normal(0, noise, len(x)), rate)
    spectrum = position_spectrum(rec, 1.0)
    for order in (2, 3):
        for bandwidth in (0.03 * rate, 0.08 * rate):
            real = true_error(rec, v, bandwidth, order)
            predicted = speed_error(spectrum, bandwidth, order)
            assert 0.93 * real <= predicted <= np.hypot(1.1 * real, 0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "noise", "low_pass"),
    [(200.0, 20e-6, 12.0), (1000.0, 15e-6, 4.0), (1000.0, 150e-6, 12.0), (3000.0, 15e-6, 4.0)],
)
def test_the_pick_is_near_the_best_for_strokes_a_little_wider_than_recorded(rate, noise, low_pass):
    """Best over both orders and all bandwidths, judged on the stroke plus 2 % of speed power up to 40 Hz."""
    x, v = stroke(3, rate, 20.0, low_pass)
    white = np.random.default_rng(4).normal(0, noise, len(x))
    sampling = choose_sampling([recording(x + white, rate)])
    extra, extra_speed = stroke(5, rate, 20.0, 40.0)
    share = np.sqrt(EXTRA_SHARE) * v.std() / extra_speed.std()
    wider, speed = recording(x + share * extra + white, rate), v + share * extra_speed
    choices = [(b, order) for order in (2, 3) for b in np.geomspace(rate / 150.0, rate * WIDEST[order], 10)]
    best = min(true_error(wider, speed, *choice) for choice in choices)
    assert true_error(wider, speed, sampling.bandwidth_Hz, sampling.order) < 1.2 * best


def test_units_do_not_matter():
    x, _ = stroke(5, 1000.0, 10.0)
    x = x + np.random.default_rng(6).normal(0, 15e-6, len(x))
    metres, inches = (choose_sampling([recording(scale * x, 1000.0)]) for scale in (1.0, 39.37))
    assert (inches.bandwidth_Hz, inches.order) == (metres.bandwidth_Hz, metres.order)
    assert inches.outlier_m == pytest.approx(39.37 * metres.outlier_m, rel=0.01)


def test_coloured_noise_and_a_wide_stroke_ask_for_order_2():
    """As behind an anti-alias filter: content that goes on just above any stroke's, falling from there."""
    rate = 3000.0
    x, _ = stroke(9, rate, 20.0, 35.0, 0.004)
    noise, _ = stroke(10, rate, 20.0, 250.0, 40e-6)
    assert choose_sampling([recording(x + noise, rate)]).order == 2
    assert choose_sampling([recording(x, rate)]).order == 3


@pytest.mark.parametrize("size", [3e-4, 0.5])
def test_wild_samples_do_not_disturb_the_choice(size):
    x, _ = stroke(11, 1000.0, 20.0)
    random = np.random.default_rng(12)
    x = x + random.normal(0, 15e-6, len(x))
    wild = x.copy()
    places = random.choice(len(x) - 10, 100, replace=False)
    for place in places:
        wild[place : place + random.integers(1, 3)] += size * random.choice([-1.0, 1.0])
    clean, dirty = choose_sampling([recording(x, 1000.0)]), choose_sampling([recording(wild, 1000.0)])
    assert dirty.order == clean.order
    assert dirty.bandwidth_Hz == pytest.approx(clean.bandwidth_Hz, rel=0.2)
    assert dirty.outlier_m == pytest.approx(clean.outlier_m, rel=0.3)


def test_gaps_jitter_and_late_stamps_do_not_disturb_the_choice():
    x, _ = stroke(14, 1000.0, 20.0)
    x = x + np.random.default_rng(15).normal(0, 15e-6, len(x))
    even = choose_sampling([recording(x, 1000.0)])
    rec = recording(x, 1000.0, jitter_s=15e-6)
    stamps = rec.channel("position").stamps_ns.copy()
    stamps[7000:] += 300_000_000
    stamps[9000:9003] -= 5_000_000
    mask = np.random.default_rng(16).random(len(x)) > 0.02
    rough = Recording("rough", {"position": Channel("position", "m", stamps[mask], x[mask])}, {"current": 0.0})
    sampling = choose_sampling([rough])
    assert (sampling.rate_Hz, sampling.order) == (pytest.approx(1000.0, rel=0.01), even.order)
    assert sampling.bandwidth_Hz == pytest.approx(even.bandwidth_Hz, rel=0.2)


def test_innovations_are_predicted():
    x, _ = stroke(17, 1000.0, 20.0)
    rec = recording(x + np.random.default_rng(18).normal(0, 15e-6, len(x)), 1000.0)
    c = rec.channel("position")
    for order, bandwidth in ((2, 200.0), (3, 60.0), (3, 120.0)):
        *_, squares = kernels.track(c.stamps_ns, c.values, 1000.0, bandwidth, 10**9, 1e9, order)
        predicted = innovation_rms(position_spectrum(rec, 1.0), bandwidth, order)
        assert predicted == pytest.approx(np.sqrt(squares / len(c)), rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "low_pass"), [(200.0, 2.0), (1000.0, 12.0), (3000.0, 2.0)])
def test_a_start_in_motion_succeeds_even_without_noise(rate, low_pass):
    x, v = stroke(23, rate, 20.0, low_pass)
    fastest = int(np.argmax(abs(v[: len(v) // 2])))
    sampling = choose_sampling([recording(x, rate)])
    stamps = recording(x, rate).channel("position").stamps_ns[fastest:]
    gap = round(sampling.max_gap_s * 1e9)
    _, _, _, status, _, _ = kernels.track(
        stamps, x[fastest:], sampling.rate_Hz, sampling.bandwidth_Hz, gap, sampling.outlier_m, sampling.order
    )
    assert (status[round(0.5 * rate) :] == kernels.STATUS_OK).all()


def test_given_numbers_are_kept():
    x, _ = stroke(19, 1000.0, 10.0)
    rec = recording(x + np.random.default_rng(20).normal(0, 15e-6, len(x)), 1000.0)
    sampling = choose_sampling([rec], 500.0, 77.0)
    assert sampling.rate_Hz == 500.0
    assert (sampling.bandwidth_Hz, sampling.order) == (77.0, 3)
    assert choose_sampling([rec], bandwidth_Hz=77.0).order == 3


def test_recordings_share_one_pick_between_their_own():
    slow, fast = (stroke(21, 1000.0, 15.0, f)[0] for f in (1.5, 14.0))
    noise = np.random.default_rng(22).normal(0, 15e-6, len(slow))
    recs = [recording(slow + noise, 1000.0), recording(fast + noise, 1000.0)]
    low, high = (best_differentiator([position_spectrum(r, 1.0)], (3,))[0] for r in recs)
    both = best_differentiator([position_spectrum(r, 1.0) for r in recs], (3,))[0]
    assert low < both < high


@pytest.mark.parametrize(
    ("rate", "bandwidth", "message"),
    [
        (1e5, None, "--rate 100000: the positions in slow are at 500 Hz"),
        (520.0, None, "--rate 520: the positions in slow are at 500 Hz"),
        (None, 260.0, "--bandwidth 260: above half the model's rate of 500 Hz"),
        (100.0, 60.0, "--bandwidth 60: above half the model's rate of 100 Hz"),
    ],
)
def test_a_rate_above_the_data_and_a_bandwidth_above_half_the_rate_are_refused(rate, bandwidth, message):
    both = [recording(stroke(21, hz, 4.0)[0], hz, name=name) for hz, name in ((1000.0, "fast"), (500.0, "slow"))]
    with pytest.raises(RecordingError, match=message):
        choose_sampling(both, rate, bandwidth)
    assert choose_sampling(both, 500.0, 150.0).rate_Hz == 500.0
