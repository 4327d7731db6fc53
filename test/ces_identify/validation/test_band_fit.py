"""The band holds the planted share of noise whose size depends on the state, and widens away from the data."""

from dataclasses import replace

import numpy as np
import pytest
from damper_models import plain_damper
from residual_series import RATE, evaluation, series

from ces_identify.limits import BandLimits
from ces_identify.simulations.simulate import simulate_series, since_reversal
from ces_identify.validation.band import band_half_width, fit_band
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, evaluate
from ces_observer.model import Envelope

MODEL = replace(
    plain_damper(rate_Hz=RATE), envelope=Envelope((-1.0, 1.0), (-9.0, 9.0), (-9.0, 9.0)), force_envelope_N=(-1e5, 1e5)
)


def noisy(seed, noise, n=15_000, scale=1.0, model=MODEL):
    """A ride whose force has noise of the size [N] that `noise(series, force)` says."""
    recorded = series(n, seed, warm_up=50)
    recorded = replace(recorded, speed=scale * recorded.speed)
    force = simulate_series(model, recorded).force
    random = np.random.default_rng(seed + 500)
    return replace(recorded, force=force + noise(recorded, force) * random.normal(size=n))


def by_force_and_reversal(recorded, force):
    return 10.0 + 0.1 * np.abs(force) + 60.0 * np.exp(-since_reversal(recorded) / 0.02)


def coverage(band, recorded, ticks=slice(None)):
    force = simulate_series(MODEL, recorded).force
    inside = np.abs(recorded.force - force) <= band_half_width(band, recorded, force)
    return float(inside[recorded.scored][ticks].mean())


def itself(weights):
    """Refit of a model that is right already."""
    return MODEL


@pytest.fixture(scope="module")
def band():
    return fit_band(MODEL, [noisy(1, by_force_and_reversal), noisy(2, by_force_and_reversal)], itself)


def test_a_fresh_recording_is_covered_evenly_over_force_and_reversals(band) -> None:
    fresh = noisy(8, by_force_and_reversal)
    assert coverage(band, fresh) == pytest.approx(BandLimits.LEVEL, abs=0.02)
    force = np.abs(simulate_series(MODEL, fresh).force[fresh.scored])
    since = since_reversal(fresh)[fresh.scored]
    for signal in (force, since):
        for part in np.array_split(np.argsort(signal), 4):
            assert 0.85 <= coverage(band, fresh, part) <= 0.95


def test_states_that_were_not_recorded_widen_the_band(band):
    def width(scale):
        recorded = noisy(10, lambda s, f: 0.0 * f, scale=scale)
        return float(np.median(band_half_width(band, recorded, np.full(len(recorded), 300.0))))

    assert width(4.0) > 1.5 * width(1.0)


def test_errors_of_refitted_models_count_not_those_of_the_model_itself():
    """A model that gets one recording wrong unless it was fitted to it needs a band for other recordings."""
    rides = [noisy(seed, lambda s, f: np.full(len(f), 5.0)) for seed in (1, 2)]
    first = np.arange(2 * len(rides[0])) < len(rides[0])
    worse = replace(
        MODEL,
        body=replace(MODEL.body, terms=tuple(replace(t, coefficient=0.85 * t.coefficient) for t in MODEL.body.terms)),
    )

    def refit(weights):
        return worse if not weights[first].any() or not weights[~first].any() else MODEL

    own, held_out = (fit_band(MODEL, rides, how) for how in (itself, refit))
    force = simulate_series(MODEL, rides[0]).force
    assert band_half_width(held_out, rides[0], force).mean() > 2.0 * band_half_width(own, rides[0], force).mean()


def test_without_a_refit_or_if_it_fails_the_errors_are_those_of_the_fit() -> None:
    rides = [noisy(seed, by_force_and_reversal) for seed in (3, 4)]
    band = fit_band(MODEL, rides)
    assert coverage(band, rides[0]) == pytest.approx(BandLimits.LEVEL, abs=0.03)
    assert fit_band(MODEL, rides, lambda weights: None) == band


def test_a_single_recording_is_divided_into_stretches():
    seen = []

    def refit(weights):
        seen.append(weights)
        return MODEL

    assert fit_band(MODEL, [noisy(1, by_force_and_reversal)], refit) is not None
    assert len(seen) == 3
    np.testing.assert_array_equal(sum(1.0 - weights for weights in seen), 1.0)


def test_too_little_data_give_no_band():
    assert fit_band(MODEL, [noisy(1, by_force_and_reversal, n=200)], itself) is None


def test_a_constant_current_that_changes_later_widens_the_band():
    fixed = [replace(noisy(s, by_force_and_reversal), current=np.full(15_000, 0.5)) for s in (1, 2)]
    band = fit_band(MODEL, fixed, itself)
    force = simulate_series(MODEL, fixed[0]).force
    usual = band_half_width(band, fixed[0], force)
    other = band_half_width(band, replace(fixed[0], current=np.full(15_000, 0.6)), force)
    assert np.isfinite(usual).all() and np.median(other / usual) > 2.0


def test_evaluations_have_the_coverage_of_the_band(band):
    fresh = noisy(7, by_force_and_reversal)
    with_band, without = (evaluate(m, [fresh], VALIDATION)[0] for m in (replace(MODEL, band=band), MODEL))
    assert with_band.coverage == coverage(band, fresh)
    assert without.coverage is None and without.half_width is None


def test_ticks_after_a_divergence_are_outside_the_band():
    recorded = series(1000)
    error = np.zeros(1000)
    error[600:] = np.nan
    diverged = replace(evaluation(recorded, error, IDENTIFICATION), half_width=np.where(np.isnan(error), np.nan, 1.0))
    assert diverged.coverage == pytest.approx(0.6)
