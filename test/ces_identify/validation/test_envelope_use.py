"""Signals outside a model's envelope are named with both ranges."""

from dataclasses import replace

import numpy as np
from samplings import make_sampling

from ces_identify.prepare.series import Series
from ces_identify.validation.evaluate import (
    VALIDATION,
    describe_held,
    describe_lost,
    describe_outside,
    evaluate,
    find_outside,
    outside_ranges,
)
from ces_observer.model import Envelope, Model
from ces_observer.structures.constructed_inputs import Hysteresis
from ces_observer.structures.mixture import Mixture, WeightedModel
from ces_observer.structures.polynomial import Factor, Polynomial, Term

N = 2000


FACTORS = tuple(Factor(signal, 0) for signal in ("position", "speed", "current"))


def model(position=(-1.0, 1.0), speed=(-9.0, 9.0), current=(-9.0, 9.0), factors=FACTORS):
    body = Polynomial((Term(1000.0, factors),))
    return Model(make_sampling(outlier_m=0.02), body, Envelope(position, speed, current), (-1e3, 1e3))


def series(scored=None):
    t = np.arange(N) / 1000.0
    position = -0.0299 + 0.0096 * np.sin(20.0 * t)
    force = 200.0 * np.cos(20.0 * t)
    mask = np.ones(N, bool) if scored is None else scored
    return Series(
        "ride", 1000.0, t, position, 0.2 * np.cos(20.0 * t), np.full(N, 0.5), force, np.array([[0, N]]), mask, 0, {}
    )


def test_signal_and_both_ranges_are_named_with_equal_decimals():
    (use,) = outside_ranges(model(position=(-0.0044, 0.0005)), series())
    assert str(use) == "position -0.03950 to -0.02030 m, model knows -0.00440 to 0.00050"
    assert use.outside_share == 1.0
    (use,) = outside_ranges(model(current=(0.29, 0.4)), series())
    assert str(use) == "current 0.5000 A, model knows 0.2900 to 0.4000"


def test_a_signal_that_the_model_does_not_use_is_never_outside():
    """The mounting offset of a position that is in no term was told of, for all of the time."""
    elsewhere = {"position": (-0.0044, 0.0005)}
    stop = Factor("soft", 0, definition=Hysteresis("soft", "stop", "position", 0.002))
    (unused,), (used,) = (
        evaluate(model(**elsewhere, factors=factors), [series()], VALIDATION) for factors in (FACTORS[1:], (stop,))
    )
    assert (unused.outside, unused.warnings, unused.outside_share) == ((), [], 0.0)
    assert (used.outside[0].signal, used.outside_share) == ("position", 1.0)
    parts = [WeightedModel(0.5, model(factors=(factor,)).body, (-1e6, 1e6)) for factor in FACTORS[:2]]
    assert list(replace(model(), body=Mixture(tuple(parts))).used_ranges) == ["position", "speed"]


def test_the_signal_that_is_outside_longest_comes_first():
    uses = outside_ranges(model(position=(-0.03, 0.0), speed=(-0.1, 0.1)), series())
    assert [use.signal for use in uses] == ["speed", "position"]
    text = describe_outside("ride", 0.7, uses)
    assert text.startswith(
        "ride is outside the model's envelope for 70.0 % of the time: speed -0.2000 to 0.2000 m/s, model"
    )
    assert text.count("model knows") == 2


def test_one_held_tick_is_told_of_and_is_no_doubt_in_the_model():
    held = np.arange(N) == 1350
    text = describe_held("ride", (-900.4, 950.0), series().time_s, held)
    assert text == "ride: the force was held at its envelope (-900 to 950 N) for 0.05 % of the time, first at 1.35 s"
    assert describe_held("ride", (-900.4, 950.0), series().time_s, held & False) == ""


def test_a_run_that_is_mostly_lost_says_why():
    rest = replace(series(np.arange(N) > 1600), warm_up=500, dropped={"no current": 0, "outlier": 9})
    (lost,) = evaluate(model(), [rest], VALIDATION)
    assert lost.warnings == [
        "ride: no force for 80.0 % of the time: 9 positions dropped (outlier), a warm-up of 0.5 s after the start; it "
        "moves faster, or with more noise, than the recordings of the model"
    ]
    text = describe_lost("ride", 0.7, replace(rest, segments=np.array([[0, 900], [900, N]]), dropped={"outlier": 0}))
    assert text == "ride: no force for 70.0 % of the time: a warm-up of 0.5 s after each of 2 starts"
    assert describe_lost("ride", 0.4, rest) == ""


def test_a_band_that_holds_far_too_little_is_told():
    (run,) = evaluate(model(), [series()], VALIDATION)
    narrow, wide = (
        replace(run, half_width=np.abs(run.error) + np.where(np.arange(N) % 2, 1.0, ends)) for ends in (-1, 1)
    )
    assert narrow.warnings == ["ride: the band holds 50 % of the measured forces, not the 90 % that it is meant for"]
    assert wide.warnings == []


def test_a_large_cost_of_a_force_that_hardly_varies_says_so():
    (run,) = evaluate(model(), [replace(series(), force=0.01 * series().force)], VALIDATION)
    assert run.warnings[0].startswith(
        "ride: the measured force varies by 1.41 N (standard deviation), of -1000 to 1000 N"
    )
    assert replace(run, cost=29.9).warnings == []


def test_inside_and_hardly_outside_say_nothing():
    assert outside_ranges(model(), series()) == find_outside(model(), {"position": np.empty(0)}) == ()
    few = np.zeros(1000)
    few[:5] = 2.0
    assert find_outside(model(), {"position": few}) == ()
    few[5] = 2.0
    assert [use.signal for use in find_outside(model(), {"position": few})] == ["position"]


def test_only_scored_ticks_count_unless_there_are_none():
    early = np.zeros(N, bool)
    early[:50] = True
    narrow = model(position=(-0.0305, -0.02))
    assert outside_ranges(narrow, series(early)) == ()
    assert outside_ranges(narrow, series(np.zeros(N, bool)))


def test_an_evaluation_has_the_text_ready():
    (outside,) = evaluate(model(position=(-0.0044, 0.0005)), [series()], VALIDATION)
    assert outside.outside_text.startswith(
        "ride is outside the model's envelope for 100.0 % of the time: position -0.0"
    )
    (inside,) = evaluate(model(), [series()], VALIDATION)
    assert inside.outside_text == ""
