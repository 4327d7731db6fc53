"""How structures are compared: full fits, the best of them or the mean of those that are nearly as good."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planted import NETWORK, planted

from ces_identify.limits import ChoiceLimits
from ces_identify.numerics.search import INTERRUPTED, Limits, SearchResult
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.prepare.series import prepare
from ces_identify.structures import KITS, auto, run_batch
from ces_identify.structures.auto import REASON, BestStructure, advise, default_sizes, select_fitter
from ces_identify.structures.kit import UNDETERMINED, Fitted, IdentifyOptions
from ces_identify.structures.mixture import mean_of
from ces_observer.errors import CesError
from ces_observer.structures.mixture import Mixture

LASTING = replace(NETWORK, force_envelope_N=(-1.0, 1.0))  # does not forget
PHYSICAL = next(name for name, kit in KITS.items() if kit.models)


@pytest.fixture
def fitted(monkeypatch):
    """Structures without a fit, each with a cost of its own; returns the limits of each fit."""
    limits = {}
    monkeypatch.setattr(auto, "find_forgetting", lambda model, *how: SimpleNamespace(suffices=model is not LASTING))

    def kit(name, cost, models=None):
        def fit(series, sampling, options, listener):
            limits[name] = options.limits
            if cost is None:
                raise CesError("cannot be fitted")
            ended = INTERRUPTED if name == "stopped" else "done"
            model = LASTING if name == "lasting" else NETWORK
            return Fitted(
                model, [SearchResult(np.empty(0, np.int64), np.empty(0), cost, 1, 0, ended)], {"parameters": 3}
            )

        return SimpleNamespace(models=models, auto_work=0.5, auto_s=0.0, fitter=lambda sizes: fit, sizes=())

    def build(**costs):
        monkeypatch.setattr(auto, "KITS", {name: kit(name, cost, name == PHYSICAL) for name, cost in costs.items()})
        return limits

    return build


def choose(**limits):
    return BestStructure({})([], None, IdentifyOptions(limits=Limits(**limits)), lambda result: None)


def test_the_best_is_taken_alone_if_no_other_is_nearly_as_good(fitted):
    limits = fitted(experts=3.0, hydraulic=1.0, other=None, lasting=0.5, recurrent=4.0)
    fit = choose(time=100.0)
    assert fit.how["structure"] == "hydraulic"
    assert fit.how["structures"] == {"hydraulic": 1.0, "experts": 3.0, "recurrent": 4.0}
    assert fit.how[REASON].startswith("hydraulic is taken: the next costs more than 1.6 times")
    assert {name for name, limit in limits.items() if limit.work == 1.0} == {"hydraulic"}  # fitted again, in full
    assert limits["recurrent"].hopeless == 3.0
    assert limits["experts"].time == pytest.approx(20.0, abs=1.0)


def test_no_structure_is_begun_when_the_time_is_nearly_up(fitted, monkeypatch):
    limits, clock = fitted(experts=3.0, hydraulic=1.0, recurrent=4.0), iter([0.0, *[90.0] * 9])
    monkeypatch.setattr(auto, "clock_s", lambda: next(clock))
    fit = choose(time=100.0)
    assert fit.how["structures"] == {"experts": 3.0} and list(limits) == ["experts"]
    assert fit.results[0].structure == "experts"
    assert "--time ended the comparison of structures, without hydraulic and recurrent:" in fit.how[UNDETERMINED][0]


def test_those_that_are_nearly_as_good_are_averaged_by_their_costs(fitted):
    fitted(experts=1.0, hydraulic=1.5, recurrent=1.61)
    fit = choose()
    weights = [member.weight for member in fit.model.body.members]
    assert weights == pytest.approx([0.6, 0.4])
    assert fit.how["structure"] == "experts and hydraulic"
    assert "the mean of experts (0.60) and hydraulic (0.40) is taken" in fit.how[REASON]
    assert fit.model.is_stable() and fit.model.certificate is not None


def test_an_interrupted_fit_is_the_last_and_without_any_there_is_an_error(fitted):
    limits = fitted(stopped=2.0, hydraulic=1.0)
    assert choose().how["structure"] == "stopped" and list(limits) == ["stopped"]
    fitted(other=None)
    with pytest.raises(CesError, match="no structure could be fitted"):
        choose()


def test_a_mean_of_means_is_one_mean_of_all_members():
    inner = mean_of([NETWORK, NETWORK], [0.5, 0.5])
    outer = mean_of([inner, NETWORK], [0.5, 0.5])
    assert isinstance(outer.body, Mixture)
    assert [member.weight for member in outer.body.members] == [0.25, 0.25, 0.5]
    series = prepare(planted(NETWORK, 1), NETWORK.sampling)
    alone, mean = (run_batch(model, series.inputs, series.segments)[0] for model in (NETWORK, outer))
    assert mean == pytest.approx(alone)


@pytest.mark.parametrize(
    ("costs", "named"),
    [
        ({"polynomial": 5.0, "hydraulic": 4.4}, "hydraulic"),
        ({"polynomial": 5.0, "hydraulic": 4.6}, ""),
        ({"polynomial": 5.0, "hydraulic": 4.0, "recurrent": 3.0}, "recurrent"),
        ({"polynomial": 5.0}, ""),
    ],
)
def test_advice_names_the_best_structure_only_if_it_is_clearly_better(costs, named):
    sentence = advise(costs, "polynomial")
    assert bool(sentence) == bool(named)
    assert not named or (f"--structure {named}" in sentence and f"{costs[named]:.2f} %" in sentence)


def test_a_chosen_structure_is_compared_with_a_short_fit_of_those_with_physics(fitted):
    limits = fitted(polynomial=5.0, **{PHYSICAL: 4.0})
    fit = select_fitter("polynomial", {})([], None, IdentifyOptions(limits=Limits(time=1000.0)), lambda news: None)
    assert fit.how["structures"] == {"polynomial": 5.0, PHYSICAL: 4.0}
    assert (limits["polynomial"].time, limits[PHYSICAL].work) == (
        pytest.approx(650.0, abs=1.0),
        ChoiceLimits.SHORT_WORK,
    )


def test_a_physical_structure_is_not_compared_and_auto_compares_its_candidates():
    sizes = default_sizes()
    assert select_fitter("auto", sizes) == BestStructure(sizes)
    alone, own = select_fitter(PHYSICAL, sizes), KITS[PHYSICAL].fitter(sizes)
    assert (alone.func, alone.args) == (own.func, own.args)


@pytest.mark.slow
def test_auto_gives_the_same_answer_with_any_number_of_threads():
    recording = planted(NETWORK, 1)
    sampling = choose_sampling([recording])
    series = [prepare(recording, sampling)]

    def fit(threads):
        options = IdentifyOptions(limits=Limits(terms=4, starts=2, threads=threads))
        return BestStructure(default_sizes(), ("polynomial", "experts"))(series, sampling, options, lambda result: None)

    alone, together = fit(1), fit(4)
    assert alone.model == together.model
    assert alone.how == together.how
