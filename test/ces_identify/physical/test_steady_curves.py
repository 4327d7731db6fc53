"""The steady forces of reports: what the model's own run gives on a triangular stroke, and how sure they are."""

import numpy as np
import pytest
from planted import RATE_HZ
from planted_dampers import KINDS, planted_model

from ces_identify.physical.quantities import curve_speeds, recorded_speeds, steady_force_map

SPEEDS, CURRENTS = np.array([-0.3, -0.02, 0.05, 0.4]), np.array([0.35, 0.6])


@pytest.mark.parametrize("kind", KINDS)
def test_they_are_those_of_the_models_own_run(kind):
    model = planted_model(kind)
    stroke = (-0.02, 0.03)
    forces = steady_force_map(KINDS[kind], model.body, 1 / RATE_HZ, stroke, SPEEDS, CURRENTS)
    for n, current in enumerate(CURRENTS):
        for m, speed in enumerate(SPEEDS):
            run, position = model.make_predictor(), 0.005
            ticks = max(int(np.ceil(min(0.025 / abs(speed), 0.3) * RATE_HZ)), 10)
            force = 0.0
            for v in [-speed] * ticks + [speed] * ticks:
                position += v / RATE_HZ
                force = run.tick(position, v, current)
            assert forces[n, m] + model.body.side.gas(0.005) == pytest.approx(force, rel=1e-9)
    assert (np.diff(forces, axis=1) > 0.0).all()


def test_speeds_are_dense_about_zero_and_cover_both_directions():
    speeds = curve_speeds(-1.5, 0.8)
    assert (speeds[0], speeds[-1]) == (-1.5, 0.8)
    assert (np.diff(speeds) > 0.0).all()
    assert np.diff(speeds)[len(speeds) // 2] < 0.2 * np.diff(speeds)[-1]
    assert (np.diff(curve_speeds(0.1, 0.8)) > 0.0).all()


def test_the_recorded_speeds_are_those_about_each_current():
    speed, current = np.array([-1.0, 1.0, -0.2, 0.2]), np.array([0.1, 0.1, 0.9, 0.9])
    spans = recorded_speeds(speed, current, np.array([0.0, 0.5, 1.0]))
    assert spans[1] == [0.0, 0.0]
    np.testing.assert_allclose([spans[0], spans[2]], [[-1.0, 1.0], [-0.2, 0.2]], atol=0.02)
