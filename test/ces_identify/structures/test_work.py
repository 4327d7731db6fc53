"""Searches are counted in work: neither load nor threads change the answer, and a larger model is never worse."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from identification_examples import RULES, SAMPLING
from identification_examples import planted as planted_polynomial
from planted import FUZZY, NETWORK, planted
from planted import SAMPLING as TRAINED_SAMPLING

from ces_identify.numerics.search import TIME_IS_UP, Limits, SearchResult, spread_work
from ces_identify.polynomial.problem import assemble_problem
from ces_identify.polynomial.selection import search
from ces_identify.prepare.series import prepare
from ces_identify.structures.fuzzy import FuzzyShape
from ces_identify.structures.lagged import train
from ces_identify.structures.network import NetworkShape
from ces_identify.training import Lags, build_training

LIMITS = Limits(terms=6, starts=4, threads=1)
LAGS = Lags((1,), (0.0, 0.0025), (0.0075,))
SHAPES = {"sigmoid": NetworkShape(4, LAGS), "anfis": FuzzyShape(5, 1, lags=LAGS)}


@pytest.fixture(scope="module")
def problem():
    return assemble_problem([prepare(planted_polynomial(1, seconds=6.0), SAMPLING)], RULES.candidates())


@pytest.fixture(scope="module")
def families():
    series = [prepare(planted(model, 1, seconds=6.0), TRAINED_SAMPLING) for model in (NETWORK, FUZZY)]
    made = zip(SHAPES.items(), series, strict=True)
    return {name: shape.family(build_training([one]), one.rate_Hz) for (name, shape), one in made}


def facts(results: list[SearchResult]) -> list[tuple[object, ...]]:
    return [(one.chosen.tolist(), one.coefficients.tobytes(), one.cost, one.seed, one.ended) for one in results]


@contextmanager
def busy_thread() -> Iterator[None]:
    """Keep a core, and the lock of the interpreter, busy."""
    done = threading.Event()

    def work() -> None:
        while not done.is_set():
            sum(range(1000))

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def test_a_polynomial_is_the_same_with_load_and_with_threads(problem):
    quiet = facts(search(problem, LIMITS))
    with busy_thread():
        assert facts(search(problem, LIMITS)) == quiet
    assert facts(search(problem, replace(LIMITS, threads=4))) == quiet
    assert facts(search(problem, replace(LIMITS, time=1e6))) == quiet


@pytest.mark.parametrize("kind", list(SHAPES))
def test_a_trained_model_is_the_same_with_load_and_with_threads(families, kind):
    limits = Limits(starts=3, threads=1, work=0.002)
    quiet = facts(train(families[kind], limits))
    with busy_thread():
        assert facts(train(families[kind], replace(limits, threads=4))) == quiet


def test_more_terms_are_never_worse(problem):
    costs = [search(problem, replace(LIMITS, terms=n, starts=2))[0].cost for n in (6, 8, 10)]
    assert costs == sorted(costs, reverse=True)
    fewer = [search(problem, replace(LIMITS, terms=n, starts=1))[0].cost for n in range(2, 6)]
    assert [*fewer, costs[0]] == sorted([*fewer, costs[0]], reverse=True)


@pytest.mark.parametrize("kind", list(SHAPES))
def test_more_units_or_rules_are_never_worse(families, kind):
    costs = [train(one, Limits(starts=1, threads=1))[0].cost for one in families[kind].ladder()]
    assert len(costs) == 2
    assert costs == sorted(costs, reverse=True)


def test_models_met_on_the_way_are_kept_by_size_and_less_work_gives_no_better_one(problem):
    best = search(problem, replace(LIMITS, starts=1))[0]
    sizes = [len(one.chosen) for one in best.met]
    assert len(set(sizes)) == len(sizes) > 2
    assert min(one.cost for one in best.met) == best.cost
    assert best.share == 1.0
    less = search(problem, replace(LIMITS, starts=1, work=1e-4))[0]
    assert less.ended == "its share of the work is done"
    assert less.cost >= best.cost


def test_a_hard_end_is_said_of_every_result(problem):
    heard: list[SearchResult] = []
    results = search(problem, replace(LIMITS, time=0.0, starts=2), heard.append)
    assert {one.ended for one in results} == {TIME_IS_UP} == {heard[-1].ended}
    assert "another machine may answer differently" in TIME_IS_UP
    assert np.isinf(Limits().time)


def test_long_recordings_get_fewer_starts_of_more_work():
    limits = Limits(starts=8)
    assert spread_work(limits, 60_000) == limits
    long = spread_work(limits, 200_000)
    assert (long.starts, long.work) == (4, 2.0)
    assert spread_work(limits, 10**7).starts == 2
    assert spread_work(replace(limits, starts=1), 10**7).starts == 1
