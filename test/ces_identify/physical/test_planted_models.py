"""Planted models with physics inside are found again, and the best of several structures is which was planted."""

from functools import cache

import pytest
from identification_examples import RULES
from planted import SAMPLING
from planted_dampers import KINDS, NOISE_N, models_of, planted_model, planted_series, true_parameters

from ces_identify.physical.quantities import ERRORS, read_quantities
from ces_identify.polynomial.search_limits import Limits
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures import KITS
from ces_identify.structures.auto import BestStructure, advise, default_sizes, select_fitter
from ces_identify.structures.kit import IdentifyOptions

SIZES = default_sizes()


@cache
def fit_best(kind):
    """Fit the better of both structures to a ride of a planted one."""
    options = IdentifyOptions(limits=Limits(time=8.0, starts=2, threads=1))  # short fits get 1.2 s, which is plenty
    return BestStructure(SIZES, tuple(KINDS))([planted_series(kind, 1)], SAMPLING, options, lambda result: None)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_structure_that_was_planted_is_picked(kind) -> None:
    fitted = fit_best(kind)
    costs = fitted.how["structures"]
    assert fitted.model.structure == fitted.how["structure"] == kind
    assert min(costs, key=costs.get) == kind
    assert set(costs) == {"relaxation", "chambers"}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_fitted_model_repeats_the_planted_force(kind):
    """On the ride without noise, the error is well below the noise that the fit saw."""
    model, clean = fit_best(kind).model, planted_series(kind, 1, 0.0)
    error = (simulate_series(model, clean).force - clean.force)[clean.scored]
    assert float((error**2).mean() ** 0.5) < 0.9 * NOISE_N
    assert model.certify().holds


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_damper_is_found_again(kind):
    envelope, interval = models_of(kind).training.envelope, 1.0 / SAMPLING.rate_Hz
    found, true = (
        read_quantities(KINDS[kind], body, interval, envelope.position_m)
        for body in (fit_best(kind).model.body, planted_model(kind).body)
    )
    stiffness = "Stiffness of oil and mounts [N/mm]" if kind == "relaxation" else "Stiffness of mounts and rod [N/mm]"
    assert found[stiffness] == pytest.approx(true[stiffness], rel=0.15)
    for name in ("Valve lag, rising current [ms]", "Magnetic loop, half width [mA]"):
        assert found[name] == pytest.approx(true[name], rel=0.25)
    assert set(fit_best(kind).how[ERRORS]["quantities"]) == set(found)


@pytest.mark.slow
def test_another_structure_is_compared_with_the_physical_ones() -> None:
    options = IdentifyOptions(candidates=RULES, limits=Limits(time=6.0, starts=1, threads=1, terms=3))
    fitter = select_fitter("polynomial", SIZES)
    fitted = fitter([planted_series("relaxation", 1)], SAMPLING, options, lambda result: None)
    costs = fitted.how["structures"]
    assert fitted.model.structure == "polynomial_narx"
    assert costs["polynomial"] == pytest.approx(fitted.results[0].cost, abs=1e-4)
    assert costs["relaxation"] < 0.9 * costs["polynomial"]
    assert "--structure relaxation" in advise(costs, "polynomial")


def test_a_physical_structure_is_not_compared_and_auto_compares_all() -> None:
    assert select_fitter("auto", SIZES) == BestStructure(SIZES)
    assert select_fitter("chambers", SIZES).__qualname__ == KITS["chambers"].fitter(SIZES).__qualname__


@pytest.mark.parametrize(
    ("costs", "named"),
    [
        ({"polynomial": 5.0, "chambers": 4.4}, "chambers"),
        ({"polynomial": 5.0, "chambers": 4.6}, ""),
        ({"polynomial": 5.0, "chambers": 5.5}, ""),
        ({"polynomial": 5.0, "chambers": 4.0, "relaxation": 3.0}, "relaxation"),
        ({"polynomial": 5.0}, ""),
    ],
)
def test_advice_names_the_best_structure_only_if_it_is_clearly_better(costs, named):
    sentence = advise(costs, "polynomial")
    assert bool(sentence) == bool(named)
    assert not named or (f"--structure {named}" in sentence and f"{costs[named]:.2f} %" in sentence)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fit_starts_far_from_the_true_parameters(kind):
    """Else the tests above would show nothing."""
    models, true = models_of(kind), true_parameters(kind)
    assert (models.force(models.layout.start) - models.force(true)).std() > 3.0 * NOISE_N
