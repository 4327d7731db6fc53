"""The differentiator is exact on its class and stable at any interval."""

import math
import random
from itertools import pairwise

import pytest

from ces_observer.differentiator import Differentiator
from ces_observer.errors import ModelError


def jittered_times(seed, count, interval, spread=0.3):
    dice = random.Random(seed)
    return [(k + dice.uniform(-spread, spread)) * interval for k in range(count)]


def run(differentiator, times, stroke):
    differentiator.reset(stroke(times[0]))
    speeds = []
    for before, now in pairwise(times):
        differentiator.step(now - before, stroke(now))
        speeds.append(differentiator.speed)
    return speeds


@pytest.mark.parametrize("interval", [3e-4, 1e-3, 5e-3])
def test_order_3_is_exact_for_constant_acceleration_whatever_the_jitter(interval):
    d = Differentiator(0.1 / interval, order=3)
    times = jittered_times(1, 400, interval)
    speeds = run(d, times, lambda t: 0.3 - 0.7 * t + 2.5 * t * t)
    assert speeds[-1] == pytest.approx(-0.7 + 5.0 * times[-1], rel=1e-9)
    assert d.acceleration == pytest.approx(5.0, rel=1e-6)


@pytest.mark.parametrize("interval", [3e-4, 1e-3, 5e-3])
def test_order_2_is_exact_for_constant_speed_and_late_by_its_stated_delay(interval):
    bandwidth = 0.02 / interval
    d = Differentiator(bandwidth, order=2)
    times = jittered_times(2, 800, interval)
    assert run(d, times, lambda t: 0.3 - 0.7 * t)[-1] == pytest.approx(-0.7, rel=1e-9)
    even = [k * interval for k in range(800)]
    late = even[-1] - run(d, even, lambda t: 2.5 * t * t)[-1] / 5.0
    assert late == pytest.approx(math.sqrt(2.0) / (2.0 * math.pi * bandwidth), rel=0.1)


@pytest.mark.parametrize("order", [2, 3])
def test_jitter_costs_a_sine_little(order):
    """With the intervals known, jitter by half an interval leaves the error of even samples as it was."""
    omega = 2.0 * math.pi * 5.0

    def error(spread):
        times = jittered_times(3, 2000, 1e-3, spread)
        speeds = run(Differentiator(100.0, order), times, lambda t: 0.02 * math.sin(omega * t))
        true = [0.02 * omega * math.cos(omega * t) for t in times[1:]]
        return max(abs(a - b) for a, b in zip(speeds[200:], true[200:], strict=True))

    assert error(0.45) < 1.4 * error(0.0)


@pytest.mark.parametrize("order", [2, 3])
def test_gains_for_even_intervals_equal_newly_placed_ones(order):
    """Bit for bit, at each change from even to uneven and back, and when what was predicted is known already."""
    dice, kept = random.Random(7), Differentiator(90.0, order)
    for k in range(400):
        interval = 1e-3 if k % 50 < 40 else dice.uniform(5e-4, 2e-3)
        position = dice.uniform(-0.01, 0.01)
        new = Differentiator(90.0, order)
        new.position, new.speed, new.acceleration = kept.position, kept.speed, kept.acceleration
        new.correct(interval, position, position - new.predict(interval))
        kept.step(interval, position)
        assert (new.position, new.speed, new.acceleration) == (kept.position, kept.speed, kept.acceleration)


@pytest.mark.parametrize(("order", "bandwidth"), [(2, 2.0), (2, 333.0), (3, 2.0), (3, 150.0)])
def test_errors_die_out_at_any_mix_of_intervals(order, bandwidth):
    """Intervals 0.1 to 10 times 1 ms, even, mixed, and in the orders found worst: a disturbed filter forgets."""
    dice = random.Random(4)
    patterns = [[0.1], [10.0], [0.1, 10.0], [1.0, 10.0], [1.72, 10.0, 0.1, 0.1, 0.11, 0.1], [1.8, 10.0, 0.18, 0.1]]
    patterns += [[10.0 ** dice.uniform(-1, 1) for _ in range(dice.randint(2, 9))] for _ in range(60)]
    for pattern in patterns:
        d = Differentiator(bandwidth, order)
        d.speed, d.acceleration = 1.0, 100.0 if order == 3 else 0.0
        elapsed, steps = 0.0, 0
        while elapsed < 30.0 / bandwidth or steps < 3000:
            interval = 1e-3 * pattern[steps % len(pattern)]
            d.step(interval, 0.0)
            elapsed, steps = elapsed + interval, steps + 1
        assert abs(d.position) + abs(d.speed) + abs(d.acceleration) < 1e-6


def test_why_order_3_has_a_widest_bandwidth():
    """At a third of the sampling rate some orders of intervals drive it away; so sampling.WIDEST stops before."""
    d = Differentiator(333.0, 3)
    d.speed = 1e-6
    for k in range(200):
        d.step((1e-3, 1e-2)[k % 2], 0.0)
    assert abs(d.speed) > 1.0


@pytest.mark.parametrize("order", [2, 3])
def test_a_step_of_position_settles_within_two_periods_of_the_bandwidth(order):
    d = Differentiator(50.0, order)
    positions = []
    for _ in range(200):
        d.step(1e-3, 0.01)
        positions.append(d.position)
    assert max(positions) < 0.014
    assert positions[-1] == pytest.approx(0.01, abs=1e-9)
    assert abs(d.speed) < 1e-6
    settled = next(k for k in range(200) if all(abs(x - 0.01) < 2e-4 for x in positions[k:]))
    assert settled <= 40


@pytest.mark.parametrize("order", [2, 3])
def test_bandwidth_does_not_depend_on_the_sampling_rate(order):
    omega = 2.0 * math.pi * 40.0

    def gain(interval):
        times = [k * interval for k in range(round(2.0 / interval))]
        speeds = run(Differentiator(60.0, order), times, lambda t: math.sin(omega * t))
        return max(map(abs, speeds[len(speeds) // 2 :])) / omega

    assert gain(2.5e-4) == pytest.approx(gain(1e-3), rel=0.05)


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, math.inf, math.nan])
def test_a_bandwidth_must_be_positive(bandwidth):
    with pytest.raises(ModelError, match="bandwidth"):
        Differentiator(bandwidth)


def test_an_order_must_be_known():
    with pytest.raises(ModelError, match="order is 4; expected 2 or 3"):
        Differentiator(10.0, order=4)
