"""The batch run of a physical model is that of the estimator, tick by tick, within the envelope and beyond it."""

import numpy as np
import pytest
from planted import RATE_HZ
from planted_dampers import KINDS, planted_model

from ces_identify.structures import run_batch

SEGMENTS = np.array([[0, 1500], [1700, 3000]])


def hostile_inputs(model, size):
    """Motion through, out of and far out of the envelope, with jumps of speed and current."""
    random = np.random.default_rng(8)
    t = np.arange(3000) / RATE_HZ
    bounds = model.envelope.by_signal
    rows = []
    for name in ("position", "speed", "current"):
        low, high = bounds[name]
        wave = np.sin(2 * np.pi * random.uniform(2, 9) * t + random.uniform(0, 6)) + 0.3 * random.standard_normal(3000)
        rows.append(0.5 * (low + high) + size * 0.5 * (high - low) * wave)
    return np.array(rows)


@pytest.mark.parametrize("size", [0.7, 1.5, 6.0])
@pytest.mark.parametrize("kind", KINDS)
def test_batch_and_tick_by_tick_agree(kind, size):
    model = planted_model(kind)
    inputs = hostile_inputs(model, size)
    force, diverged = run_batch(model, inputs, SEGMENTS)
    assert diverged == -1
    run = model.make_predictor()
    for first, stop in SEGMENTS:
        run.reset()
        slow = np.array([run.tick(*tick) for tick in inputs[:, first:stop].T.tolist()])
        np.testing.assert_allclose(force[first:stop], slow, rtol=1e-9, atol=1e-9 * np.abs(slow).max())
    assert np.isnan(force[1500:1700]).all()
    assert np.abs(force[~np.isnan(force)]).max() < model.certificate["force_bound_any_input_N"]
