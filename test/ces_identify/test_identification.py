"""Planted models are found again, and nothing held out is seen."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from identification_examples import PLANTED, RULES
from identification_examples import planted as planted_ride
from planted import with_values

from ces_data.findings import Finding
from ces_identify.identification import identify
from ces_identify.numerics.search import TIME_IS_UP, Limits
from ces_identify.polynomial.rules_file import parse_rules
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.validation.band import band_half_width
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION
from ces_observer.errors import CesError
from ces_observer.structures.polynomial import Factor, Term

pytestmark = pytest.mark.slow
planted = partial(planted_ride, sampling=choose_sampling([planted_ride(1)]))  # with the speed that is identified
QUICK = Limits(6, 30.0, starts=1, threads=1)


def options(**changes):
    return IdentifyOptions(**{"candidates": RULES, "limits": Limits(6, 30.0, 0.0, 2, 1, 2), **changes})


@pytest.fixture(scope="module")
def result():
    return identify([planted(1), planted(2)], [planted(3, name="fresh")], options(split=1.0))


def test_the_planted_terms_are_found_to_within_the_noise(result):
    found = {term.factors: term.coefficient for term in result.model.body.terms}
    for term in PLANTED.body.terms:
        assert found[term.factors] == pytest.approx(term.coefficient, rel=0.03)


def test_cost_on_a_fresh_recording_is_the_noise_floor(result):
    fresh = next(e for e in result.evaluations if e.name == "fresh")
    floor = 100.0 * 5.0 / np.std(fresh.series.force[fresh.series.scored])
    assert fresh.role == VALIDATION
    assert fresh.cost == pytest.approx(floor, rel=0.1)


def test_the_model_has_a_band_unless_told_otherwise_and_is_the_same_for_the_same_seed(result) -> None:
    assert result.model.band.level == 0.9
    fresh = next(e for e in result.evaluations if e.name == "fresh")
    assert 0.85 <= fresh.coverage <= 0.96  # planted noise; the band widens a little on other strokes
    bare = identify([planted(1), planted(2)], (), options(split=1.0, band=False))
    assert bare.model == replace(result.model, band=None, provenance=bare.model.provenance)
    assert bare.evaluations[0].coverage is None


def test_held_out_data_do_not_change_the_model():
    values = planted(1).channel("force").values.copy()
    late = round(0.75 * len(values)) + 1
    values[late:] = np.random.default_rng(0).normal(0, 1e4, len(values) - late)
    clean = identify([planted(1)], (), options(limits=QUICK))
    other = identify([with_values(planted(1), force=values)], (), options(limits=QUICK))
    assert other.model.body.terms == clean.model.body.terms
    assert [e.role for e in clean.evaluations] == [IDENTIFICATION, VALIDATION]


def test_a_constant_current_leaves_its_terms_out():
    recording = planted(4)
    fixed = with_values(recording, current=np.full(len(recording.channel("current")), 0.5))
    result = identify([fixed], (), options(limits=QUICK))
    assert not any(f.signal == "current" for t in result.model.body.terms for f in t.factors)


def test_a_model_that_explains_nothing_is_refused_unless_one_goes_on(result):
    assert result.require_explained() is result

    def weakened(factor):
        runs = (replace(e.run, force=factor * e.run.force) for e in result.evaluations)
        return tuple(replace(e, run=run) for e, run in zip(result.evaluations, runs, strict=True))

    (best, *_) = result.search_results
    hopeless = replace(result, evaluations=weakened(0.0), search_results=(replace(best, ended="no candidates left"),))
    found = [Finding("warning", "current: odd", "current"), Finding("warning", "force: late", "force")]
    with pytest.raises(CesError, match=r"explains nothing of the force: J is 100\.\d % .*; force: late; ignore"):
        hopeless.require_explained(found)
    with pytest.raises(CesError, match="; the force does not follow these signals: check that topics"):
        hopeless.require_explained()
    brief = replace(hopeless, search_results=(replace(best, ended=TIME_IS_UP),))
    with pytest.raises(CesError, match=r"^the search was stopped after \S+ s; give it more time: the model explains"):
        brief.require_explained()
    (forced,) = hopeless.require_explained(found, ignore_findings=True).model.provenance["forced"]
    assert forced.startswith("the model explains nothing")
    body = replace(result.model.body, terms=(Term(1.0, (Factor("current", 0),)),))
    with pytest.raises(CesError, match=r"no term of the model follows the motion, and J is 4\d"):
        replace(result, model=replace(result.model, body=body), evaluations=weakened(0.6)).require_explained()


def test_spikes_do_not_change_the_model():
    force, current = (planted(1).channel(name).values.copy() for name in ("force", "current"))
    force[300:2000:300], current[500] = 999e3, 500.0
    spoilt = with_values(planted(1), force=force, current=current)
    clean, spiky = (identify([one], (), options(limits=QUICK)) for one in (planted(1), spoilt))
    for one, other in zip(clean.model.body.terms, spiky.model.body.terms, strict=True):
        assert other.factors == one.factors and other.coefficient == pytest.approx(one.coefficient, rel=0.02)


def test_provenance_names_recordings_and_costs(result):
    history = result.model.provenance
    assert [r["recording"] for r in history["identification"]] == ["planted", "planted"]
    assert [c["J"] for c in history["cost_J_percent"]] == [round(e.cost, 4) for e in result.evaluations]


def test_a_constant_force_and_too_short_a_recording_are_refused() -> None:
    recording = planted(5)
    with pytest.raises(CesError, match="measured force is constant"):
        identify([with_values(recording, force=np.zeros(len(recording.channel("force"))))], (), options())
    with pytest.raises(CesError, match=r"warm-up|at least|too short"):
        identify([planted(6, seconds=0.8)], (), options())


def test_the_model_comes_with_its_certificate(result):
    certificate = result.model.certificate
    assert certificate["gain"] == pytest.approx(0.6, rel=0.05)
    assert identify([planted(1)], (), options(certificate=False, limits=QUICK)).model.certificate is None


def test_a_search_without_time_ends_with_its_first_model():
    result = identify([planted(1)], (), options(limits=Limits(6, 0.0, 0.0, 2, 1, 2)))
    assert 1 <= len(result.model.body.terms) <= 2 and result.search_results[0].ended == TIME_IS_UP


def test_weights_pull_the_model_to_their_region():
    """A model too poor for the whole range fits the region that weighs better, and the rest worse."""
    from ces_identify.prepare.cost import parse_weighting

    recording = planted(2)
    poor = parse_rules({"speed": {"lags": [0], "powers": [1.0], "forms": ["signed"]}, "products": [["speed"]]}, "poor")
    slow = parse_weighting(["zero_crossing:0.1=1000"])

    def slow_error(weighting):
        options = IdentifyOptions(1.0, poor, Limits(1, 10.0, starts=1, threads=1), weight=weighting)
        result = identify([recording], options=options)
        one = result.evaluations[0]
        crossing = abs(one.series.speed[one.series.scored]) < 0.1
        return np.abs(one.error[crossing]).mean(), np.abs(one.error[~crossing]).mean(), result.model.provenance

    plain, weighted = slow_error(parse_weighting([])), slow_error(slow)
    assert weighted[0] < 0.9 * plain[0]
    assert weighted[1] > plain[1]
    assert weighted[2]["selection"]["weights"] == "zero_crossing:0.1=1000"


def test_a_model_with_a_delay_has_a_band_of_its_own_and_no_force_for_the_last_ticks():
    now, later = (
        identify([planted(1)], [planted(3, name="fresh")], options(split=1.0, limits=QUICK, delay=delay_s))
        for delay_s in (0.0, 0.004)
    )
    assert later.model.sampling == replace(now.model.sampling, delay_s=0.004)
    assert now.model.band is not None and later.model.band is not None and now.model.band != later.model.band
    for e in later.evaluations:
        np.testing.assert_array_equal(e.half_width, band_half_width(later.model.band, e.series, e.run.force))
    assert not later.evaluations[0].series.scored[-2:].any() and now.evaluations[0].series.scored[-1]
