"""Planted hydraulic networks are found again: their kind, a bypass, their force, and what an engineer knows them by."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from identification_examples import RULES
from planted import SAMPLING
from planted_dampers import KINDS, NOISE_N, planted_model, planted_series, started

from ces_identify.numerics.search import Limits
from ces_identify.physical.quantities import ERRORS, read_quantities
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures import KITS
from ces_identify.structures.auto import advise, default_sizes, select_fitter
from ces_identify.structures.hydraulic import explain_kind, is_held
from ces_identify.structures.kit import IdentifyOptions

SIZES = {**default_sizes(), "curves": "2"}
SHORT = 0.12  # work of a fit that `auto` compares


@cache
def fit(planted, work=SHORT, **sizes):
    """Fit a network to the ride of a planted one."""
    options = IdentifyOptions(limits=Limits(starts=1, threads=1, work=work))
    fitter = KITS["hydraulic"].fitter({**SIZES, **sizes})
    return fitter([planted_series(planted, 1)], SAMPLING, options, lambda result: None)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_kind_that_was_planted_is_picked_with_its_reason(kind):
    fitted = fit(kind)
    assert fitted.model.body.kind == fitted.how["kind"] == kind
    assert fitted.how["kind_reason"].startswith(f"{kind}: ")
    assert ERRORS not in fitted.how


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_fitted_model_repeats_the_planted_force(kind):
    """On the ride without noise, the error is well below the noise that the fit saw."""
    model, clean = fit(kind).model, planted_series(kind, 1, 0.0)
    error = (simulate_series(model, clean).force - clean.force)[clean.scored]
    assert float((error**2).mean() ** 0.5) < NOISE_N
    assert model.certify().holds


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_bound_is_at_most_half_more_than_the_largest_force_recorded(kind):
    largest = np.abs(planted_series(kind, 1).force).max()
    assert fit(kind).model.certify().force_bound_N <= 1.5 * largest * (1.0 + 1e-9)


@pytest.mark.slow
def test_the_damper_is_found_again():
    envelope, interval = started("twin tube").training.envelope, 1.0 / SAMPLING.rate_Hz
    fitted = fit("twin tube", 1.0, kind="twin tube")
    found, true = (
        read_quantities(body, interval, envelope.position_m)
        for body in (fitted.model.body, planted_model("twin tube").body)
    )
    for name in ("Valve lag, rising current [ms]", "Rod area over annulus area"):
        assert found[name] == pytest.approx(true[name], rel=0.3)
    assert fitted.how["kind_reason"] == "twin tube: as asked for"
    assert not [text for text in fitted.how["undetermined"] if "lag" in text]


@pytest.mark.slow
def test_another_structure_is_compared_with_the_physical_one() -> None:
    options = IdentifyOptions(candidates=RULES, limits=Limits(starts=1, threads=1, terms=3))
    fitter = select_fitter("polynomial", {**SIZES, "kind": "twin tube"})
    fitted = fitter([planted_series("twin tube", 1)], SAMPLING, options, lambda result: None)
    costs = fitted.how["structures"]
    assert fitted.model.structure == "polynomial_narx"
    assert costs["hydraulic"] < 0.9 * costs["polynomial"]
    assert "--structure hydraulic" in advise(costs, "polynomial")


def training_with(current, speed):
    training = started("twin tube").training
    n, weights = len(speed), np.ones(len(speed))
    inputs = np.array([training.inputs[0][:n], speed, np.broadcast_to(current, n)])
    data = {"inputs": inputs, "segments": np.array([[0, n]]), "measured": training.measured[:n]}
    return replace(training, **data, estimation=weights, selection=weights)


def test_a_current_that_was_held_is_noticed():
    t = np.arange(4000) / SAMPLING.rate_Hz
    speed, steps = np.sin(9.0 * t), 0.3 * (1.0 + np.floor(t / 2.0))
    assert is_held(training_with(steps, speed), SAMPLING.rate_Hz)
    assert is_held(training_with(0.5, speed), SAMPLING.rate_Hz)
    assert not is_held(training_with(0.5 + 0.3 * np.sin(5.0 * t), speed), SAMPLING.rate_Hz)


def test_a_kind_is_said_with_the_blocks_on_which_it_is_lower():
    fits = [fit_of(kind, error_N) for kind, error_N in (("uniflow", 10.0), ("twin tube", 20.0), ("monotube", 90.0))]
    assert explain_kind(fits, SAMPLING.rate_Hz).startswith("uniflow: lower than twin tube on ")
    assert explain_kind(fits[:1], SAMPLING.rate_Hz) == "uniflow: as asked for"
    alike = [fit_of("uniflow", 10.0, 1), fit_of("twin tube", 10.0, 2)]
    assert explain_kind(alike, SAMPLING.rate_Hz).startswith("uniflow: these recordings cannot tell it from twin tube (")


class WrongBy:
    """Models of a kind whose forces are wrong by noise."""

    def __init__(self, kind, error_N, seed):
        self.kind, self.training = kind, started("twin tube", seconds=30.0).training
        self._noise = np.random.default_rng(seed).normal(0.0, error_N, len(self.training.measured))

    def force(self, theta):
        return self.training.measured + self._noise


def fit_of(kind, error_N, seed=0):
    return SimpleNamespace(models=WrongBy(kind, error_N, seed), theta=None, cost=error_N)
