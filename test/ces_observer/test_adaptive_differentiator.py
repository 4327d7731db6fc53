"""The adaptive differentiator follows its definition, suits its bandwidth to the stroke, and stays stable."""

import math
import random

import numpy as np
import pytest

from ces_observer.adaptive_differentiator import MAX_SQUARE, MEMORY_S, NOISE_SHARE, SHARES, AdaptiveDifferentiator
from ces_observer.differentiator import Differentiator

NOISE_M = 15e-6


def samples(seed, stroke, count=4000, jitter=0.2):
    dice = random.Random(seed)
    times = [(k + dice.uniform(-jitter, jitter)) * 1e-3 for k in range(count)]
    return times, [stroke(t) + dice.gauss(0.0, NOISE_M) for t in times]


def sine(frequency, amplitude):
    return lambda t: amplitude * math.sin(2.0 * math.pi * frequency * t)


def run(differentiator, times, positions):
    differentiator.reset(positions[0])
    rows = []
    for before, now, position in zip(times, times[1:], positions[1:], strict=False):
        interval = now - before
        differentiator.correct(interval, position, position - differentiator.predict(interval))
        rows.append((differentiator.position, differentiator.speed, differentiator.acceleration))
    return np.array(rows)


@pytest.mark.parametrize("order", [2, 3])
def test_it_is_the_weighted_mean_of_its_filters(order):
    """Compared with filters run alone, whose weights are computed from the definition in one go."""
    times, positions = samples(1, sine(3.0, 0.02), 600)
    found = run(AdaptiveDifferentiator(90.0, order, NOISE_M), times, positions)
    scores = []
    alone = []
    for share in SHARES:
        one, score, rows = Differentiator(share * 90.0, order), 0.0, []
        one.reset(positions[0])
        for before, now, position in zip(times, times[1:], positions[1:], strict=False):
            error = position - one.predict(now - before)
            one.step(now - before, position)
            variance = NOISE_SHARE * NOISE_M**2 / one.confidence  # of the error, if the bandwidth suits the stroke
            square = min(error**2 / variance, MAX_SQUARE)
            likelihood = -0.5 * (square + math.log(variance / (NOISE_SHARE * NOISE_M**2)))
            score = math.exp(-(now - before) / MEMORY_S) * score + likelihood
            rows.append((one.position, one.speed, one.acceleration, score))
        alone.append(np.array(rows)[:, :3])
        scores.append(np.array(rows)[:, 3])
    weights = np.exp(np.array(scores) - np.max(scores, axis=0))
    weights /= weights.sum(axis=0)
    np.testing.assert_allclose(found, (weights[:, :, None] * np.array(alone)).sum(axis=0), rtol=1e-9, atol=1e-12)
    assert weights.max(axis=1).min() > 0.01  # each filter has its say


@pytest.mark.parametrize(("frequency", "amplitude", "most"), [(2.0, 0.01, 0.6), (12.0, 0.01, 1.2), (25.0, 0.005, 1.2)])
def test_slow_strokes_have_much_less_noise_and_fast_ones_little_more_error(frequency, amplitude, most):
    """Against the single filter of the same bandwidth: RMS error of the speed after the first second."""
    times, positions = samples(2, sine(frequency, amplitude))
    omega = 2.0 * math.pi * frequency
    truth = omega * amplitude * np.cos(omega * np.array(times[1:]))
    adaptive, fixed = (
        np.std((run(one, times, positions)[:, 1] - truth)[1000:])
        for one in (AdaptiveDifferentiator(119.0, 3, NOISE_M), Differentiator(119.0, 3))
    )
    assert adaptive < most * fixed


def test_it_widens_at_once_when_the_stroke_does():
    """A step of acceleration by 300 m/s2 after a slow stroke: within 10 ms the speed is that of the widest filter."""

    def stroke(t):
        return 0.001 * math.sin(6.0 * t) + (150.0 * (t - 2.0) ** 2 if t > 2.0 else 0.0)

    times, positions = samples(3, stroke, 2030)
    found = run(AdaptiveDifferentiator(119.0, 3, NOISE_M), times, positions)
    widest = run(Differentiator(SHARES[-1] * 119.0, 3), times, positions)
    narrowest = run(Differentiator(SHARES[0] * 119.0, 3), times, positions)
    late = slice(2010, None)
    error, limit = np.abs(found - widest)[late, 1].max(), np.abs(narrowest - widest)[late, 1].max()
    assert error < 0.1 * limit


@pytest.mark.parametrize("order", [2, 3])
def test_any_disturbance_decays_under_hostile_intervals(order):
    dice = random.Random(4)
    one = AdaptiveDifferentiator(100.0, order, NOISE_M)
    one.reset(0.0)
    one.correct(1e-3, 0.05, 0.05)
    for _ in range(4000):
        one.correct(1e-3 * 10.0 ** dice.uniform(-1.0, 1.0), 0.0, 0.0)
    assert abs(one.position) < 1e-12 and abs(one.speed) < 1e-9


def test_a_wild_sample_is_forgotten_and_all_stays_finite():
    times, positions = samples(5, sine(2.0, 0.01), 3000)
    positions[1500] += 1e3
    found = run(AdaptiveDifferentiator(119.0, 3, NOISE_M), times, positions)
    clean = run(AdaptiveDifferentiator(119.0, 3, NOISE_M), *samples(5, sine(2.0, 0.01), 3000))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[2600:], clean[2600:], atol=1e-3)
