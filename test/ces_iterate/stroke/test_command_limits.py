"""Limits of commands: the projection keeps them exactly, changes nothing inside them and is near the best."""

import numpy as np
import pytest
from scipy.optimize import minimize

from ces_iterate.errors import StrokeError
from ces_iterate.stroke.limits import StrokeLimits, measure_peaks, project_command
from ces_rig.drive.strokes import fade

INTERVAL = 1e-3
LIMITS = StrokeLimits(0.02, 0.6, 40.0)
TIME = np.arange(2001) * INTERVAL


def sine(amplitude, frequency):
    return amplitude * fade(TIME, 0.3) * np.sin(2 * np.pi * frequency * TIME)


def assert_kept(command, limits=LIMITS):
    assert all(
        peak <= limit * (1 + 1e-9)
        for peak, limit in zip(measure_peaks(command, INTERVAL), limits.as_tuple(), strict=True)
    )


def test_an_allowed_command_is_unchanged():
    wanted = sine(0.015, 4.0)
    command, changed = project_command(wanted, np.zeros_like(wanted), INTERVAL, LIMITS)
    assert command is wanted and changed == 0.0


@pytest.mark.parametrize(("amplitude", "frequency"), [(0.05, 1.0), (0.018, 8.0)])
def test_every_limit_is_kept_and_the_command_stays_near(amplitude, frequency):
    wanted, last = sine(amplitude, frequency), sine(0.002, frequency)
    command, changed = project_command(wanted, last, INTERVAL, LIMITS)
    assert_kept(command)
    assert 0.0 < changed <= 1.0
    worst = max(peak / limit for peak, limit in zip(measure_peaks(wanted, INTERVAL), LIMITS.as_tuple(), strict=True))
    assert np.linalg.norm(command - wanted) <= 1.02 * np.linalg.norm(wanted / worst - wanted)  # the scaled command


@pytest.mark.slow
def test_the_projection_is_the_nearest_allowed_command():
    """Beside SciPy's constrained optimiser on a short command."""
    wanted = np.array([0.0, 0.0, 3e-4, 9e-4, 1.8e-3, 1.5e-3, 9e-4, 3e-4, 0.0, 0.0])
    limits = StrokeLimits(1.4e-3, 0.5, 300.0)
    command, _ = project_command(wanted, np.zeros(10), INTERVAL, limits)
    rows = np.concatenate([np.eye(10), np.diff(np.eye(10), axis=0), np.diff(np.eye(10), 2, axis=0)])
    room = np.repeat([limits.stroke_m, limits.speed_m_s * 1e-3, limits.acceleration_m_s2 * 1e-6], [10, 9, 8])
    constraints = [{"type": "ineq", "fun": lambda u, sign=sign: 1e3 * (room - sign * rows @ u)} for sign in (1, -1)]
    best = minimize(lambda u: 1e6 * np.sum((u - wanted) ** 2), np.zeros(10), constraints=constraints, method="COBYLA",
                    options={"maxiter": 20000, "tol": 1e-9, "rhobeg": 1e-4})  # fmt: skip
    assert np.linalg.norm(command - wanted) == pytest.approx(np.linalg.norm(best.x - wanted), rel=0.02)


@pytest.mark.slow
def test_projecting_never_enlarges_distances():
    random = np.random.default_rng(5)
    last = np.zeros(len(TIME))
    a, b = (sine(random.uniform(0.01, 0.04), random.uniform(1, 12)) for _ in range(2))
    near = [project_command(wanted, last, INTERVAL, LIMITS)[0] for wanted in (a, b)]
    assert np.linalg.norm(near[0] - near[1]) <= 1.02 * np.linalg.norm(a - b)


def test_a_broken_limit_is_named():
    for command, says in (
        (sine(0.03, 0.5), r"x: its stroke reaches 0\.03 m, the limit is 0\.02 m"),
        (sine(0.015, 9.0), r"x: its speed reaches 0\.8\d+ m/s, the limit is 0\.6 m/s"),
        (sine(0.004, 20.0), r"x: its acceleration reaches 6\d\.\d+ m/s², the limit is 40 m/s²; choose"),
    ):
        with pytest.raises(StrokeError, match=says):
            LIMITS.require_allowed(command, INTERVAL, "x")
