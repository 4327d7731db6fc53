"""Batch and step by step give the same force: the estimator is the model."""

import numpy as np
import pytest

from ces_data.recording import Channel, Recording
from ces_identify.prepare.series import hold_current
from ces_identify.simulations.simulate import sample_force
from ces_observer.estimator import Estimator
from ces_observer.model import Envelope, Model, Sampling
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

TERMS = (
    Term(800.0, (Factor("speed", 0, 0.5),)),
    Term(500.0, (Factor("speed", 6, 1.0), Factor("current", 11, 1.0, signed=False))),
    Term(0.5, (Factor("force", 1),)),
    Term(0.2, (Factor("force", 9), Factor("current", 0, 2.0, signed=False))),
    Term(3.0, (Factor("position", 2, 1.0),)),
)


def model(rate=1000.0):
    envelope = Envelope((-0.018, 0.02), (-0.6, 0.6), (0.3, 0.65))
    return Model(Sampling(rate, 45.0, 0.004), Polynomial(TERMS), envelope, (-9e3, 9e3))


def rough(jitter_ns, rate=1000.0, gaps=()):
    random = np.random.default_rng(3)
    n = round(4 * rate)
    stamps = (np.arange(n) * 1e9 / rate + random.normal(0, jitter_ns, n)).astype(np.int64) + 10**18
    for at, length in gaps:
        stamps[at:] += length
    t = (stamps - stamps[0]) * 1e-9
    x = 0.02 * np.sin(2 * np.pi * 4 * t) + random.normal(0, 1e-5, n)
    x[[777, 778]] = np.nan, 0.5
    slow = stamps[::10] + 12_345
    current = Channel("current", "A", slow, 0.5 + 0.2 * np.sin(9e-9 * (slow - slow[0])))
    return Recording("rough", {"position": Channel("position", "m", stamps, x), "current": current})


def stepped(m, recording):
    estimator = Estimator(m)
    position = recording.channel("position")
    current = hold_current(recording, position.stamps_ns, m.sampling.max_current_age_s)
    rows = zip(position.stamps_ns.tolist(), position.values.tolist(), current.tolist(), strict=True)
    return np.array([np.nan if (f := estimator.step(*row)) is None else f for row in rows])


@pytest.mark.parametrize(
    ("m", "recording"),
    [
        (model(), rough(0)),
        (model(), rough(60_000)),
        (model(), rough(60_000, gaps=((1500, 30_000_000), (2500, 80_000_000)))),
        (model(400.0), rough(20_000)),
        (model(), rough(5_000, rate=777.0)),
    ],
    ids=["steady", "jitter", "gaps", "slower model", "other rate"],
)
def test_estimator_and_batch_agree(m, recording):
    batch, steps = sample_force(m, recording), stepped(m, recording)
    assert np.isfinite(batch).sum() > 1000
    np.testing.assert_array_equal(np.isfinite(batch), np.isfinite(steps))
    np.testing.assert_allclose(batch, steps, rtol=1e-9, atol=1e-9 * np.nanmax(np.abs(steps)))
