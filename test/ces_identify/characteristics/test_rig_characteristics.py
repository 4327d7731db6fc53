"""The virtual rig as a dyno: what its sensors log gives the characteristics that noise-free runs have."""

from types import SimpleNamespace

import numpy as np
import pytest

from ces_identify.characteristics.characterise import characterise
from ces_rig.experiments.virtual import (
    load_experiment,
    measure,
    packaged_experiments,
    parse_experiment,
    run,
    simulate_truth,
)

pytestmark = pytest.mark.slow

SINES = ((0.0075, 2.12, 0.29), (0.015, 3.18, 0.29), (0.0075, 2.12, 0.70), (0.015, 3.18, 0.70))
PART_S, SETTLED_S = 3.5, 1.5  # of each sine; from its beginning until a true loop is taken
FORCE_NOISE = 8.0  # of the rig's load cell
STAMPS_S = 5e-5  # jitter of the stamps of position and force together, several times
LEVELS, HOLD_S = (0.29, 0.70, 0.29, 0.29, 0.70, 0.29), 0.3  # a step in the middle of each stroke of 0.3 s


@pytest.fixture(scope="module")
def dyno():
    """The characteristics of a recording, and the noise-free signals."""
    parts = [{"kind": "sine", "amplitude_m": a, "frequency_Hz": f, "duration_s": PART_S} for a, f, _ in SINES]
    currents = [{"kind": "constant", "current_A": i, "duration_s": PART_S} for _, _, i in SINES]
    triangle = {"kind": "triangle", "amplitude_m": 0.03, "speed_m_s": 0.2, "duration_s": 10.0}
    steps = {"kind": "steps", "levels_A": list(LEVELS), "hold_s": HOLD_S, "duration_s": 10.0}
    described = {
        "duration_s": 24.0,
        "stroke": {"kind": "sequence", "parts": [*parts, triangle]},
        "current": {"kind": "sequence", "parts": [*currents, steps]},
    }
    experiment = parse_experiment(described, "test")
    true = simulate_truth(experiment)
    return SimpleNamespace(results=characterise(measure(experiment, true)), true=true)


def true_loop(true, amplitude, frequency, current):
    """One noise-free cycle with the same history."""
    start = SINES.index((amplitude, frequency, current)) * PART_S + SETTLED_S
    inside = (true.time_s >= start) & (true.time_s < start + 1.0 / frequency)
    speed = np.gradient(true.stroke_m, true.time_s)
    return SimpleNamespace(stroke_m=true.stroke_m[inside], speed_m_s=speed[inside], force_N=true.force_N[inside])


def row_of(rows, amplitude, frequency, current, **wanted):
    return next(
        row
        for row in rows
        if abs(row.current_A - current) < 0.02
        and row.amplitude_m == pytest.approx(amplitude, rel=0.03)
        and row.frequency_Hz == pytest.approx(frequency, rel=0.03)
        and all(getattr(row, name) == value for name, value in wanted.items())
    )


@pytest.mark.parametrize(("amplitude", "frequency", "current"), SINES)
@pytest.mark.parametrize("direction", ["compression", "rebound"])
def test_peak_velocity_forces(dyno, amplitude, frequency, current, direction):
    """The force of the noise-free loop at the same speed, mean of both branches, within noise and 1 %."""
    loop = true_loop(dyno.true, amplitude, frequency, current)
    row = row_of(dyno.results.peak_velocity, amplitude, frequency, current, direction=direction)
    near = loop.speed_m_s / np.sign(row.speed_m_s) >= 0.97 * np.abs(loop.speed_m_s).max()
    noise = FORCE_NOISE / np.sqrt(row.cycles)
    assert row.force_N == pytest.approx(loop.force_N[near].mean(), rel=0.01, abs=3.0 * noise)
    assert row.speed_m_s == pytest.approx(loop.speed_m_s[near].mean(), rel=0.01)


@pytest.mark.parametrize(("amplitude", "frequency", "current"), SINES)
def test_work_of_a_cycle(dyno, amplitude, frequency, current):
    loop, row = (
        true_loop(dyno.true, amplitude, frequency, current),
        row_of(dyno.results.work, amplitude, frequency, current),
    )
    x, force = (np.append(values, values[0]) for values in (loop.stroke_m, loop.force_N))
    work = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(x))
    assert row.work_J == pytest.approx(work, rel=0.01)


@pytest.mark.parametrize(("amplitude", "frequency", "current"), SINES)
def test_hysteresis(dyno, amplitude, frequency, current):
    """At zero speed and at half the peak speed, within noise and what a skew of the stamps makes of it."""
    loop, work = (
        true_loop(dyno.true, amplitude, frequency, current),
        row_of(dyno.results.work, amplitude, frequency, current),
    )
    doubt = 3.0 * 2.0 * FORCE_NOISE / np.sqrt(work.cycles) + work.zero_width_per_ms_N * STAMPS_S * 1e3
    true = loop.force_N[np.argmax(loop.stroke_m)] - loop.force_N[np.argmin(loop.stroke_m)]
    assert work.zero_width_N == pytest.approx(true, rel=0.02, abs=doubt)
    middle = 0.5 * (loop.force_N[np.argmax(loop.stroke_m)] + loop.force_N[np.argmin(loop.stroke_m)])
    assert work.mid_force_N == pytest.approx(middle, rel=0.02, abs=doubt)
    rows = [r for r in dyno.results.continuous if r.amplitude_m == work.amplitude_m and r.current_A == work.current_A]
    rows = [r for r in rows if r.frequency_Hz == work.frequency_Hz]
    for sign in (1.0, -1.0):
        half = [r for r in rows if r.speed_m_s * sign > 0.0]
        before, row, after = half[8:11]  # around half the peak speed
        slope = (after.force_N - before.force_N) / (after.speed_m_s - before.speed_m_s)
        noisy_speed = 3.0 * slope * np.sqrt(2.0 / work.cycles) * dyno.results.recordings[0].speed_noise_m_s
        assert row.width_N == pytest.approx(true_width(loop, row.speed_m_s), rel=0.02, abs=doubt + noisy_speed)


def true_width(loop, speed):
    """The width of the noise-free loop at a speed: decelerating minus accelerating, against the motion."""
    rest = np.sign(speed) * np.append(loop.speed_m_s, loop.speed_m_s[0]) - abs(speed)
    force = np.append(loop.force_N, loop.force_N[0])
    forces = {}
    for k in np.flatnonzero(rest[:-1] * rest[1:] <= 0.0):
        share = rest[k] / (rest[k] - rest[k + 1])
        forces[bool(rest[k + 1] > rest[k])] = force[k] + share * (force[k + 1] - force[k])
    return np.sign(speed) * (forces[False] - forces[True])


@pytest.mark.parametrize(("change", "from_A"), [("up", 0.29), ("down", 0.70)])
@pytest.mark.parametrize(("direction", "sign"), [("compression", 1.0), ("rebound", -1.0)])
def test_response_of_the_valve(dyno, change, from_A, direction, sign):
    row = next(r for r in dyno.results.responses if (r.change, r.direction) == (change, direction))
    true_63, true_rise = np.mean([true_times(dyno.true, at) for at in true_steps(dyno.true, from_A, sign)], axis=0)
    assert row.time_63_s == pytest.approx(true_63, abs=row.time_63_ci95_s)
    assert row.rise_s == pytest.approx(true_rise, rel=0.03, abs=row.rise_ci95_s)


def true_steps(true, from_A, sign):
    """The times of the commanded steps from a level in one direction of motion, at full amplitude."""
    triangle = len(SINES) * PART_S
    steps = np.flatnonzero(np.diff(true.commanded_A) != 0.0) + 1
    speed = np.gradient(true.stroke_m, true.time_s)
    full = (true.time_s[steps] > triangle + 1.0) & (true.time_s[steps] < true.time_s[-1] - 1.0)
    return [k for k in steps[full] if abs(true.commanded_A[k - 1] - from_A) < 1e-6 and speed[k] * sign > 0.15]


def true_times(true, at):
    """63.2 % after the commanded step and 10 to 90 %, to the force in the last third of the rest of the stroke."""
    t, force = true.time_s - true.time_s[at], true.force_N
    before, after = force[(t > -0.03) & (t < 0.0)].mean(), force[(t > 0.09) & (t < 0.135)].mean()
    shares = (force - before) / (after - before)
    t10, t63, t90 = (crossing(t, shares, share) for share in (0.1, 0.632, 0.9))
    return t63, t90 - t10


def crossing(t, shares, share):
    """When the response first reaches a share after the step."""
    k = int(np.argmax((t >= 0.0) & (shares >= share)))
    return np.interp(share, shares[k - 1 : k + 1], t[k - 1 : k + 1])


def test_the_packaged_experiment_shows_all_of_it():
    experiment = load_experiment(packaged_experiments()["characterise"])
    results = characterise(run(experiment))
    assert len({round(row.current_A, 2) for row in results.work}) == 4
    assert len(results.work) == 20
    assert min(row.cycles for row in results.work) >= 3
    assert {(r.change, r.direction) for r in results.responses if r.steps >= 5} == {
        (change, direction) for change in ("up", "down") for direction in ("compression", "rebound")
    }
