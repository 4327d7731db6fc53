"""Each kernel against a slow, readable twin."""

import numpy as np
import pytest
from kernel_examples import SEGMENTS, TERMS, make_inputs, tables  # noqa: F401 - make_inputs is a fixture

from ces_identify.numerics import kernels
from ces_observer.structures.terms import Factor, Term


def slow_product(term, inputs, k, start):
    value = 1.0
    for f in term.inputs:
        s = inputs[("position", "speed", "current").index(f.signal)][max(k - f.lag, start)]
        value *= abs(s) ** f.power * (-1.0 if f.signed and s < 0.0 else 1.0)
    return value


def slow_regressor(term, inputs, past, k, start):
    value = slow_product(term, inputs, k, start)
    if term.output_lag:
        value *= past[k - term.output_lag] if k - term.output_lag >= start else 0.0
    return value


def slow_free_run(terms, inputs, segments, bounds=(-np.inf, np.inf)):
    force = np.zeros(len(inputs[0]))
    for start, stop in segments:
        for k in range(start, stop):
            total = sum(t.coefficient * slow_regressor(t, inputs, force, k, start) for t in terms)
            force[k] = min(max(total, bounds[0]), bounds[1])
    return force


@pytest.mark.parametrize("terms", [TERMS, TERMS[:3], TERMS[:2], TERMS[-1:]])
def test_free_run(inputs, terms):
    compiled, powers, coefficients = tables(terms, inputs)
    force, held = kernels.free_run(powers, SEGMENTS, compiled.arrays, coefficients, (-1e6, 1e6))
    assert not held.any()
    np.testing.assert_allclose(force, slow_free_run(terms, inputs, SEGMENTS), rtol=1e-9, atol=1e-9)


GROWING = (Term(1.1, (Factor("force", 1),)), Term(1.0, ()))  # as a model without a certificate may


@pytest.mark.parametrize(("terms", "share"), [(TERMS, 0.1), (TERMS[:3], 0.1), (GROWING, 0.9)])
def test_free_run_is_held_in_its_bounds_and_goes_on(inputs, terms, share):
    compiled, powers, coefficients = tables(terms, inputs)
    bounds = -3.0, 3.0
    force, held = kernels.free_run(powers, SEGMENTS, compiled.arrays, coefficients, bounds)
    np.testing.assert_allclose(force, slow_free_run(terms, inputs, SEGMENTS, bounds), rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(held, np.isin(force, bounds))
    assert held.mean() > share


def test_free_run_ends_where_it_is_not_finite_until_the_next_segment(inputs):
    inputs[1][700] = np.inf
    terms = Term(99.0, (Factor("speed", 0),)), Term(0.9, (Factor("force", 9),))
    compiled, powers, coefficients = tables(terms, inputs)
    powers[powers == 9.0] = np.nan
    force, held = kernels.free_run(powers, SEGMENTS, compiled.arrays, coefficients, (-100.0, 100.0))
    assert np.isnan(force[700:1500]).all()
    assert np.isfinite(force[:700]).all() and np.isfinite(force[1500:]).all() and held[:700].any()


@pytest.mark.parametrize("best", [np.inf, 1e-3])
def test_free_run_cost(inputs, best):
    compiled, powers, coefficients = tables(TERMS, inputs)
    slow = slow_free_run(TERMS, inputs, SEGMENTS)
    measured = slow + np.random.default_rng(6).normal(size=4000)
    weights = np.where(np.arange(4000) % 3 == 0, 1e-4, 0.0)
    recordings = np.array([0, 0, 1])
    squared = weights * (slow - measured) ** 2
    expected = 50.0 * (np.sqrt(squared[:1503].sum()) + np.sqrt(squared[1503:].sum()))
    room = np.empty((1 + len(TERMS), kernels.BLOCK)), np.empty(4000)
    run = kernels.ScoredRun(powers, SEGMENTS, recordings, weights, measured, (-1e6, 1e6))
    cost = kernels.free_run_cost(run, compiled.arrays, coefficients, best, *room)
    assert cost == (pytest.approx(expected, rel=1e-9) if best == np.inf else np.inf)
    leaving = run._replace(bounds=(-1.0, 1.0))
    assert kernels.free_run_cost(leaving, compiled.arrays, coefficients, np.inf, *room) == np.inf


def test_regressor_columns(inputs):
    compiled, powers, _ = tables(TERMS, inputs)
    measured = np.random.default_rng(7).normal(size=4000)
    for segment, k0, k1 in ((0, 0, 40), (2, 1503, 1540), (2, 3000, 3050)):
        fast = kernels.regressor_columns(powers, measured, SEGMENTS, compiled.arrays, k0, k1, segment)
        start = SEGMENTS[segment, 0]
        slow = [[slow_regressor(t, inputs, measured, k, start) for k in range(k0, k1)] for t in TERMS]
        np.testing.assert_allclose(fast, slow, rtol=1e-9)


def test_solve_normal_is_least_squares():
    random = np.random.default_rng(8)
    columns, y = random.normal(size=(200, 5)) * [1, 1e3, 1e-3, 1, 1], random.normal(size=200)
    full = np.column_stack([columns, y])
    chosen = np.array([4, 0, 2])
    solution, independent = kernels.solve_normal(full.T @ full, chosen, 1e-9)
    assert independent
    np.testing.assert_allclose(solution, np.linalg.lstsq(columns[:, chosen], y, rcond=None)[0], rtol=1e-8)


def test_solve_normal_refuses_dependent_columns():
    columns = np.random.default_rng(9).normal(size=(50, 2))
    full = np.column_stack([columns, columns @ [1.0, 2.0], np.ones(50)])
    assert not kernels.solve_normal(full.T @ full, np.array([0, 1, 2]), 1e-9)[1]


@pytest.mark.parametrize("power", [0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.1])
@pytest.mark.parametrize("signed", [True, False])
def test_power_row(power, signed):
    values = np.array([-2.0, -0.3, 0.0, 0.7, 4.0])
    slow = [abs(s) ** power * (-1.0 if signed and s < 0 else 1.0) for s in values]
    np.testing.assert_allclose(kernels.power_row(values, power, signed), slow, rtol=1e-14)
