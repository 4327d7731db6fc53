"""The tick in CPython, compiled by Numba, and the column kernels of the desk: the same forces, bit for bit."""

import math
import random

import numpy as np
import pytest
from constructed_models import ENVELOPE, FREQUENCY, HIGH, LAG, LONG, LOW, MID, PLAY, SHORT, STOP, constructed_damper

from ces_identify.numerics import kernels
from ces_identify.numerics.core import compiled, run_batch
from ces_identify.polynomial.problem import compile_terms
from ces_observer.structures.terms import Factor, Term
from ces_observer.tick.model import HELD
from ces_observer.tick.polynomial import check_polynomial, polynomial_reset, polynomial_tick

SIGNALS = (("position", None), ("speed", None), ("current", None), *((one.name, one) for one in (STOP, PLAY, LAG)))
SIGNALS += ((FREQUENCY.name, FREQUENCY),)
HATS = (LOW, MID, HIGH, SHORT, LONG)
POWERS = (0.0, 0.5, 1.0, 1.0, 1.5, 2.0, 3.0)
SEGMENTS = np.array([[0, 900], [900, 901], [905, 2400]])


def random_factor(dice):
    lag = dice.choice((0, 0, 1, dice.randint(0, 40)))
    if dice.random() < 0.25:
        hat = dice.choice(HATS)
        return Factor(hat.name, lag, 1.0, dice.random() < 0.5, hat)
    name, definition = dice.choice(SIGNALS)
    return Factor(name, lag, dice.choice((*POWERS, dice.uniform(0.0, 8.0))), dice.random() < 0.5, definition)


def random_term(dice):
    factors = [random_factor(dice) for _ in range(dice.choice((0, 1, 1, 2, 2, 3, 4, 7)))]
    if dice.random() < 0.4:
        factors.insert(dice.randint(0, len(factors)), Factor("force", dice.choice((1, 1, 2, 17))))
        return Term(dice.uniform(-0.3, 0.3), tuple(factors))
    return Term(dice.uniform(-900.0, 900.0), tuple(factors))


def random_model(seed):
    dice = random.Random(seed)
    return constructed_damper(tuple(random_term(dice) for _ in range(dice.randint(0, 14))))


def hostile(seed):
    """Return inputs (3, 2400) that wander, stand still, jump beyond the envelope, and take both zeros."""
    rng = np.random.default_rng(seed)
    t = np.arange(2400) * 1e-3
    walks = [np.interp(t, t[::40], rng.uniform(1.1 * low, 1.1 * high, 60)) for low, high in ENVELOPE.by_signal.values()]
    inputs = np.stack(walks)
    for value in (0.0, -0.0, 1e300, -1e300, math.inf, 5e-324):
        inputs[rng.integers(0, 3, 20), rng.integers(0, 2400, 20)] = value
    inputs[:, 300:340] = inputs[:, 300:301]
    return inputs


def vehicle_forces(model, inputs):
    """Return the forces (2400,) [N], tick by tick in plain Python, and where they were held."""
    arrays = model.body.lay_out(model.operating_range).arrays()
    forces, held = np.zeros(inputs.shape[1]), np.zeros(inputs.shape[1], bool)
    for start, stop in SEGMENTS:
        polynomial_reset(*arrays)
        for i in range(start, stop):
            forces[i] = polynomial_tick(*arrays, *inputs[:, i].tolist())
            if not math.isfinite(forces[i]):
                forces[i:stop] = math.nan
                break
            held[i] = arrays.k[HELD]
    return forces, held


def run_columns(model, inputs):
    terms, coefficients = compile_terms(model.body.terms), np.array([term.coefficient for term in model.body.terms])
    powers = terms.power_table(model.envelope, inputs, SEGMENTS, model.sampling.rate_Hz)
    return kernels.free_run(powers, SEGMENTS, terms.arrays, coefficients, model.force_envelope_N)


@pytest.mark.parametrize("seed", range(60))
def test_forces_are_the_same_to_the_last_bit(seed):
    model, inputs = random_model(seed), hostile(seed)
    if seed % 10 == 9:
        inputs[:, 1300] = math.nan
    forces, held = vehicle_forces(model, inputs)
    for desk in (run_batch(model.body, model.operating_range, inputs, SEGMENTS), run_columns(model, inputs)):
        np.testing.assert_array_equal(desk[0].view(np.int64), forces.view(np.int64))
        np.testing.assert_array_equal(desk[1], held)


def sizes(arrays):
    return tuple(map(len, arrays))


@pytest.mark.parametrize("seed", range(10))
def test_what_is_laid_out_passes_the_check_and_needs_its_whole_arrays(seed):
    model = random_model(seed)
    arrays = model.body.lay_out(model.operating_range).arrays()
    assert check_polynomial(arrays.p, arrays.n, *sizes(arrays))
    for i in range(4):
        smaller = [size - (place == i) for place, size in enumerate(sizes(arrays))]
        assert not check_polynomial(arrays.p, arrays.n, *smaller)


@pytest.mark.parametrize("seed", range(30))
def test_counts_that_pass_the_check_keep_the_tick_within_its_arrays(seed):
    """Of changed files, the check refuses those with which plain Python would raise, or index from the end."""
    dice, model = random.Random(seed), random_model(seed)
    good = model.body.lay_out(model.operating_range).arrays()
    check, passed = compiled(check_polynomial), 0
    for _ in range(300):
        n = list(good.n)
        n[dice.randrange(3, len(n))] = dice.choice((-1, 0, 1, 2, 3, 17, 40, len(n), 1 << 62, dice.randrange(200)))
        fits = check_polynomial(good.p, n, *sizes(good))
        assert check(np.array(good.p), np.array(n, np.int64), *sizes(good)) == fits
        if fits:
            passed += 1
            s, k = NoNegative(good.s), NoNegative(good.k)
            polynomial_reset(good.p, n, s, k)
            for _ in range(50):
                polynomial_tick(good.p, n, s, k, 0.01 * dice.random(), dice.uniform(-1, 1), dice.random())
    assert passed


class NoNegative(list):
    """A list whose indices are never negative."""

    def __getitem__(self, place):
        assert place >= 0
        return super().__getitem__(place)

    def __setitem__(self, place, value):
        assert place >= 0
        super().__setitem__(place, value)
