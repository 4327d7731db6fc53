import math
from dataclasses import replace

import pytest
from damper_models import delayed_damper
from model_examples import make_model

from ces_observer.estimator import Estimator
from ces_observer.reasons import NOT_FINITE
from ces_observer.structures.polynomial import Factor, Term

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
    assert e.reason == NOT_FINITE
    assert math.isfinite(e.step(601 * MS, stroke(601), 0.5))


def test_a_force_outside_its_envelope_is_held_and_one_that_is_not_finite_restarts_the_warm_up():
    unstable = make_model(
        terms=(Term(1.2, (Factor("force", 1),)), Term(1.0, ()), *(Term(1e308, (Factor("current", 0, 9.0),)),) * 2)
    )
    e = Estimator(unstable)
    forces = [e.step(k * MS, 0.0, 0.0 if k != 1500 else 1.0) for k in range(2200)]
    assert forces[510] == forces[1499] == 5000.0 and e.held
    assert forces[1500:2000] == [None] * 500 and forces[2100] == 5000.0


def test_after_a_gap_it_warms_up_and_gives_what_a_new_one_gives():
    old, new = ready(), Estimator(make_model())
    for k in range(2000, 2700):
        a, b = old.step(k * MS, stroke(k), 0.5), new.step(k * MS, stroke(k), 0.5)
        assert a == b
    assert a is not None


def test_between_two_ticks_the_force_is_on_the_line_through_them():
    e = ready(make_model(terms=(Term(1000.0, (Factor("position", 0, 1.0),)),)))
    force = e.step(round(600.3 * MS), stroke(600.3), 0.5)
    assert force == pytest.approx(1000.0 * stroke(600.3), abs=0.02)


# ----------------------------------------------------------------------------------------------------------- the delay


def fed(model, stamps_ms, current=lambda ms: 0.5):
    """The forces at once, and the late estimates by milliseconds."""
    e, now, late = Estimator(model), [], {}
    for ms in stamps_ms:
        now.append(e.step(round(ms * MS), stroke(ms), current(ms)))
        late |= {one.stamp_ns / MS: one for one in e.late}
    return now, late


def test_a_late_estimate_uses_the_current_that_was_held_at_its_sample():
    model = make_model(terms=(Term(1000.0, (Factor("current", 0, 1.0),)),))
    model = replace(model, sampling=replace(model.sampling, delay_s=0.004))
    _, late = fed(model, range(700), lambda ms: ms * 1e-3)
    assert [one.force for one in late.values()] == pytest.approx([float(ms) for ms in late])
    assert list(late) == list(range(500, 696))


def test_late_estimates_come_for_the_first_sample_of_each_tick_and_for_no_lost_one():
    stamps = [*(0.4 * k for k in range(1750)), *range(705, 1200)]
    _, late = fed(delayed_damper(0.003), stamps)
    assert len(late) == len({math.floor(ms + 0.5) for ms in late})
    assert all(ms - math.floor(ms + 0.5) < -0.5 + 0.4 for ms in late if 600 < ms < 699)
    assert not [ms for ms in late if 700 < ms < 705]
    assert 1196.0 in late and 1197.0 not in late


def test_bad_samples_and_a_restart_leave_no_late_estimate_behind():
    e = Estimator(delayed_damper(0.003))
    for k in range(300):
        e.step(k * MS, stroke(k), 0.5)
    assert e.late
    assert e.step(300 * MS, math.nan, 0.5) is None and not e.late
    assert e.step(300 * MS, stroke(300), math.nan) is None and not e.late
    e.step(2000 * MS, stroke(0), 0.5)
    assert not e.late
    e.reset()
    assert [one for k in range(3000, 3090) for _ in [e.step(k * MS, stroke(k), 0.5)] for one in e.late] == []
