"""The tick against a slow, readable twin, and what a run keeps from tick to tick."""

import math
import random
import tracemalloc

import pytest
from constructed_models import ConstructedRun
from model_examples import make_model

from ces_observer.errors import ModelError
from ces_observer.model import Envelope
from ces_observer.structures.constructed_inputs import (
    BASE,
    Frequency,
    Hysteresis,
    Lag,
    make_memberships,
)
from ces_observer.structures.polynomial import Factor, Term

ENVELOPE = Envelope((-0.05, 0.04), (-1.5, 2.0), (-0.2, 1.5))
STOP = Hysteresis("hysteresis", "stop", "position", 0.002)
MADE = (STOP, Frequency("pace", 0.25, (0.5, 20.0), 1e-4), Lag("coil", "current", 0.02))
HATS = (
    *make_memberships("by_speed", "speed", (-0.5, 0.5)),
    *make_memberships("by_stop", "hysteresis", (-0.001, 0.0015), STOP),
)
FIRST = Factor("force", 1)


def model(*terms, limits=(-1e9, 1e9)):
    return make_model(terms=terms, envelope=ENVELOPE, force_envelope_N=limits)


def test_only_an_input_in_a_term_can_be_outside():
    made = model(Term(0.5, (FIRST,)), Term(100.0, (Factor("speed", 0),)))
    run = made.make_predictor()
    outside = []
    for row in ((9.0, 0.1, 9.0), (0.0, 9.0, 0.0), (math.nan, 0.1, 0.0)):
        run.tick(*row)
        outside.append(run.clamped)
    assert outside == [False, True, True]


def driven(count, seed=1, beyond=1.0):
    """Rows of position, speed and current that wander over `beyond` times the envelope and stand still at times."""
    dice, rows = random.Random(seed), [(0.0, -0.0, 0.0)]
    for _ in range(count - 1):
        new = tuple(beyond * dice.uniform(low, high) for low, high in ENVELOPE.by_signal.values())
        rows.append(rows[-1] if dice.random() < 0.2 else new)
    return rows


def slow_forces(made, rows):
    """Return the force [N] at each of `rows`, and how large its terms are together."""
    construction, past, forces, sizes = ConstructedRun(made.body.constructed, made.sampling.rate_Hz), [], [], []
    names = [*BASE, *(one.name for one in made.body.constructed)]
    for row in rows:
        ranges = made.envelope.by_signal.values()
        clamped = [min(max(value, low), high) for value, (low, high) in zip(row, ranges, strict=True)]
        past.append(dict(zip(names, construction.update(clamped), strict=True)))
        terms = [
            term.coefficient * math.prod(slow_factor(f, past, forces) for f in term.factors) for term in made.body.terms
        ]
        low, high = made.force_envelope_N
        forces.append(min(max(sum(terms), low), high))
        sizes.append(sum(map(abs, terms)))
    return forces, sizes


def slow_factor(factor, past, forces):
    if factor.signal == "force":
        return forces[-factor.lag] if factor.lag <= len(forces) else 0.0
    value = past[max(len(past) - 1 - factor.lag, 0)][factor.signal]
    size = abs(value) ** factor.power
    return math.copysign(size, value) if factor.signed else size


def test_a_model_as_large_as_a_file_may_be():
    dice = random.Random(3)

    def term():
        past = (Factor("force", dice.randint(1, 20)),) if dice.random() < 0.5 else ()
        factors = [
            Factor(dice.choice(BASE[1:]), dice.choice([0, 3, dice.randint(0, 1000)]), dice.uniform(0.0, 8.0))
            for _ in range(7)
        ]
        return Term(dice.uniform(-0.01, 0.01), (*past, *factors))

    made, rows = model(*(term() for _ in range(499)), Term(1.0, (Factor("speed", 1000),))), driven(30)
    run = made.make_predictor()
    for row, slow, size in zip(rows, *slow_forces(made, rows), strict=True):
        assert run.tick(*row) == pytest.approx(slow, rel=1e-9, abs=1e-12 * size)


def test_a_long_lag_reaches_exactly_so_far_back():
    run = model(Term(1.0, (Factor("current", 1000),)), Term(1.0, (Factor("force", 700),))).make_predictor()
    forces = [run.tick(0.0, 0.0, 1.0 if k == 5 else 0.0) for k in range(1800)]
    assert [k for k, force in enumerate(forces) if force] == [1005, 1705]


def test_inputs_before_the_first_tick_count_as_the_first_and_forces_as_zero():
    run = model(Term(10.0, (Factor("current", 3), Factor("speed", 1))), Term(0.5, (FIRST,))).make_predictor()
    assert [run.tick(0.0, 1.0, 0.5) for _ in range(3)] == [5.0, 7.5, 8.75]


@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("side", [0, 1])
def test_inputs_are_clamped_and_it_shows_for_that_tick_alone(column, side):
    term = Term(1.0, (Factor(BASE[column], 0),))
    run, end = model(term).make_predictor(), ENVELOPE.by_signal[BASE[column]][side]
    row = [0.0, 0.0, 0.0]
    row[column] = end
    assert (run.tick(*row), run.clamped) == (end, False)
    row[column] = 1.5 * end
    assert (run.tick(*row), run.clamped) == (end, True)
    assert (run.tick(0.0, 0.0, 0.0), run.clamped) == (0.0, False)


def test_constructed_inputs_are_computed_from_clamped_inputs():
    run = model(
        Term(1.0, (Factor("slack", 0, definition=Hysteresis("slack", "play", "position", 0.01)),))
    ).make_predictor()
    assert run.tick(9.0, 0.0, 0.0) == 0.04


@pytest.mark.parametrize(
    ("current", "force", "held"),
    [(0.5, 500.0, False), (0.501, 500.0, True), (-0.1, -100.0, False), (-0.101, -100.0, True)],
)
def test_a_force_outside_its_envelope_is_held_at_its_end_and_it_shows(current, force, held):
    run = model(Term(1000.0, (Factor("current", 0),)), limits=(-100.0, 500.0)).make_predictor()
    assert (run.tick(0.0, 0.0, current), run.held) == (force, held)
    assert (run.tick(0.0, 0.0, 0.0), run.held) == (0.0, False)


def test_a_held_force_is_the_past_force_so_that_the_run_comes_back_by_itself():
    run = model(Term(0.5, (FIRST,)), Term(1000.0, (Factor("current", 0),)), limits=(-100.0, 500.0)).make_predictor()
    assert [run.tick(0.0, 0.0, 1.0) for _ in range(4)] == [500.0] * 4
    assert [run.tick(0.0, 0.0, 0.0) for _ in range(3)] == [250.0, 125.0, 62.5]
    run.tick(0.0, 0.0, 1.0)
    run.reset()
    assert not run.held


def test_a_force_that_is_no_number_is_infinite():
    run = model(Term(1.0, (Factor("speed", 0),))).make_predictor()
    assert run.tick(0.0, math.nan, 0.0) == math.inf


def everything():
    terms = [Term(1.0, (Factor(one.name, 3, 1.0, False, one), FIRST)) for one in (*MADE, *HATS)]
    return model(*terms, Term(5.0, (Factor("speed", 4, 0.7), Factor("current", 2))), limits=(-1e30, 1e30))


def test_reset_brings_a_run_back_to_new_and_a_tick_held_from_before_too():
    run, rows = everything().make_predictor(), driven(50)
    tick = run.tick
    first = [tick(*row) for row in rows]
    tick(9.0, 9.0, 9.0)
    run.reset()
    assert not run.clamped
    assert [tick(*row) for row in rows] == first


def test_two_runs_of_a_model_share_nothing():
    made, rows = everything(), driven(50)
    one, two = made.make_predictor(), made.make_predictor()
    alone = [one.tick(*row) for row in rows]
    one.reset()
    assert [(one.tick(*row), two.tick(*row))[1] for row in rows] == alone
    one.tick(9.0, 0.0, 0.0)
    assert one.clamped
    assert not two.clamped


def test_a_run_does_not_grow():
    run, rows = everything().make_predictor(), driven(500)
    for row in rows:
        run.tick(*row)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(10):
            for row in rows:
                run.tick(*row)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 4_000
    assert peak - before < 20_000


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("what", "term"),
    [
        ("a coefficient", lambda bad: Term(bad, ())),
        ("a power", lambda bad: Term(1.0, (Factor("speed", 0, bad),))),
    ],
)
def test_a_number_that_is_not_finite_is_refused(bad, what, term):
    with pytest.raises(ModelError, match=f"{what} of the model is {bad!r}; expected a finite number"):
        model(term(bad)).make_predictor()


def test_a_range_that_is_no_number_is_refused():
    with pytest.raises(ModelError, match="expected finite numbers"):
        model(limits=(math.nan, 1.0)).make_predictor()


def test_a_signal_without_a_definition_is_refused_in_one_line():
    with pytest.raises(ModelError, match="no such signal") as error:
        model(Term(1.0, (Factor("speed\nimport os", 0),))).make_predictor()
    assert "\n" not in str(error.value)
