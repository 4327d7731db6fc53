"""The verdict: whether there is a gap, probabilities of its causes, calibrated weights."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from engine_plant import WEIGHTS
from hypothesis import given, settings
from hypothesis import strategies as st

from ces_gap.inference.judgement import (
    AMBIGUOUS,
    NAMED,
    NO_GAP,
    TIMING,
    UNKNOWN,
    ClosedShare,
    Doubt,
    GapSize,
    OddsWeights,
    Probabilities,
    SearchFindings,
    VerdictEvidence,
    VerdictFigures,
)
from ces_gap.inference.verdict import confirm_ties, judge, leaves_clearly_more
from ces_gap.limits import VerdictLimits

CLEAR = VerdictFigures(10.0, 30.0, 25.0, 0.02, 0.02, 0)

SHARE = st.floats(-2.0, 3.0)

ABOVE = GapSize(gap_N=40.0, timed_N=40.0, noise_N=8.0)
WITHIN = GapSize(gap_N=4.0, timed_N=4.0, noise_N=8.0)
ODDS = Probabilities(0.01, 0.04, {"friction": 0.93, "gas_spring": 0.01, "calibration": 0.01})
NO_GAP_ODDS = Probabilities(0.8, 0.1, {"friction": 0.1})
MOST, SOME, NOTHING = ClosedShare(0.95, 0.93, 0.97), ClosedShare(0.4, 0.36, 0.44), ClosedShare(0.02, -0.05, 0.06)
FOUND = SearchFindings(
    figures=replace(CLEAR, unexplained=0.03),
    odds=ODDS,
    weights=WEIGHTS,
    size=ABOVE,
    rest_N=8.0,
    visible_from_N=9.0,
    tolerance_N=3.0,
    has_references=True,
    interchangeable=(),
    absorbed=(),
    is_map=False,
)
CLEARLY = VerdictEvidence(FOUND, ABOVE, (36.0, 44.0), ("friction",), MOST, {}, 0.97, in_band_N=8.0)


def changed(evidence: VerdictEvidence, **values: Any) -> VerdictEvidence:
    """Return the evidence with other values, those of the search by name as well."""
    of_search = {key: value for key, value in values.items() if hasattr(FOUND, key)}
    others = {key: value for key, value in values.items() if key not in of_search}
    return replace(evidence, search=replace(evidence.search, **of_search), **others)


BETTER = ClosedShare(0.97, 0.96, 0.98)
PAIR = {"has_references": False, "composition": ("friction", "gas_spring"), "absorbed": ("friction",)}
MAP = {  # named, where it imitates nothing that closes as much
    "has_references": False,
    "composition": ("calibration",),
    "is_map": True,
    "absorbed": ("gas_spring", "friction"),
    "odds": Probabilities(0.01, 0.01, {"calibration": 0.98}),
}
SHARED = Probabilities(0.01, 0.04, {"friction": 0.8, "gas_spring": 0.15})
SMALL = changed(CLEARLY, odds=NO_GAP_ODDS, size=WITHIN, held_out=WITHIN, held_out_ci95_N=(3.0, 5.0))
ALONE = changed(SMALL, has_references=False)


@pytest.mark.parametrize(
    ("values", "verdict", "doubt"),
    [
        ({}, NAMED, ""),
        ({"interchangeable": (("friction", "gas_spring"),)}, AMBIGUOUS, Doubt.ALTERNATIVES),
        ({"odds": SHARED}, AMBIGUOUS, Doubt.ALTERNATIVES),
        ({"closed_alone": {"gas_spring": ClosedShare(0.97, 0.96, 0.98)}}, AMBIGUOUS, Doubt.ALTERNATIVES),
        ({"closed_alone": {"calibration": ClosedShare(0.97, 0.96, 0.98)}}, NAMED, ""),
        ({"odds": SHARED, "closed_alone": {"gas_spring": SOME}}, NAMED, ""),  # held-out recordings decide
        ({"interchangeable": (("friction", "gas_spring"),), "closed_alone": {"gas_spring": SOME}}, NAMED, ""),
        (PAIR, AMBIGUOUS, Doubt.SIMULATION_ERROR),
        ({"has_references": False, "size": replace(ABOVE, gap_N=10.0)}, AMBIGUOUS, Doubt.SIMULATION_ERROR),
        (
            {"odds": Probabilities(0.01, 0.04, {"friction": 0.4, "calibration": 0.55})},
            AMBIGUOUS,
            Doubt.SIMULATION_ERROR,
        ),
        ({"is_undetermined": True}, AMBIGUOUS, Doubt.UNDETERMINED),
        ({"closed": replace(MOST, low=-0.05)}, AMBIGUOUS, Doubt.NOT_CONFIRMED),
        ({"closed": SOME, "learnt": 0.4}, AMBIGUOUS, Doubt.LEAVES_MORE),
        ({"weights": replace(WEIGHTS, least_known=0.97)}, AMBIGUOUS, Doubt.UNCERTAIN),
        (
            {"odds": Probabilities(0.01, 0.29, {"friction": 0.7}), "closed": replace(MOST, value=0.8), "learnt": 0.8},
            AMBIGUOUS,
            Doubt.UNCERTAIN,
        ),
        (
            {"closed": ClosedShare(0.9, 0.88, 0.92)},
            AMBIGUOUS,
            Doubt.REMAINS,
        ),  # a learner without physics leaves 7 N, not 13
        ({"closed": ClosedShare(0.9, 0.88, 0.92), "twin_error": 0.08}, NAMED, ""),  # which the twin's error may hide
        ({"closed": ClosedShare(0.9, 0.88, 0.92), "in_band_N": 11.0}, NAMED, ""),  # as noise does
        ({"has_references": False, "closed_alone": {"calibration": BETTER}}, AMBIGUOUS, Doubt.SIMULATION_ERROR),
        ({"is_rare": True}, NAMED, ""),
        ({**MAP, "closed_alone": {"gas_spring": SOME}}, NAMED, ""),
        ({**MAP, "closed_alone": {"gas_spring": ClosedShare(0.6, 0.5, 0.7)}}, AMBIGUOUS, Doubt.ALTERNATIVES),
        ({"closed": SOME}, UNKNOWN, ""),  # of what a learner closes, too little
        ({"closed": NOTHING, "learnt": -0.3}, UNKNOWN, ""),
        ({"composition": ()}, UNKNOWN, ""),
        ({"is_map": True, "figures": replace(CLEAR, unexplained=0.3)}, UNKNOWN, ""),
        ({"odds": Probabilities(0.01, 0.7, {"friction": 0.29}), "closed": replace(MOST, value=0.8)}, UNKNOWN, ""),
        (
            {"odds": Probabilities(0.01, 0.9, {"friction": 0.09}), "closed": replace(MOST, value=0.99)},
            AMBIGUOUS,
            Doubt.UNCERTAIN,
        ),
    ],
)
def test_what_speaks_against_a_cause(values: dict[str, Any], verdict: str, doubt: str) -> None:
    found = judge(changed(CLEARLY, **values))
    assert (found.verdict, found.doubt) == (verdict, doubt)
    possible = [found.probabilities.none, found.probabilities.unknown]
    causes = values.get("composition", ("friction",))
    possible += [p for name, p in found.probabilities.effects.items() if name not in causes]
    assert (max(possible) >= VerdictLimits.TENTH - 1e-9) == (verdict != NAMED)


def test_a_rare_deviation_is_a_gap_however_small_its_rms() -> None:
    for evidence in (SMALL, ALONE, changed(CLEARLY, tolerance_N=40.0)):
        assert judge(evidence).verdict == NO_GAP
        found = judge(replace(evidence, is_rare=True))
        assert found.verdict != NO_GAP and found.probabilities.none < 0.5


LATE = GapSize(gap_N=15.0, timed_N=0.2, noise_N=3.0)  # by the simulation's timing
LOGGED = changed(CLEARLY, has_references=False, composition=(TIMING,), size=LATE, held_out=LATE)
LOGGED = changed(LOGGED, odds=Probabilities(0.01, 0.01, {TIMING: 0.98}), closed=BETTER, learnt=0.5)


def test_what_the_simulation_does_to_its_inputs_is_a_cause_with_a_name() -> None:
    found = judge(LOGGED)
    assert found.verdict == NAMED and found.probabilities.effects[TIMING] > 0.9


@pytest.mark.parametrize(
    ("evidence", "reason"),
    [
        (SMALL, "baseline_error"),
        (ALONE, "noise"),
        (changed(ALONE, size=replace(WITHIN, gap_N=20.0)), "timing"),
        (changed(CLEARLY, tolerance_N=40.0), "tolerance"),
        (changed(CLEARLY, tolerance_N=39.0), ""),
        (changed(ALONE, odds=ODDS), ""),  # the figures speak for a gap inside the noise, which an effect closes
        (changed(ALONE, odds=ODDS, closed=SOME), "noise"),  # none does: it has no shape
        (changed(ALONE, odds=ODDS, closed=SOME, closed_alone={"gas_spring": MOST}), ""),
        (changed(LOGGED, is_recorded=True), "timing"),
        (LOGGED, ""),  # a simulation that is run has this timing itself
        (changed(ALONE, size=replace(WITHIN, noise_known=False)), ""),
        (replace(ALONE, held_out=replace(WITHIN, noise_known=False)), ""),
        (replace(ALONE, held_out=ABOVE), ""),
        (replace(SMALL, held_out=ABOVE), ""),
    ],
)
def test_the_reason_for_no_gap(evidence: VerdictEvidence, reason: str) -> None:
    found = judge(evidence)
    assert found.reason == reason and (found.verdict == NO_GAP) == bool(reason)
    highest = max(found.probabilities.unknown, *found.probabilities.effects.values())
    assert (found.probabilities.none >= highest) == bool(reason)


def test_a_gap_far_above_the_noise_is_no_noise_that_a_learner_cannot_learn() -> None:
    """What a user met: 63 N RMS were no gap, with a probability of no gap of 0.0005."""
    size = GapSize(63.0, 63.0, 5.7, noise_known=False)
    weak = changed(ALONE, odds=Probabilities(0.0005, 0.71, {"friction": 0.2895}), size=size, held_out=size)
    found = judge(changed(weak, tolerance_N=11.4, closed=SOME))
    assert found.verdict == UNKNOWN and found.probabilities.unknown > 0.7


def test_what_held_out_recordings_reject_gives_its_probability_to_an_unknown_cause_smoothly() -> None:
    closed = [
        replace(CLEARLY, closed=ClosedShare(s, s - 0.1, s + 0.1), in_band_N=40.0) for s in np.linspace(0.2, 0.8, 61)
    ]
    unknown = [judge(one).probabilities.unknown for one in closed]
    assert unknown == sorted(unknown, reverse=True) and max(-np.diff(unknown)) < 0.2
    assert unknown[0] > 0.9 and unknown[-1] < 0.1


def with_own_error(own_error_N: float, **values: Any) -> VerdictEvidence:
    """Evidence without references of a gap of 40 N, of which the simulation says what its own error may be."""
    size = replace(ABOVE, own_error_N=own_error_N)
    return changed(CLEARLY, **{"has_references": False, "size": size, "held_out": size, **values})


LESS = ClosedShare(0.91, 0.89, 0.93)
NOT_KNOWN = Probabilities(0.01, 0.7, {"friction": 0.29})


@pytest.mark.parametrize(
    ("own_error_N", "values", "verdict", "why"),
    [
        (45.0, {"odds": NOT_KNOWN, "closed": SOME}, NO_GAP, "baseline_error"),
        (45.0, {"odds": NOT_KNOWN, "composition": ()}, NO_GAP, "baseline_error"),
        (45.0, {"closed": ClosedShare(0.8, 0.75, 0.85)}, NO_GAP, "baseline_error"),  # as of errors of a model
        (45.0, {"is_map": True}, NO_GAP, "baseline_error"),  # a map of it is its error, however much that closes
        (45.0, {}, AMBIGUOUS, Doubt.SIMULATION_ERROR),  # an effect that closes nearly all of it is not overlooked
        (
            30.0,
            {"closed_alone": {"gas_spring": LESS}},
            AMBIGUOUS,
            Doubt.ALTERNATIVES,
        ),  # the error may make the difference
        (10.0, {"closed_alone": {"gas_spring": LESS}}, NAMED, ""),
        (20.0, {"odds": NOT_KNOWN, "closed": SOME}, UNKNOWN, ""),
        (0.0, {"odds": NOT_KNOWN, "closed": SOME}, UNKNOWN, ""),
        (45.0, {"odds": NOT_KNOWN, "closed": SOME, "has_references": True}, UNKNOWN, ""),  # these measured it
    ],
)
def test_a_gap_within_what_the_simulation_says_of_its_own_error(
    own_error_N: float, values: dict[str, Any], verdict: str, why: str
) -> None:
    found = judge(with_own_error(own_error_N, **values))
    assert (found.verdict, found.reason or found.doubt) == (verdict, why)


def test_the_error_must_cover_the_fitted_and_the_held_out_gap() -> None:
    within = with_own_error(45.0, odds=NOT_KNOWN, closed=SOME)
    assert judge(changed(within, size=ABOVE)).verdict == judge(changed(within, held_out=ABOVE)).verdict == UNKNOWN


ANY = st.floats() | st.floats(0.0, 1.0) | st.sampled_from([0.0, 1.0, 0.5, np.nan, np.inf, -np.inf, 5e-324, 1e308])
SIZES = st.floats() | st.floats(0.0, 100.0)
NAMES = ("friction", "gas_spring", "parameters", "calibration", TIMING)
SOME_NAMES = st.lists(st.sampled_from(NAMES), unique=True).map(tuple)
GAP_SIZES = st.builds(GapSize, SIZES, SIZES, SIZES, st.booleans(), SIZES | st.just(0.0))
SHARES = st.builds(ClosedShare, ANY, ANY, ANY) | st.floats(0.0, 1.0).map(lambda s: ClosedShare(s, s - 0.05, s + 0.05))
SEARCH = st.builds(
    SearchFindings,
    figures=ANY.map(lambda share: replace(CLEAR, unexplained=share)),
    odds=st.builds(Probabilities, ANY, ANY, st.dictionaries(st.sampled_from(NAMES), ANY)),
    weights=st.tuples(SHARE, SHARE).map(lambda least: OddsWeights((), (), 1.0, *least)),
    size=GAP_SIZES,
    rest_N=SIZES,
    visible_from_N=SIZES,
    tolerance_N=SIZES,
    has_references=st.booleans(),
    interchangeable=st.lists(SOME_NAMES.filter(bool), max_size=2).map(tuple),
    absorbed=SOME_NAMES,
    is_map=st.booleans(),
    twin_error=SHARE,
    is_recorded=st.booleans(),
)
ALONE_SHARES = st.dictionaries(st.sampled_from(NAMES), SHARES)
INTERVALS = st.tuples(SIZES, SIZES)
EVIDENCE = st.builds(
    VerdictEvidence,
    *(SEARCH, GAP_SIZES, INTERVALS, SOME_NAMES, SHARES, ALONE_SHARES, ANY),
    *(st.booleans(), SIZES, st.booleans()),
)
ROUNDING = 1e-9


@given(EVIDENCE)
@settings(max_examples=5000, deadline=None, derandomize=True)
def test_no_verdict_contradicts_its_probabilities_or_sizes(e: VerdictEvidence) -> None:
    found = judge(e)
    none, unknown, effects = found.probabilities.none, found.probabilities.unknown, found.probabilities.effects
    causes = {name: p for name, p in effects.items() if name in e.composition}
    others, known = [p for name, p in effects.items() if name not in causes], sum(effects.values())
    assert all(0.0 <= p <= 1.0 for p in (none, unknown, *effects.values()))
    assert none + unknown + known == pytest.approx(1.0)
    closed = [c.value for c in (e.closed, *e.closed_alone.values()) if not np.isnan(c.value)]
    referenced = e.search.has_references
    assert (found.verdict == NO_GAP) == bool(found.reason) and (found.verdict == AMBIGUOUS) == bool(found.doubt)
    if found.verdict == NO_GAP:
        limit_N = {
            "tolerance": lambda s: s.gap_N <= e.search.tolerance_N,
            "noise": lambda s: s.noise_known and s.gap_N <= s.noise_N,
            "timing": lambda s: s.noise_known and s.timed_N <= s.noise_N,
            "baseline_error": lambda s: s.gap_N <= (e.search.visible_from_N if referenced else s.own_error_N),
        }[found.reason]
        assert all(map(limit_N, e.sizes)) and not e.is_rare and none >= max(unknown, known) - ROUNDING
    elif found.verdict == UNKNOWN:
        assert unknown >= max(none, known) - ROUNDING
        assert (
            not e.composition
            or e.search.is_map
            or e.may_be_own_error
            or max(closed, default=0.0) <= 1.0 - VerdictLimits.TENTH / 2.0 + ROUNDING
        )
    else:
        assert e.composition and known >= max(none, unknown) - ROUNDING
    if found.verdict == NAMED:
        assert sum(causes.values()) >= max(none, unknown, *others) - ROUNDING
        assert e.closed.value >= VerdictLimits.HALF and e.closed.low > 0.0
        left = [1.0 - c.value for name, c in e.closed_alone.items() if name not in (*causes, "calibration")]
        assert all(np.isnan(x) or x >= 1.0 - e.closed.value for x in left)
        assert all(p < VerdictLimits.TENTH for name, p in effects.items() if name not in (*causes, "calibration"))
    if found.verdict == AMBIGUOUS:
        enough = min(VerdictLimits.TENTH, max(causes.values())) / (len(effects) + 1)
        assert found.alternatives or max(none, unknown, *others, 0.0) >= enough - ROUNDING


def test_what_the_error_of_a_twin_hides_stays_possible() -> None:
    """A twin in place of the simulation may leave 3 %: an effect that leaves 3.4 % instead of 1 % stays possible."""
    closed, other = ClosedShare(0.986, 0.98, 0.99), ClosedShare(0.966, 0.96, 0.97)
    shared = Probabilities(0.01, 0.04, {"friction": 0.75, "gas_spring": 0.2})
    evidence = changed(CLEARLY, odds=shared, closed=closed, closed_alone={"gas_spring": other})
    assert judge(evidence).verdict == NAMED
    assert judge(changed(evidence, twin_error=0.03)).alternatives == ("gas_spring",)


def leaving(rms: float, width: float = 0.3) -> ClosedShare:
    """What leaves a share of the gap's RMS."""
    return ClosedShare(1.0 - rms**2, 1.0 - rms**2 - width, 1.0 - rms**2 + width)


BEST = leaving(0.52)
UNKNOWN_SHARE = ClosedShare(np.nan, np.nan, np.nan)


@pytest.mark.parametrize(("rms", "width", "clearly"), [(0.53, 0.3, False), (0.61, 0.3, True), (0.55, 0.01, True)])
def test_more_is_clear_by_its_size_or_beyond_the_interval(rms: float, width: float, clearly: bool) -> None:
    assert (rms > VerdictLimits.CLEARLY_MORE * 0.52) == (rms == 0.61)
    assert leaves_clearly_more(leaving(rms, width), BEST) == clearly
    assert not any(leaves_clearly_more(other, BEST) for other in (BEST, leaving(0.3), UNKNOWN_SHARE))


def test_a_tie_needs_closeness_on_held_out_recordings() -> None:
    group = ("backlash", "mount_compliance", "compressibility")
    alone = {"compressibility": leaving(0.82), "mount_compliance": leaving(0.53)}
    scored = changed(CLEARLY, composition=("backlash",), closed=BEST, closed_alone=alone)
    assert confirm_ties(scored, [group]) == (("backlash", "mount_compliance"),)
    assert confirm_ties(scored, [group[::2]]) == confirm_ties(scored, [("backlash",)]) == confirm_ties(scored, ()) == ()
    assert confirm_ties(replace(scored, closed_alone={}), [group]) == (group,)  # not scored: nothing speaks against it
    both = replace(scored, composition=("backlash", "friction"))  # what it leaves beside friction was not scored
    assert confirm_ties(both, [group]) == (group,)
