import pytest
from trained_models import FUZZY

from ces_observer.structures.fuzzy import Bell, Fuzzy, Premise, Rule, min_firing
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.structure import OperatingRange

BOUNDS = {"position": (-0.1, 0.1), "speed": (-1.0, 1.0), "current": (0.0, 1.0)}


def run(fuzzy, limits=(-9e3, 9e3)):
    return fuzzy.make_predictor(OperatingRange(1000.0, BOUNDS, limits))


def test_a_bell_is_one_at_its_centre_and_a_half_a_width_away():
    bell = Bell(0.3, 0.2, 2.5)
    assert bell.at(0.3) == 1.0
    assert bell.at(0.5) == pytest.approx(0.5)
    assert bell.at(0.1) == pytest.approx(0.5)
    assert bell.at(0.7) == pytest.approx(1.0 / (1.0 + 2.0**5))


def test_force_is_the_blend_of_the_rules():
    v = Regressor("speed", 0, 0.0, 0.5)
    low, high = Bell(-0.5, 0.5, 1.0), Bell(0.5, 0.5, 1.0)
    rules = (Rule((0,), 1.0, (2.0,)), Rule((1,), -1.0, (3.0,)))
    force = run(Fuzzy((v,), 100.0, (Premise("speed", 0, (low, high)),), rules)).tick(0.0, 0.3, 0.0)
    a, b = 1 / (1 + (0.8 / 0.5) ** 2), 1 / (1 + (0.2 / 0.5) ** 2)
    assert force == pytest.approx(100.0 * (a * (1.0 + 2.0 * 0.6) + b * (-1.0 + 3.0 * 0.6)) / (a + b), rel=1e-12)


def test_one_rule_is_an_affine_model():
    rules = (Rule((0,), 0.5, (0.8, 2.0)),)
    regressors = (Regressor("force", 1, 0.0, 100.0), Regressor("speed", 0, 0.0, 1.0))
    r = run(Fuzzy(regressors, 100.0, (Premise("current", 3, (Bell(0.5, 0.1, 4.0),)),), rules))
    first = r.tick(0.0, 0.1, 0.9)
    assert first == pytest.approx(70.0)
    assert r.tick(0.0, 0.1, 0.2) == pytest.approx(70.0 + 0.8 * first)


def test_premises_look_back_by_their_lag():
    rules = (Rule((0,), 0.0, (0.0,)), Rule((1,), 1.0, (0.0,)))
    sharp = (Bell(0.0, 0.3, 8.0), Bell(1.0, 0.3, 8.0))
    r = run(Fuzzy((Regressor("speed", 0, 0.0, 1.0),), 1.0, (Premise("current", 2, sharp),), rules))
    forces = [r.tick(0.0, 0.0, current) for current in (0.0, 1.0, 1.0, 1.0)]
    assert forces == pytest.approx([0.0, 0.0, 0.0, 1.0], abs=1e-3)


def test_a_force_out_of_its_envelope_is_held():
    r = run(FUZZY, (-1.0, 1.0))
    assert (r.tick(0.0, 1.0, 0.5), r.held) == (1.0, True)


def test_rules_together_fire_at_least_what_is_said():
    least = min_firing(FUZZY, BOUNDS)
    for v in range(-10, 11):
        for i in range(11):
            grades = [[b.at(x) for b in p.memberships] for p, x in zip(FUZZY.premises, (v / 10, i / 10), strict=True)]
            assert sum(grades[0][r.memberships[0]] * grades[1][r.memberships[1]] for r in FUZZY.rules) >= least > 0.0


def test_the_steepest_bell_far_away_does_not_overflow():
    assert 0.0 <= Bell(1e9, 1e-6, 10.0).at(-1e6) < 1e-290
