"""A time constant left open is estimated from data whose force follows a lagged current."""

import numpy as np
import pytest
from planted import stroked, with_force, with_values
from samplings import make_sampling

from ces_identify.identification import identify
from ces_identify.numerics.search import Limits
from ces_identify.polynomial.constructed import GRID_S, find_time_constants
from ces_identify.polynomial.rules_file import parse_rules
from ces_identify.prepare.series import prepare
from ces_identify.structures.kit import IdentifyOptions
from ces_observer.model import Envelope, Model
from ces_observer.structures.constructed_inputs import Lag, TriangularMembership, make_memberships
from ces_observer.structures.polynomial import Factor, Polynomial, Term

SAMPLING = make_sampling(500.0, 0.01)
NOISE_N = 5.0
RULES = parse_rules(
    {
        "constructed": {"valve": {"kind": "lag", "of": "current", "time_constant_s": "auto"}},
        "force": {"lags": [1]},
        "speed": {"lags_ms": [0, 2], "powers": [0.5, 1.0]},
        "valve": {"lags_ms": [0], "forms": ["magnitude"]},
        "products": [["speed"], ["valve"], ["speed", "valve"], ["force"], ["force", "valve"]],
    },
    "test",
).at_rate(SAMPLING.rate_Hz)
LIMITS = Limits(terms=5, time=60.0, threads=2)


FIRST, SPEED = Factor("force", 1), Factor("speed", 0, 0.5)


def straight(time_constant_s):
    """A force that is linear in the lagged current."""
    valve = Factor("valve", 0, 1.0, False, Lag("valve", "current", time_constant_s))
    return Term(300.0, (SPEED,)), Term(900.0, (SPEED, valve)), Term(0.6, (FIRST,))


def blended(time_constant_s):
    """Two sub-models over the lagged current."""
    both = make_memberships("by_valve", "valve", (0.4, 0.9), Lag("valve", "current", time_constant_s))
    low, high = (Factor(hat.name, 0, 1.0, True, hat) for hat in both)
    return Term(600.0, (SPEED, low)), Term(1300.0, (SPEED, high)), Term(0.3, (FIRST, low)), Term(0.6, (FIRST, high))


def planted(terms, seed):
    """A damper under a current that jumps ten times a second; with noise."""
    model = Model(SAMPLING, Polynomial(terms), Envelope((-1, 1), (-5, 5), (-5, 5)), (-1e5, 1e5))
    bare = stroked(seed, 8.0, f"planted {seed}", SAMPLING.rate_Hz)
    jumps = np.repeat(np.random.default_rng(seed).uniform(0.2, 1.2, 80), 50)
    return with_force(model, with_values(bare, current=jumps), seed, NOISE_N)


def estimate(rules, time_constant_s):
    rules = find_time_constants(rules, [prepare(planted(straight(time_constant_s), 1), SAMPLING)], LIMITS, stable=True)
    assert rules.open_lags == ()
    return rules.constructed["valve"][0].time_constant_s


@pytest.mark.parametrize("time_constant_s", [0.003, 0.0094, 0.0155, 0.03, 0.035])
def test_a_planted_time_constant_is_found(time_constant_s) -> None:
    found = estimate(RULES, time_constant_s)
    assert found == pytest.approx(time_constant_s, rel=1e-9 if time_constant_s in GRID_S else 0.23)


def test_rules_without_an_open_lag_are_left_as_they_are():
    rules = RULES.with_time_constant("valve", 0.02)
    assert find_time_constants(rules, [], LIMITS, stable=True) is rules


def test_a_model_is_identified_with_the_estimated_lag_and_memberships_of_it():
    raw = {
        "constructed": {
            "valve": {"kind": "lag", "of": "current", "time_constant_s": "auto"},
            "by_valve": {"kind": "hats", "of": "valve", "at": [0.4, 0.9]},
        },
        "force": {"lags": [1]},
        "speed": {"lags_ms": [0], "powers": [0.5]},
        "by_valve": {"lags_ms": [0]},
        "products": [["speed", "by_valve"], ["force"], ["force", "by_valve"]],
    }
    options = IdentifyOptions(1.0, parse_rules(raw, "test"), LIMITS)
    result = identify([planted(blended(0.01), 1)], [planted(blended(0.01), 2)], options)
    assert {
        f.definition.base
        for t in result.model.body.terms
        for f in t.factors
        if isinstance(f.definition, TriangularMembership)
    } == {Lag("valve", "current", 0.01)}
    assert result.model.certificate["gain"] < 1.0


def test_a_current_that_never_changes_needs_no_time_constant():
    still = planted(straight(0.01), 1)
    options = IdentifyOptions(1.0, RULES, LIMITS)
    result = identify([with_values(still, current=np.full(4000, 0.5))], [], options)
    assert {f.signal for t in result.model.body.terms for f in t.factors} <= {"force", "speed"}
