"""Batch and tick by tick give the same band."""

import numpy as np
import pytest
from bands import BAND, make_band
from residual_series import series

from ces_data.recording import Channel, Recording
from ces_identify.prepare.series import hold_current, prepare
from ces_identify.simulations.simulate import band_half_width, sample_bounds, sample_force
from ces_observer.band import BandRun
from ces_observer.errors import ModelError
from ces_observer.estimator import Estimator
from ces_observer.model import Envelope, Model, Sampling
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

GAPS = np.array([[0, 900], [900, 901], [901, 3000]])


def model(band=BAND):
    terms = (Term(800.0, (Factor("speed", 0, 0.5),)), Term(0.5, (Factor("force", 1),)))
    envelope = Envelope((-0.018, 0.02), (-0.6, 0.6), (0.3, 0.65))
    return Model(Sampling(1000.0, 45.0, 0.004), Polynomial(terms), envelope, (-9e3, 9e3), band=band)


def rough():
    """A jittered recording with a gap and an outlier."""
    random = np.random.default_rng(3)
    stamps = (np.arange(4000) * 1e6 + random.normal(0, 6e4, 4000)).astype(np.int64) + 10**18
    stamps[2500:] += 80_000_000
    t = (stamps - stamps[0]) * 1e-9
    x = 0.02 * np.sin(2 * np.pi * 4 * t) + random.normal(0, 1e-5, 4000)
    x[777] = 0.5
    channels = {
        "position": Channel("position", "m", stamps, x),
        "current": Channel("current", "A", stamps[::10], 0.5 + 0.2 * np.sin(9.0 * t[::10])),
    }
    return Recording("rough", channels)


@pytest.mark.parametrize("band", [BAND, make_band(current_A=(0.5, 0.5)), make_band(max_distance=1e6)])
def test_series_and_ticks_agree(band):
    one = series(3000, segments=GAPS)
    force = np.random.default_rng(0).normal(0.0, 300.0, 3000)
    run, ticked = BandRun(band, one.rate_Hz), np.empty(3000)
    for start, stop in GAPS:
        run.reset()
        for k in range(start, stop):
            run.tick(one.position[k], one.speed[k], one.current[k], force[k])
            ticked[k] = run.half_width()
    np.testing.assert_allclose(band_half_width(band, one, force), ticked, rtol=1e-9)


def test_there_is_no_half_width_without_a_force():
    one, force = series(400, segments=np.array([[0, 200], [200, 400]])), np.ones(400)
    force[150:200] = np.nan
    np.testing.assert_array_equal(np.isnan(band_half_width(BAND, one, force)), np.isnan(force))


def test_bounds_at_the_samples_are_the_estimators():
    recording, m = rough(), model()
    lower, upper = sample_bounds(m, recording)
    estimator, position = Estimator(m), recording.channel("position")
    current = hold_current(recording, position.stamps_ns, m.sampling.max_current_age_s)
    rows = zip(position.stamps_ns.tolist(), position.values.tolist(), current.tolist(), strict=True)
    expected = np.full((2, len(position)), np.nan)
    for k, row in enumerate(rows):
        force = estimator.step(*row)
        if force is not None:
            width = estimator.half_width()
            expected[:, k] = force - width, force + width
    assert np.isfinite(lower).sum() > 2500
    np.testing.assert_allclose(np.stack([lower, upper]), expected, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(0.5 * (lower + upper), sample_force(m, recording))


def test_bounds_need_a_band():
    with pytest.raises(ModelError, match="has no band"):
        sample_bounds(model(None), rough())


def test_the_series_are_those_of_the_estimator():
    assert len(prepare(rough(), model().sampling).segments) == 2
