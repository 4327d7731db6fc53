import json
import math
import random
from dataclasses import replace

import pytest
from trained_models import (
    ENVELOPE,
    FUZZY,
    NETWORK,
    REGRESSORS,
    fuzzy_model,
    network_model,
    random_fuzzy,
    random_network,
)

from ces_observer.errors import ModelError
from ces_observer.model import parse_model
from ces_observer.structures.fuzzy import Fuzzy, Premise, Rule
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.network import Network, SigmoidUnit
from ces_observer.structures.structure import OperatingRange

BOUNDS = {"position": (-0.1, 0.1), "speed": (-1.0, 1.0), "current": (0.0, 1.0)}


def run(network, limits=(-9e3, 9e3)):
    return network.make_predictor(OperatingRange(1000.0, BOUNDS, limits))


def test_force_is_the_sum_of_the_affine_part_and_the_sigmoids():
    v, i = Regressor("speed", 1, 0.2, 0.5), Regressor("current", 0, 0.5, 0.25)
    network = Network(
        (v, i), 100.0, 0.3, (2.0, -1.0), (SigmoidUnit(4.0, 0.7, (1.5, -2.0)), SigmoidUnit(-1.0, 0.0, (0.0, 3.0)))
    )
    r = run(network)
    r.tick(0.0, 0.6, 0.1)
    a, b = (0.6 - 0.2) / 0.5, (0.9 - 0.5) / 0.25
    s = [1 / (1 + math.exp(-(1.5 * a - 2.0 * b + 0.7))), 1 / (1 + math.exp(-3.0 * b))]
    assert r.tick(0.0, -0.4, 0.9) == pytest.approx(100.0 * (0.3 + 2.0 * a - b + 4.0 * s[0] - s[1]), rel=1e-12)


def test_past_forces_are_its_own_and_zero_before_the_start():
    network = Network((Regressor("force", 2, 10.0, 50.0),), 50.0, 0.1, (0.5,), ())
    r = run(network)
    forces = [r.tick(0.0, 0.0, 0.0) for _ in range(4)]
    first = 50.0 * (0.1 + 0.5 * (0.0 - 10.0) / 50.0)
    assert forces == pytest.approx([first, first, *[50.0 * (0.1 + 0.5 * (first - 10.0) / 50.0)] * 2])


def test_inputs_before_the_first_tick_are_the_first_ones():
    r = run(Network((Regressor("speed", 7, 0.0, 1.0),), 1.0, 0.0, (1.0,), ()))
    assert r.tick(0.0, 0.25, 0.0) == 0.25


def test_only_an_input_among_the_regressors_can_be_outside():
    network = Network((Regressor("speed", 1, 0.0, 1.0), Regressor("force", 1, 0.0, 1.0)), 1.0, 0.0, (1.0, 0.5), ())
    r = run(network)
    r.tick(9.0, 0.25, -9.0)
    assert (network.uses, r.clamped) == (["speed"], False)
    r.tick(0.0, 1.5, 0.0)
    assert r.clamped


def test_a_force_out_of_its_envelope_is_held_also_as_a_past_force():
    r = run(Network((Regressor("force", 1, 0.0, 50.0),), 50.0, -3.0, (-0.5,), ()), (-100.0, 1e3))
    assert (r.tick(0.0, 0.0, 0.0), r.held) == (-100.0, True)
    assert (r.tick(0.0, 0.0, 0.0), r.held) == (50.0 * (-3.0 + 0.5 * 100.0 / 50.0), False)


def test_saturated_sigmoids_do_not_overflow():
    r = run(Network((Regressor("speed", 0, 0.0, 1e-9),), 1.0, 0.0, (0.0,), (SigmoidUnit(1.0, 0.0, (1e9,)),)))
    assert r.tick(0.0, -1.0, 0.0) == pytest.approx(0.0, abs=1e-300)
    assert r.tick(0.0, 1.0, 0.0) == 1.0


def test_the_largest_network_fits_the_file_and_reads_back():
    regressors = tuple(Regressor("speed", lag, 0.123456789, 0.987654321) for lag in range(40))
    unit = SigmoidUnit(-1.234567890123456, 1.1, (0.1234567890123456,) * 40)
    model = network_model(replace(NETWORK, regressors=regressors, linear=(0.1,) * 40, units=(unit,) * 200))
    assert len(model.to_json()) < 1_000_000
    assert parse_model(model.to_json(), "m.json") == model


BOUNDS_bounds = ENVELOPE.by_signal


def test_gain_of_a_network_is_exact_where_it_is_known():
    """Steepest at zero: 0.5 + 0.25 * 1.5 * 0.2 for the first past force, 0.25 * -0.6 * 0.5 pulling the other way."""
    gain = network_model().certify().gain
    one = 0.5 + 0.25 * 1.5 * 0.2
    two = (0.1 + 0.25 * 0.6 * 0.1) * 500.0 / 400.0
    assert gain == pytest.approx(one + two, rel=1e-12)
    assert gain >= one + two


def test_drive_of_a_network_is_exact_where_it_is_known():
    network = Network(REGRESSORS[2:3], 100.0, 0.5, (2.0,), (SigmoidUnit(3.0, 0.0, (1.0,)),))
    drive = network_model(network).certify().drive_N
    top = (1.0 - 0.1) / 0.4
    bottom = (-1.0 - 0.1) / 0.4
    reached = [0.5 + 2.0 * x + 3.0 / (1.0 + math.exp(-x)) for x in (bottom, top)]
    assert drive == pytest.approx(100.0 * max(map(abs, reached)), rel=1e-12)


def test_gain_and_drive_of_rules_are_those_of_the_worst_rule():
    certificate = fuzzy_model().certify()
    assert certificate.gain == pytest.approx(0.5 + 0.2 * 500.0 / 400.0, rel=1e-12)
    corners = []
    for rule in FUZZY.rules:
        for v in (-1.0, 1.0):
            for i in (0.0, 1.0):
                for x in (-0.1, 0.1):
                    phi = (0.0, -0.25, (v - 0.1) / 0.4, (i - 0.5) / 0.2, x / 0.05)
                    corners.append(abs(rule.constant + sum(a * b for a, b in zip(rule.linear, phi, strict=True))))
    assert certificate.drive_N == pytest.approx(500.0 * max(corners), rel=1e-12)


@pytest.mark.parametrize("make", [random_network, random_fuzzy])
@pytest.mark.parametrize("seed", range(6))
def test_no_run_leaves_the_proved_bound_and_pasts_are_forgotten(make, seed):
    """Against inputs jumping through and beyond the whole envelope; two runs with different pasts close up."""
    chance = random.Random(seed)
    model = make(chance)
    certificate = model.certify()
    assert certificate.holds
    one, two = model.make_predictor(), model.make_predictor()
    for _ in range(50):
        two.tick(-5.0, 9.0, -3.0)
    largest, apart = 0.0, []
    for _ in range(1500):
        row = (chance.uniform(-0.2, 0.2), chance.choice([-1.0, 1.0, chance.uniform(-2, 2)]), chance.choice([0.0, 1.0]))
        a, b = one.tick(*row), two.tick(*row)
        largest = max(largest, abs(a), abs(b))
        apart.append(abs(a - b))
    assert 0.05 * certificate.force_N < largest <= certificate.force_N
    assert max(apart[-10:]) < 1e-6 * certificate.force_N


@pytest.mark.parametrize("make", [random_network, random_fuzzy])
def test_one_step_from_two_pasts_never_changes_more_than_the_gain_allows(make):
    chance = random.Random(7)
    model = make(chance)
    gain = model.certify().gain
    for _ in range(200):
        runs = model.make_predictor(), model.make_predictor()
        apart = [abs(runs[0].tick(0.0, -1.0, 0.0) - runs[1].tick(0.0, 1.0, 1.0))]
        for _ in range(1 + max(r.lag for r in model.body.regressors)):  # until all past inputs are the same
            row = (0.0, chance.uniform(-1, 1), chance.uniform(0, 1))
            apart.append(abs(runs[0].tick(*row) - runs[1].tick(*row)))
        assert apart[-1] <= gain * max(apart[-4:-1]) * (1.0 + 1e-9) + 1e-9
        assert max(apart[-4:-1]) > 1e-6


def test_what_is_no_contraction_gets_no_certificate():
    steep = replace(NETWORK, units=(*NETWORK.units, SigmoidUnit(4.0, 0.0, (1.0, 0.0, 0.0, 0.0, 0.0))))
    eager = replace(FUZZY, rules=(*FUZZY.rules, Rule((0, 0), 0.0, (0.9, -0.2, 0.0, 0.0, 0.0))))
    for model in (network_model(steep), fuzzy_model(eager)):
        assert not model.is_stable()
        assert model.certify().force_N == math.inf
    assert network_model().is_stable()
    assert fuzzy_model().is_stable()


def test_stray_terms_do_not_stand_in_for_the_proof():
    """A network with gain above one is refused, and so is a harmless polynomial beside it."""
    steep = network_model(replace(NETWORK, linear=(1.5, 0.0, 0.0, 0.0, 0.0)))
    assert not steep.is_stable()
    with pytest.raises(ModelError, match="unknown key 'terms'"):
        parse_model(json.dumps({**json.loads(steep.to_json()), "terms": []}), "m.json")


def test_the_certificate_says_what_was_proved():
    mapping = network_model().certify().to_mapping()
    assert "any past" in mapping["claim"]
    assert mapping["force_bound_N"] > mapping["drive_N"] > 0.0
    assert "every rule" in fuzzy_model().certify().to_mapping()["claim"]


def test_no_past_force_means_no_gain():
    fuzzy = Fuzzy(
        REGRESSORS[2:3], 1.0, (Premise("speed", 0, FUZZY.premises[0].memberships),), (Rule((0,), 0.0, (2.0,)),)
    )
    assert fuzzy_model(fuzzy).certify().gain == 0.0
