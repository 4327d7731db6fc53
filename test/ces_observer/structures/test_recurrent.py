"""Recurrent networks on the vehicle: equations, forgetting, bounds, files, and a base structure."""

import json
import math
import random

import numpy as np
import pytest
from recurrent_models import ENVELOPE, make_recurrent, recurrent_model

from ces_observer.errors import ModelError
from ces_observer.model import parse_model
from ces_observer.structures.recurrent import Member, Recurrent, ScaledInput, Stage

WIDE = (-1e9, 1e9)


def drawn(count, seed, scale=1.0):
    dice = random.Random(seed)
    ranges = ENVELOPE.by_signal.values()
    return [tuple(dice.uniform(scale * low, scale * high) for low, high in ranges) for _ in range(count)]


def one_filter():
    """A network of a filter in each stage of the motion, whose numbers are few enough to compute by hand."""
    first = Stage((0.01,), (10.0,), (2.0, 0.5), (0.3, 0.2, -0.1), (0.05,), (0.7, 0.4, -0.3, 0.2), (0.01,))
    second = Stage((0.02,), (0.0,), (1.0, 0.0), (0.1, 0.0, 0.2), (0.0,), (1.0, 0.5, 0.0, -0.2), (0.3,))
    return Recurrent(100.0, 0.02, (ScaledInput("speed", 0.1, 0.5),), (), (Member(first, second),))


def test_force_is_that_of_the_equations():
    run = recurrent_model(one_filter()).make_predictor()
    pole, slow = np.exp((-100.0 + 2j * np.pi * 10.0) * 1e-3), np.exp(-50.0 * 1e-3)
    h = g = None
    for speed in (0.3, -0.2, 0.9):
        u = (speed - 0.1) / 0.5
        h = (2.0 + 0.5j) * u / (1.0 - pole) if h is None else pole * h + (2.0 + 0.5j) * u
        t = math.tanh(0.3 * h.real + 0.2 * h.imag - 0.1 * u + 0.05)
        w = math.tanh(0.7 * t + 0.4 * h.real - 0.3 * h.imag + 0.2 * u + 0.01)
        g = w / (1.0 - slow) if g is None else slow * g + w
        force = 100.0 * (math.tanh(0.1 * g + 0.2 * w) + 0.5 * g - 0.2 * w + 0.3)
        assert run.tick(0.0, speed, 0.0) == pytest.approx(force, rel=1e-12)


def test_constant_inputs_give_their_steady_force_from_the_first_tick_on():
    model = recurrent_model()
    run = model.make_predictor()
    forces = [run.tick(0.0, 0.4, 0.7) for _ in range(500)]
    steady = model.body.steady_force(model.operating_range, 0.4, 0.7)
    assert forces == pytest.approx([steady] * 500, rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_pasts_are_forgotten_with_the_slowest_decay_and_the_force_stays_within_its_bound(seed):
    model = recurrent_model(make_recurrent(seed), force_envelope_N=WIDE)
    proof = model.certify()
    runs = [model.make_predictor(), model.make_predictor()]
    forces = [[run.tick(*row) for row in drawn(300, seed + at, 3.0)] for at, run in enumerate(runs)]
    assert proof.holds
    assert np.abs(forces).max() <= proof.force_bound_N
    gaps = np.array([abs(runs[0].tick(*row) - runs[1].tick(*row)) for row in drawn(3000, 9, 3.0)])
    ticks = math.ceil(1000.0 * proof.slowest_s)
    assert gaps[15 * ticks :].max() < 1e-3 * gaps[:ticks].max()
    assert gaps[-100:].max() < 1e-9 * model.body.scale_N


def test_no_input_reaches_beyond_the_bound_of_a_filter_at_its_resonance():
    model = recurrent_model(one_filter(), force_envelope_N=WIDE)
    run, bound = model.make_predictor(), model.certify().force_bound_N
    square = [
        run.tick(0.0, math.copysign(9.0, math.sin(2.0 * math.pi * 10.0 * k * 1e-3 + 0.1)), 0.0) for k in range(2000)
    ]
    assert 0.1 * bound < np.abs(square).max() <= bound


def test_inputs_are_clamped_and_a_force_is_held():
    run, edge = recurrent_model().make_predictor(), recurrent_model().make_predictor()
    assert run.tick(0.0, 7.0, -2.0) == edge.tick(0.0, 1.0, 0.0)
    assert (run.clamped, edge.clamped) == (True, False)
    narrow = recurrent_model(force_envelope_N=(-1.0, 1.0)).make_predictor()
    forces = [narrow.tick(*row) for row in drawn(50, 1)]
    assert set(forces) <= {-1.0, 1.0} | {f for f in forces if abs(f) < 1.0}
    assert narrow.held == (abs(forces[-1]) == 1.0)


def test_a_tick_without_a_number_has_no_force_and_reset_heals_it():
    run, new = recurrent_model().make_predictor(), recurrent_model().make_predictor()
    run.tick(0.0, 0.1, 0.2)
    assert run.tick(0.0, math.nan, 0.2) == math.inf
    run.reset()
    rows = drawn(20, 2)
    assert [run.tick(*row) for row in rows] == [new.tick(*row) for row in rows]


def first(m):
    return m["recurrent"]["members"][0]["first"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.pop("recurrent"), "key 'recurrent' is missing"),
        (lambda m: m["recurrent"].update(motion=[]), "motion is .*a list of 1 to 4"),
        (lambda m: m["recurrent"]["motion"][0].update(signal="force"), "signal is 'force'"),
        (lambda m: m["recurrent"].update(current=[]), "expected null for the current, which is no input"),
        (lambda m: m["recurrent"].update(members=m["recurrent"]["members"] * 5), "members is .*a list of 1 to 8"),
        (lambda m: m["recurrent"]["members"][1].update(current=None), "expected a stage for the current"),
        (lambda m: first(m).update(decay_s=[0.01, 0.02]), r"first: frequency_Hz is .*a list of 2 numbers"),
        (lambda m: first(m).update(decay_s=[]), "first: decay_s is .*a list of 1 to 64 numbers"),
        (lambda m: first(m)["frequency_Hz"].append(1.0), "frequency_Hz is"),
        (lambda m: first(m).update(hidden_bias=[0.1] * 65), "hidden_bias is .*a list of 1 to 64 numbers"),
        (lambda m: first(m).update(gain=[1.0]), "unknown key 'gain'"),
    ],
)
def test_what_is_wrong_is_named(change, message):
    raw = json.loads(recurrent_model().to_json())
    change(raw)
    with pytest.raises(ModelError, match=message) as caught:
        parse_model(json.dumps(raw), "m.json")
    assert str(caught.value).startswith("m.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", range(3))
def test_after_the_time_that_is_proved_two_pasts_differ_by_less_than_a_percent_of_the_envelope(seed):
    model = recurrent_model(make_recurrent(seed))
    runs, limit = [model.make_predictor(), model.make_predictor()], 0.01 * 18e3
    for at, run in enumerate(runs):
        for row in drawn(300, seed + at, 3.0):
            run.tick(*row)
    gaps = [abs(runs[0].tick(*row) - runs[1].tick(*row)) for row in drawn(3000, 9, 3.0)]
    ticks = round(1000.0 * model.certify().forgets_s)
    assert max(gaps[ticks:]) < limit and 0 < ticks < 2000
