"""Each kernel against a slow, readable twin; `test_desk_and_vehicle` compares the free run with the tick."""

import numpy as np
import pytest
from kernel_examples import SEGMENTS, TERMS, make_inputs, tables  # noqa: F401 - make_inputs is a fixture

from ces_identify.numerics import kernels


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


def slow_free_run(terms, inputs, segments):
    force = np.zeros(len(inputs[0]))
    for start, stop in segments:
        for k in range(start, stop):
            force[k] = sum(t.coefficient * slow_regressor(t, inputs, force, k, start) for t in terms)
    return force


@pytest.mark.parametrize("best", [np.inf, 1e-3])
def test_free_run_cost(inputs, best):
    layout, powers, coefficients = tables(TERMS, inputs)
    slow = slow_free_run(TERMS, inputs, SEGMENTS)
    measured = slow + np.random.default_rng(6).normal(size=4000)
    weights = np.where(np.arange(4000) % 3 == 0, 1e-4, 0.0)
    recordings = np.array([0, 0, 1])
    squared = weights * (slow - measured) ** 2
    expected = 50.0 * (np.sqrt(squared[:1503].sum()) + np.sqrt(squared[1503:].sum()))
    room = np.empty((1 + len(TERMS), kernels.BLOCK)), np.empty(4000)
    run = kernels.ScoredRun(powers, SEGMENTS, recordings, weights, measured, (-1e6, 1e6))
    cost = kernels.free_run_cost(run, layout.arrays, coefficients, best, *room)
    assert cost == (pytest.approx(expected, rel=1e-9) if best == np.inf else np.inf)
    leaving = run._replace(bounds=(-1.0, 1.0))
    assert kernels.free_run_cost(leaving, layout.arrays, coefficients, np.inf, *room) == np.inf


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
