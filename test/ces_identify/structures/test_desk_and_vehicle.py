"""Ticks of all structures: the same bits in CPython, in Numba and in the desk's column kernels, never beside arrays."""

from __future__ import annotations

import math
import random
from functools import partial

import numpy as np
import pytest
from constructed_models import FREQUENCY, HIGH, LAG, LONG, LOW, MID, PLAY, SHORT, STOP, constructed_damper
from mixture_models import mixture_model
from recurrent_models import make_recurrent, recurrent_model
from trained_models import FUZZY, NETWORK, experts_model, fuzzy_model, network_model, random_fuzzy, random_network

from ces_identify.numerics import kernels
from ces_identify.numerics.core import compile_tick
from ces_identify.polynomial.problem import lay_out_terms
from ces_identify.structures import run_batch
from ces_observer.structures.polynomial import Factor, Polynomial, Term
from ces_observer.tick.mixture import check_structure
from ces_observer.tick.model import HELD
from ces_observer.tick.polynomial import check_polynomial

SIGNALS = [("position", None), ("speed", None), ("current", None)]
SIGNALS += [(definition.name, definition) for definition in (STOP, PLAY, LAG, FREQUENCY)]
HATS = (LOW, MID, HIGH, SHORT, LONG)
POWERS = (0.0, 0.5, 1.0, 1.0, 1.5, 2.0, 3.0)


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


def random_polynomial(seed):
    dice = random.Random(seed)
    return constructed_damper(tuple(random_term(dice) for _ in range(dice.randint(0, 14))))


POLYNOMIALS = {f"polynomial {seed}": partial(random_polynomial, seed) for seed in range(60)}
NAMED = {
    "sigmoid": network_model,
    "fuzzy": fuzzy_model,
    "recurrent": recurrent_model,
    "mixture": mixture_model,
    "experts": experts_model,
}
MODELS = {
    **POLYNOMIALS,
    **NAMED,
    "recurrent, no current": lambda: recurrent_model(make_recurrent(3, 1, current=False)),
    **{f"sigmoid {seed}": lambda seed=seed: random_network(random.Random(seed)) for seed in range(4)},
    **{f"experts {seed}": lambda seed=seed: experts_model(random.Random(seed)) for seed in range(4)},
    **{f"fuzzy {seed}": lambda seed=seed: random_fuzzy(random.Random(seed)) for seed in range(4)},
    **{f"recurrent {seed}": lambda seed=seed: recurrent_model(make_recurrent(seed)) for seed in range(4, 8)},
}
HOSTILE = (math.nan, -math.inf, math.inf, 1e308, -1e308, 5e-324, 0.0, -0.0)
NOT_A_NUMBER_FROM = 1500  # tick: prepared series have no such input, and the column kernels take none
SEGMENTS = np.array([[0, 900], [900, 901], [905, 1500], *([at, at + 40] for at in range(1500, 2380, 40))])


def hostile_inputs(model, seed=1):
    """Return inputs (3, 2400) that wander, stand still, jump beyond the envelope, and take values of HOSTILE."""
    dice, ticks = np.random.default_rng(seed), np.arange(2400)
    ends = model.envelope.by_signal.values()
    inputs = np.stack([np.interp(ticks, ticks[::40], dice.uniform(low - 0.2, high + 0.2, 60)) for low, high in ends])
    inputs[:, 300:340] = inputs[:, 300:301]
    inputs[dice.integers(0, 3, 120), dice.integers(0, NOT_A_NUMBER_FROM, 120)] = np.repeat(HOSTILE[2:], 20)
    inputs[dice.integers(0, 3, 40), dice.integers(NOT_A_NUMBER_FROM, 2400, 40)] = np.repeat(HOSTILE, 5)
    return inputs


def run_on_vehicle(model, inputs):
    """Return the forces (2400,) [N], tick by tick in plain Python, and where they were held."""
    arrays, (reset, tick) = model.body.lay_out(model.operating_range).arrays(), model.body.runs
    forces, held = np.zeros(inputs.shape[1]), np.zeros(inputs.shape[1], bool)
    for start, stop in SEGMENTS:
        reset(*arrays)
        for i in range(start, stop):
            forces[i] = tick(*arrays, *inputs[:, i].tolist())
            if not math.isfinite(forces[i]):
                forces[i:stop] = math.nan
                break
            held[i] = arrays.k[HELD]
    return forces, held


def run_columns(model, inputs):
    terms, coefficients = lay_out_terms(model.body.terms), np.array([term.coefficient for term in model.body.terms])
    powers = terms.power_table(model.envelope, inputs, SEGMENTS, model.sampling.rate_Hz)
    return kernels.free_run(powers, SEGMENTS, terms.arrays, coefficients, model.force_envelope_N)


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS)
def test_forces_are_the_same_to_the_last_bit(make):
    model = make()
    inputs = hostile_inputs(model)
    forces, held = run_on_vehicle(model, inputs)
    assert np.isfinite(forces).mean() > 0.4
    runs = [(run_batch(model, inputs, SEGMENTS), slice(None))]
    if isinstance(model.body, Polynomial):
        runs.append((run_columns(model, inputs), slice(NOT_A_NUMBER_FROM)))
    for desk, ticks in runs:
        np.testing.assert_array_equal(desk[0][ticks].view(np.int64), forces[ticks].view(np.int64))
        np.testing.assert_array_equal(desk[1][ticks], held[ticks])


class NoNegative(list):
    """A list whose indices are never negative."""

    def __getitem__(self, place):
        assert place >= 0
        return super().__getitem__(place)

    def __setitem__(self, place, value):
        assert place >= 0
        super().__setitem__(place, value)


CHECKED = {**NAMED, **dict(list(POLYNOMIALS.items())[:20])}


@pytest.mark.parametrize("make", CHECKED.values(), ids=CHECKED)
def test_what_passes_the_check_stays_within_its_arrays_and_needs_all_of_them(make):
    """Of changed files, the check refuses those with which plain Python would raise, or index from the end."""
    model, dice, passed = make(), random.Random(2), 0
    good = model.body.lay_out(model.operating_range).arrays()
    sizes = [len(array) for array in good]
    is_polynomial = isinstance(model.body, Polynomial)
    check = check_polynomial if is_polynomial else check_structure
    assert check(*good[:2], *sizes)
    assert not any(check(*good[:2], *(n - (i == j) for j, n in enumerate(sizes))) for i in range(3 + is_polynomial))
    for _ in range(300 if is_polynomial else 3000):
        p, n, s, k = good.p, list(good.n), NoNegative(good.s), NoNegative(good.k)
        n[dice.randrange(3, len(n))] = dice.choice(
            (-1, 0, 1, 2, 3, 17, 50, len(n), 2**31, 1 << 62, dice.randrange(200))
        )
        fits = check(p, n, *sizes)
        if is_polynomial:
            assert compile_tick(check)(np.array(p), np.array(n, np.int64), *sizes) == fits
        if fits:
            passed += 1
            p, n = NoNegative(p), NoNegative(n)
            model.body.runs[0](p, n, s, k)
            for _ in range(3):
                model.body.runs[1](p, n, s, k, 0.01 * dice.random(), dice.uniform(-1, 1), dice.random())
    assert passed


@pytest.mark.parametrize("body", [NETWORK, FUZZY], ids=["sigmoid", "fuzzy"])
def test_a_spread_of_zero_is_refused(body):
    model = network_model(body)
    p, n, *_ = arrays = model.body.lay_out(model.operating_range).arrays()
    at = p.index(body.regressors[3].spread)
    assert not check_structure([*p[:at], 0.0, *p[at + 1 :]], n, *map(len, arrays))
