import math

import pytest
from model_examples import make_model

from ces_observer import estimator as module
from ces_observer.estimator import Estimator
from ces_observer.model import Sampling
from ces_observer.structures.terms import Factor, Term

MS = 1_000_000


def stroke(k):
    return 0.01 * math.sin(2 * math.pi * 2e-3 * k)


def ready(model=None):
    e = Estimator(model or make_model())
    for k in range(600):
        e.step(k * MS, stroke(k), 0.5)
    assert e.reason == "ok"
    return e


def test_force_is_withheld_while_warming_up_and_not_after():
    e = Estimator(make_model())
    forces = [e.step(k * MS, stroke(k), 0.5) for k in range(502)]
    assert forces[:500] == [None] * 500
    assert all(math.isfinite(f) for f in forces[500:])


def test_force_is_the_sum_of_the_terms():
    model = make_model(
        terms=(Term(100.0, (Factor("speed", 3, 1.5, signed=False), Factor("current", 0, 2.0))), Term(7.0, ()))
    )
    e = ready(model)
    speeds = [e.speed]
    for k in range(600, 604):
        force = e.step(k * MS, stroke(k), 0.6)
        speeds.append(e.speed)
    assert force == pytest.approx(100.0 * abs(speeds[-4]) ** 1.5 * 0.36 + 7.0, rel=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_bad_current_withholds_and_the_next_good_one_resumes(bad):
    e = ready()
    assert e.step(600 * MS, stroke(600), bad) is None
    assert e.reason == module.NOT_FINITE
    assert math.isfinite(e.step(601 * MS, stroke(601), 0.5))


def test_a_force_outside_its_envelope_is_never_returned():
    unstable = make_model(
        terms=(Term(1.2, (Factor("force", 1),)), Term(1.0, ())), sampling=Sampling(1000.0, 60.0, 0.005, warm_up_s=0.0)
    )
    e = Estimator(unstable)
    forces = [e.step(k * MS, 0.0, 0.5) for k in range(2000)]
    assert None in forces
    assert all(abs(f) <= 5000.0 for f in forces if f is not None)


def test_after_a_gap_it_warms_up_and_gives_what_a_new_one_gives():
    old, new = ready(), Estimator(make_model())
    for k in range(2000, 2700):
        a, b = old.step(k * MS, stroke(k), 0.5), new.step(k * MS, stroke(k), 0.5)
        assert a == b
    assert a is not None


def test_reset_brings_it_back_to_new():
    e, new = ready(), Estimator(make_model())
    e.reset()
    assert [e.step(k * MS, stroke(k), 0.5) for k in range(550)] == [
        new.step(k * MS, stroke(k), 0.5) for k in range(550)
    ]


def test_between_two_ticks_the_force_is_on_the_line_through_them():
    e = ready(make_model(terms=(Term(1000.0, (Factor("position", 0, 1.0),)),)))
    force = e.step(round(600.3 * MS), stroke(600.3), 0.5)
    assert force == pytest.approx(1000.0 * stroke(600.3), abs=0.02)
