"""The bank: stable at any shift, gap and sequence of them; as good as its best mode; better when it may wait."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import islice, pairwise
from math import cos, pi, sin

import numpy as np
import pytest
from samplings import make_sampling
from trackers import Bank

NOISE_M = 1e-5
TICK_S = 1e-3
SHIFTS = np.linspace(-1.5, 0.499, 41)  # [ticks] beside and between the bins of the gains
TINY = 1e-9  # [m, m/s]: far from where a mode is lost


def stroke_of(*frequencies_Hz: float, rate_Hz: float = 1000.0, **changes: object):
    sampling = make_sampling(rate_Hz, max_gap_s=64.0 / rate_Hz, **changes)
    return replace(sampling, frequencies_Hz=frequencies_Hz or sampling.frequencies_Hz).stroke


def matrix_of(step, bank: Bank) -> np.ndarray:
    """Return what `step` does to the state of a bank of one mode."""
    columns = []
    for column in TINY * np.eye(bank.size):
        bank.reset(0.0)
        bank.set_mode(column.tolist())
        step()
        columns.append(np.array(bank.modes[0]) / TINY)
    return np.array(columns).T


MOTIONS = [{}, *({"motion": "speed", "motion_noise": noise} for noise in (1e-3, 0.1))]
MOTIONS += [{"motion": "acceleration", "motion_noise": noise} for noise in (0.01, 3.0)]


@pytest.mark.parametrize("changes", MOTIONS, ids=str)
@pytest.mark.parametrize("noise_m", [1e-9, NOISE_M, 1e-3])
@pytest.mark.parametrize(("rate_Hz", "hertz"), [(1000.0, 3.0), (1000.0, 48.0), (200.0, 12.0), (1000.0, 125.0)])
def test_a_mode_is_stable_at_every_shift_and_after_every_number_of_lost_ticks(rate_Hz, hertz, noise_m, changes) -> None:
    bank = Bank(stroke_of(hertz, rate_Hz=rate_Hz, noise_m=noise_m, **changes))
    coast, free = matrix_of(bank.coast, bank), np.eye(bank.size)
    for span in range(1, 65):
        shifts = SHIFTS if span == 1 else SHIFTS[SHIFTS >= -0.5] if span < 9 else (-0.5, 0.01, 0.499)
        for shift in shifts:
            update = matrix_of(lambda span=span, shift=shift: bank.update(span, 0.0, shift), bank)
            assert abs(np.linalg.eigvals(update @ free)).max() < 1.0, (span, shift)
        free = coast @ free


HOSTILE = [  # spans and shifts that drive one mode or another away; no fixed gains withstand all
    [(9, -0.4375), (8, 0.499)],
    [(3, -0.5), (1, -1.0), (17, 0.499)],
    [(1, 0.4375), (5, 0.499), (1, -0.4)],
    [(2, 0.499), (9, -0.5)],
    [(1, -0.5), (1, 0.4375)],
]


def hostile_patterns(count: int) -> list[list[tuple[int, float]]]:
    """Return patterns of intervals of 0.1 to 10 ticks at any shifts, for the most part at their ends."""
    dice = random.Random(3)

    def draw() -> tuple[int, float]:
        span = max(1, round(10.0 ** dice.uniform(-1.0, 1.0)))
        low = -1.0 if span == 1 and dice.random() < 0.3 else -0.5
        return span, dice.choice([low, 0.499, dice.uniform(low, 0.499)])

    def forward(pattern: list[tuple[int, float]]) -> bool:
        steps = zip(pattern, pattern[1:] + pattern[:1], strict=True)
        return all(span + shift - before > 0.05 for (_, before), (span, shift) in steps)

    drawn = ([draw() for _ in range(dice.randint(1, 6))] for _ in range(20 * count))
    return list(islice(filter(forward, drawn), count))


def decay(bank: Bank, pattern: list[tuple[int, float]], steps: int) -> tuple[float, float]:
    """Return the largest late error of position and speed after a start 1 mm and 0.3 m/s off."""
    bank.reset(1e-3, 0.3)
    late = []
    for k in range(steps):
        span, shift = pattern[k % len(pattern)]
        for _ in range(span - 1):
            bank.coast()
        bank.update(span, 0.0, shift)
        assert max(abs(x) for mode in bank.modes for x in mode) < 1e6, "a mode that is driven away comes back"
        if k > 0.8 * steps:
            late.append((abs(bank.position), abs(bank.speed)))
    return tuple(np.max(late, axis=0))


@pytest.mark.parametrize("pattern", HOSTILE, ids=str)
def test_the_mean_stays_near_though_intervals_drive_modes_away(pattern) -> None:
    for noise_m in (1e-9, NOISE_M):
        position, speed = decay(Bank(stroke_of(noise_m=noise_m)), pattern, 1500)
        assert position < 5e-7 and speed < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("changes", MOTIONS, ids=str)
@pytest.mark.parametrize("noise_m", [1e-9, NOISE_M])
def test_every_disturbance_decays_below_the_noise_whatever_the_intervals(noise_m, changes) -> None:
    bank = Bank(stroke_of(noise_m=noise_m, **changes))
    for pattern in HOSTILE + hostile_patterns(80):
        position, speed = decay(bank, pattern, 600)
        assert position < 1e-6 and speed < 1e-3, pattern


# ------------------------------------------------------------------------------------------------------------ accuracy


def sine(hertz: float, speed_m_s: float = 0.3):
    omega = 2.0 * pi * hertz
    return lambda t: speed_m_s / omega * sin(omega * t), lambda t: speed_m_s * cos(omega * t)


def rms_error(hertz: float, frequencies=(), shift=lambda k: 0.0, span=1, delay=0, measured=None, **changes) -> float:
    """Return the RMS error of the speed [m/s] on a sine with noise, after a second."""
    bank, dice = Bank(stroke_of(*frequencies, **changes), delay), random.Random(1)
    position, speed = sine(hertz)
    bank.reset(0.0, speed(0.0))
    errors = []
    for k in range(span, 4000, span):
        at = k + shift(k)
        for _ in range(span - 1):
            bank.coast()
        x = position(at * TICK_S) + dice.gauss(0.0, changes.get("noise_m", NOISE_M))
        bank.update(span, x, shift(k), measured(at * TICK_S, dice) if measured else 0.0)
        known = bank.late[1] if delay and bank.late else bank.speed
        errors.append(known - speed((k - delay) * TICK_S))
    return float(np.std(errors[1000 // span :]))


@pytest.mark.parametrize("hertz", [1.5, 3.0, 10.0, 25.0])
def test_the_bank_is_as_good_as_its_best_mode_alone(hertz) -> None:
    alone = [rms_error(hertz, (one,)) for one in make_sampling().frequencies_Hz]
    assert rms_error(hertz) < 1.1 * min(alone)
    assert max(alone) > 1.8 * min(alone)


def test_position_and_speed_lie_between_those_of_the_modes() -> None:
    dice, together = random.Random(2), Bank(stroke_of(noise_m=1e-4))
    alone = [Bank(stroke_of(one, noise_m=1e-4)) for one in make_sampling().frequencies_Hz]
    x = 0.0
    for _ in range(2000):
        span, x, shift = dice.choice([1, 1, 1, 2, 5]), x + dice.gauss(0.0, 1e-4), dice.uniform(-0.5, 0.5)
        for bank in (together, *alone):
            for _ in range(span - 1):
                bank.coast()
            bank.update(span, x, shift)
        for value, *values in zip(together.mean, *(bank.mean for bank in alone), strict=True):
            assert min(values) - 1e-9 <= value <= max(values) + 1e-9


@pytest.mark.parametrize("speed", [0.01, -0.2, 1.0])
def test_a_constant_speed_is_found_whatever_the_shifts(speed) -> None:
    bank, dice = Bank(stroke_of()), random.Random(4)
    bank.reset(0.0)
    for k in range(1, 2000):
        shift = dice.uniform(-0.5, 0.5)
        bank.update(1, speed * TICK_S * (k + shift), shift)
    assert bank.speed == pytest.approx(speed, rel=2e-3)
    assert bank.position == pytest.approx(speed * TICK_S * 1999, abs=NOISE_M)
    assert bank.mean[2] == pytest.approx(speed * TICK_S * 2000, abs=NOISE_M)


@pytest.mark.parametrize("hertz", [3.0, 14.0])
def test_known_times_of_the_samples_cost_nothing(hertz) -> None:
    """Jitter, a phase and a clock that is off; earlier samples only cost what is not known yet."""
    dice, even = random.Random(5), rms_error(hertz)
    jitter = [dice.uniform(-0.49, 0.49) for _ in range(4000)]
    assert rms_error(hertz, shift=lambda k: jitter[k]) < 1.05 * even
    assert rms_error(hertz, shift=lambda k: (k * 3e-4 + 0.5) % 1.0 - 0.5) < 1.05 * even
    assert rms_error(hertz, shift=lambda k: 0.45) < even
    assert rms_error(hertz, shift=lambda k: -0.9) < 1.4 * even


@pytest.mark.parametrize("hertz", [3.0, 14.0])
def test_a_later_speed_is_better(hertz) -> None:
    errors = [rms_error(hertz, delay=delay) for delay in (0, 1, 3, 5, 10)]
    assert all(later < 0.95 * before for before, later in pairwise(errors))
    assert errors[3] < 0.6 * errors[0]


def test_weights_follow_the_stroke_and_recover_from_a_wild_sample() -> None:
    """Slow, fast, slow: the noise of the slow parts is the same, and a spike matters for a fifth of a second."""
    bank, dice, slow, fast = Bank(stroke_of()), random.Random(6), sine(1.0, 0.05), sine(25.0, 1.0)
    bank.reset(0.0, slow[1](0.0))
    parts: dict[int, list[float]] = {0: [], 1: [], 2: [], 3: []}
    for k in range(1, 8000):
        part, t = k // 2000, k * TICK_S
        position, speed = fast if part == 1 else slow
        bank.update(1, position(t) + dice.gauss(0.0, NOISE_M) + 5e-3 * (k == 6000), 0.0)
        if k % 2000 > 300:
            parts[part].append(bank.speed - speed(t))
    before, between, after, spike = (float(np.std(part)) for part in parts.values())
    assert between > 2.0 * before
    assert max(after, spike) < 1.2 * before


# ------------------------------------------------------------------------------------------------------ a second signal


def test_a_measured_speed_or_acceleration_reduces_the_error() -> None:
    omega, (_, speed) = 2.0 * pi * 8.0, sine(8.0)
    bare = rms_error(8.0)
    known = rms_error(8.0, motion="speed", motion_noise=1e-3, measured=lambda t, dice: speed(t) + dice.gauss(0.0, 1e-3))
    felt = rms_error(
        8.0,
        motion="acceleration",
        motion_noise=0.05,
        measured=lambda t, dice: 9.8 - 0.3 * omega * sin(omega * t) + dice.gauss(0.0, 0.05),
    )
    assert known < 0.3 * bare
    assert felt < 0.3 * bare, "an offset as of gravity is learned within a second"


# ---------------------------------------------------------------------------------------------------- save and restore


@pytest.mark.parametrize("changes", [MOTIONS[0], MOTIONS[-1]], ids=str)
def test_a_restored_bank_goes_on_as_if_nothing_had_come_between(changes) -> None:
    bank, dice = Bank(stroke_of(**changes), 3), random.Random(7)

    def feed(count: int) -> list[tuple[float, ...]]:
        rows = []
        for _ in range(count):
            bank.update(1, dice.gauss(0.0, 1e-3), 0.1, dice.gauss(0.0, 1.0))
            bank.coast()
            rows.append((*bank.mean, bank.late))
        return rows

    feed(50)
    bank.save()
    state = dice.getstate()
    expected = feed(20)
    bank.restore()
    dice.setstate(state)
    assert feed(20) == expected
