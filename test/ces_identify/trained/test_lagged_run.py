"""Batch and step by step give the same force, for networks and neuro-fuzzy models too."""

from dataclasses import replace

import numpy as np
import pytest
from planted import FUZZY, NETWORK, SAMPLING, planted, stroked

from ces_data.recording import Channel, Recording
from ces_identify.prepare.series import hold_current, prepare
from ces_identify.simulations.simulate import sample_force, simulate_series
from ces_observer.estimator import Estimator
from ces_observer.model import Envelope, parse_model

TIGHT = Envelope((-0.01, 0.012), (-0.3, 0.3), (0.35, 0.6))
MODELS = [pytest.param(NETWORK, id="network"), pytest.param(FUZZY, id="fuzzy")]


def broken_up(recording, at=(1200, 2500), by_ns=(30_000_000, 90_000_000)):
    """The recording with jitter, a short gap, a long gap and a bad sample."""
    random = np.random.default_rng(2)
    position = recording.channel("position")
    stamps = position.stamps_ns + random.integers(-200_000, 200_000, len(position))
    for index, step in zip(at, by_ns, strict=True):
        stamps[index:] += step
    values = position.values.copy()
    values[777] = np.nan
    current = replace(recording.channel("current"), stamps_ns=stamps)
    return Recording("rough", {"position": Channel("position", "m", stamps, values), "current": current})


def stepped(model, recording):
    estimator = Estimator(model)
    position = recording.channel("position")
    current = hold_current(recording, position.stamps_ns, model.sampling.max_current_age_s)
    rows = zip(position.stamps_ns.tolist(), position.values.tolist(), current.tolist(), strict=True)
    return np.array([np.nan if (f := estimator.step(*row)) is None else f for row in rows])


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("envelope", [NETWORK.envelope, TIGHT], ids=["inside", "clamped"])
def test_estimator_and_batch_agree(model, envelope):
    used = replace(model, envelope=envelope)
    rough = broken_up(stroked(3))
    batch, steps = sample_force(used, rough), stepped(used, rough)
    assert np.isfinite(batch).sum() > 2000
    np.testing.assert_array_equal(np.isfinite(batch), np.isfinite(steps))
    np.testing.assert_allclose(batch, steps, rtol=1e-9, atol=1e-9 * np.nanmax(np.abs(steps)))


@pytest.mark.parametrize("model", MODELS)
def test_every_tick_agrees_with_the_slow_twin(model):
    series = prepare(broken_up(stroked(4)), SAMPLING)
    force = simulate_series(model, series).force
    run = model.make_predictor()
    for start, stop in series.segments:
        run.reset()
        ticks = zip(series.position[start:stop], series.speed[start:stop], series.current[start:stop], strict=True)
        slow = [run.tick(*map(float, tick)) for tick in ticks]
        np.testing.assert_allclose(force[start:stop], slow, rtol=1e-9, atol=1e-7)
    assert len(series.segments) > 1


@pytest.mark.parametrize("model", MODELS)
def test_a_run_that_leaves_the_force_envelope_ends_there_and_begins_anew_after_the_gap(model):
    series = prepare(broken_up(stroked(5)), SAMPLING)
    whole = simulate_series(model, series).force
    high = 0.6 * whole.max()
    run = simulate_series(replace(model, force_envelope_N=(-1e5, high)), series)
    first = int(np.argmax(whole > high))
    assert run.diverged == first
    np.testing.assert_array_equal(run.force[:first], whole[:first])
    stop = series.segments[0, 1]
    assert np.isnan(run.force[first:stop]).all()
    assert np.isfinite(run.force[stop])


@pytest.mark.parametrize("model", MODELS)
def test_a_model_read_back_from_its_file_gives_the_same_force(model):
    series = prepare(planted(model, 6), SAMPLING)
    again = parse_model(model.to_json(), "m.json")
    np.testing.assert_array_equal(simulate_series(again, series).force, simulate_series(model, series).force)
