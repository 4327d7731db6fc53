"""Planted hysteresis and planted sub-models are recovered; inputs outside the data are refused."""

import numpy as np
import pytest
import yaml
from planted import planted
from samplings import make_sampling

from ces_identify.identification import identify
from ces_identify.numerics.search import Limits
from ces_identify.polynomial.constructed import add_blend, restrict_to_data
from ces_identify.polynomial.rules_file import built_in_rules, load_rules, parse_rules
from ces_identify.prepare.series import prepare
from ces_identify.structures.kit import IdentifyOptions
from ces_observer.errors import CesError
from ces_observer.model import Envelope, Model, parse_model
from ces_observer.structures.constructed_inputs import Hysteresis, make_memberships
from ces_observer.structures.polynomial import Factor, Polynomial, Term

SAMPLING = make_sampling(500.0, 0.01)
STOP = Hysteresis("hysteresis", "stop", "position", 0.001)
SOFT, HARD = make_memberships("by_current", "current", (0.35, 0.6))
IN_SOFT, IN_HARD = (Factor(hat.name, 0, 1.0, True, hat) for hat in (SOFT, HARD))
FIRST, SPEED = Factor("force", 1), Factor("speed", 0, 0.5)
PLANTED = Model(
    SAMPLING,
    Polynomial(
        (
            Term(900.0, (IN_SOFT, SPEED)),
            Term(400.0, (IN_HARD, SPEED)),
            Term(0.3, (FIRST, IN_SOFT)),
            Term(0.8, (FIRST, IN_HARD)),
            Term(2e5, (Factor("hysteresis", 0, 1.0, True, STOP),)),
        )
    ),
    Envelope((-1.0, 1.0), (-5.0, 5.0), (-5.0, 5.0)),
    (-1e5, 1e5),
)
RAW = {
    "constructed": {
        "hysteresis": {"kind": "stop", "of": "position", "half_width": 0.001},
        "by_current": {"kind": "hats", "of": "current", "at": [0.35, 0.6]},
    },
    "force": {"lags": [1]},
    "speed": {"lags": [0, 2], "powers": [0.5, 1.0], "forms": ["signed", "magnitude"]},
    "current": {"lags": [0], "powers": [1.0], "forms": ["magnitude"]},
    "hysteresis": {"lags": [0], "powers": [1.0, 2.0], "forms": ["signed"]},
    "by_current": {"lags": [0]},
    "products": [[], ["speed"], ["speed", "current"], ["force"], ["force", "current"], ["hysteresis"]],
}
BLENDED = [["by_current", "speed"], ["force", "by_current"], ["hysteresis", "by_current"]]
NOISE_N = 5.0


def ride(seed, name="planted"):
    return planted(PLANTED, seed, NOISE_N, 12.0, name)


def identified(rules, terms=7):
    limits = Limits(terms, 20.0, 0.0, 2, 1, 2)
    options = IdentifyOptions(split=1.0, candidates=rules, limits=limits)
    return identify([ride(1), ride(2)], [ride(3, name="fresh")], options)


def fresh_cost(result):
    return next(e for e in result.evaluations if e.name == "fresh").cost


@pytest.fixture(scope="module")
def blended():
    return identified(parse_rules({**RAW, "products": [*RAW["products"], *BLENDED]}, "test"))


@pytest.mark.slow
def test_planted_sub_models_and_hysteresis_are_found_to_within_the_noise(blended):
    """As they are, in each sub-model, or as what both share and what one has more of: then by what they come to."""
    stops = [t for t in blended.model.body.terms if any(f.signal == "hysteresis" for f in t.factors)]
    for other in (HARD, SOFT):
        seen = [t.coefficient for t in stops if all(f.signal != other.name for f in t.factors)]
        assert sum(seen) == pytest.approx(2e5, rel=0.05)
    floor = 100.0 * NOISE_N / np.std(blended.evaluations[-1].series.force[1000:])
    assert fresh_cost(blended) == pytest.approx(floor, rel=0.1)


@pytest.mark.slow
def test_the_blend_is_proved_stable_and_survives_its_file(blended):
    assert blended.model.certificate["gain"] == pytest.approx(0.8, abs=0.03)
    again = parse_model(blended.model.to_json(), "m.json")
    assert again == blended.model
    assert again.is_stable()


def rules_with(**constructed):
    """Return the built-in rules with more constructed inputs, which no product uses."""
    built_in = yaml.safe_load(built_in_rules())
    return parse_rules({**built_in, "constructed": {**built_in["constructed"], **constructed}}, "test")


@pytest.fixture(scope="module")
def data():
    return [prepare(ride(1), SAMPLING)]


def test_the_range_of_a_frequency_is_narrowed_to_the_data(data):
    rules = add_blend(rules_with(frequency={"kind": "frequency"}), "frequency:3,5")
    restricted = restrict_to_data(rules, data).constructed
    low, high = restricted["frequency"][0].range_Hz
    assert 1.5 < low < 3.0
    assert 5.0 < high < 8.0
    assert {hat.base for hat in restricted["by_frequency"]} == {restricted["frequency"][0]}


@pytest.mark.parametrize(
    ("blended", "message"),
    [
        ("current:0.4,7", r"by_valve_2: peaks at valve 7, outside the data's 0\.2.* to 0\.7"),
        ("valve:0.4,7", r"by_valve_2: peaks at valve 7, outside the data's 0\.2.* to 0\.7"),
    ],
)
def test_what_the_data_do_not_reach_is_refused(data, blended, message):
    with pytest.raises(CesError, match=message):
        restrict_to_data(add_blend(load_rules(None), blended), data)


def test_a_hysteresis_wider_than_the_data_is_refused(data):
    with pytest.raises(CesError, match=r"slip: half width 0\.03 spans all of the data's position"):
        restrict_to_data(rules_with(slip={"kind": "stop", "of": "position", "half_width": 0.03}), data)


def test_memberships_of_a_lag_may_be_where_its_signal_goes_until_its_time_constant_is_known(data):
    rules = add_blend(load_rules(None), "valve:0.27,0.6")
    assert restrict_to_data(rules, data) == rules
    slow = rules.with_time_constant("valve", 1.0)
    with pytest.raises(CesError, match=r"by_valve_1: peaks at valve 0\.27, outside the data's 0\.[34]"):
        restrict_to_data(slow, data)
