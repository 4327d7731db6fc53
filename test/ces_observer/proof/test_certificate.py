from __future__ import annotations

import math
import random
from dataclasses import replace
from random import Random

import pytest
from hydraulic_models import GROOVE, hydraulic_model, make_hydraulic, random_hydraulic
from model_examples import make_model
from physical_models import LINEAR, NO_SIDE, PLAIN_VALVE, hostile_inputs
from physical_twins import energy, limited
from samplings import make_sampling

from ces_observer.model import Envelope
from ces_observer.proof.certificate import summarize
from ces_observer.proof.intervals import product
from ces_observer.structures.hydraulic import FrictionElement
from ces_observer.structures.polynomial import Factor, Term
from ces_observer.tick.mount import SPRING_STATES
from ces_observer.tick.pressures import PRESSURE_C, PRESSURE_R

ENVELOPE = Envelope((-0.1, 0.1), (-1.2, 0.9), (0.29, 0.7))
I8 = Factor("current", 8, 2.0, signed=False)


def model(*terms):
    return make_model(terms=terms, envelope=ENVELOPE, force_envelope_N=(-1e9, 1e9))


def output(coefficient, *inputs, lag=1):
    return Term(coefficient, (Factor("force", lag), *inputs))


def test_bounds_are_exact_where_they_are_known():
    c = model(
        output(0.5), output(0.3, Factor("speed", 0, 0.5, signed=False)), Term(-40.0, (Factor("speed", 3),))
    ).certify()
    assert c.gain == pytest.approx(0.5 + 0.3 * math.sqrt(1.2), rel=3e-3)
    assert c.drive_N == pytest.approx(48.0, rel=3e-3)
    assert c.force_N >= 48.0 / (1.0 - 0.5 - 0.3 * math.sqrt(1.2))


def test_terms_that_cancel_have_a_small_bound():
    """Interval arithmetic alone would bound 2.1 |v| - 2 |v| by 2.1 * 1.2."""
    v = Factor("speed", 0, 1.0, signed=False)
    c = model(output(2.1, v), output(-2.0, v), Term(1.0, ())).certify()
    assert c.gain == pytest.approx(0.12, rel=0.01)


def test_different_output_lags_add_up():
    assert model(output(0.5), output(-0.4, lag=2)).certify().gain == pytest.approx(0.9, rel=3e-3)


@pytest.mark.slow
def test_a_signal_at_two_delays_of_a_term_is_two_variables():
    """Speed and sign of different delays may take any values together; those of one delay may not."""
    size, sign = Factor("speed", 3, 0.4, signed=False), Factor("speed", 1, 0.0)
    both = output(0.5, Factor("current", 0, 1.0, signed=False), size, sign)
    assert model(both).certify().gain == pytest.approx(0.5 * 0.7 * 1.2**0.4, rel=3e-3)
    apart = output(-0.5, Factor("current", 0, 1.0, signed=False), size, Factor("speed", 2, 0.0))
    assert model(both, apart).certify().gain == pytest.approx(2 * 0.5 * 0.7 * 1.2**0.4, rel=3e-3)
    # where one sign cancels, the bound is loose, never wrong: near zero the sign counts as either
    alone = output(0.5, size, sign)
    cancelling = model(alone, replace(alone, coefficient=-0.4)).certify().gain
    assert 0.1 * 1.2**0.4 <= cancelling <= 0.9 * 1.2**0.4 * 1.01


def test_what_is_no_contraction_gets_no_certificate():
    c = model(output(0.9), output(0.4, Factor("speed", 0, 1.0), I8)).certify()
    assert not c.holds
    assert c.force_N == math.inf
    assert not model(output(0.9), output(0.4, Factor("speed", 0, 1.0), I8)).is_stable()
    assert model(output(0.9), output(0.1, Factor("speed", 0, 1.0), I8)).is_stable()


def test_a_signed_power_of_zero_is_a_sign():
    assert model(output(0.6, Factor("speed", 0, 0.0))).certify().gain == pytest.approx(0.6, rel=3e-3)


@pytest.mark.parametrize("seed", range(3))
def test_no_run_leaves_the_proved_bound(seed):
    """Against the worst inputs a random search finds, jumping through the whole envelope at every tick."""
    chance = random.Random(seed)
    terms = [
        output(
            chance.uniform(-0.15, 0.15), Factor("speed", 0, chance.choice([0.5, 1.0, 1.5]), chance.random() < 0.5), I8
        )
        for _ in range(3)
    ]
    made = model(output(0.7), *terms, Term(300.0, (Factor("speed", 0, 0.5),)), Term(90.0, (Factor("current", 2),)))
    certificate = made.certify()
    assert certificate.holds
    run, largest = made.make_predictor(), 0.0
    for k in range(3000):
        speed = chance.choice([-1.2, 0.9, chance.uniform(-1.2, 0.9)]) if k % 50 else 5.0
        largest = max(largest, abs(run.tick(0.0, speed, chance.choice([0.29, 0.7, -3.0]))))
    assert 0.02 * certificate.force_N < largest <= certificate.force_N


def test_intervals_hold_what_they_should():
    chance = random.Random(1)
    for _ in range(300):
        a, b = sorted((chance.uniform(-2, 2), chance.uniform(-2, 2)))
        factor = Factor("speed", 0, chance.choice([0.0, 0.25, 0.5, 1.0, 1.7]), chance.random() < 0.5)
        low, high = factor.interval((a, b))
        c, d = product((low, high), (a, b))
        for s in (a, b, chance.uniform(a, b), 0.0 if a <= 0.0 <= b else a):
            value = abs(s) ** factor.power * (-1.0 if factor.signed and s < 0 else 1.0)
            assert low <= value <= high
            assert c <= value * s <= d
            slope = factor.slope_interval((a, b))
            if slope and s and factor.power:
                sign = 1.0 if factor.signed or s > 0 else -1.0
                assert slope[0] <= sign * factor.power * abs(s) ** (factor.power - 1.0) <= slope[1]


def test_a_proof_with_much_cancellation_is_short():
    v = [Factor("speed", 0, p, signed=False) for p in (0.5, 1.0, 1.5)]
    made = model(output(4.0, v[0]), output(-8.0, v[1]), output(4.0, v[2]), output(0.2, I8))
    c = made.certify()
    assert c.gain == pytest.approx(0.2 * 0.49 + 4.0 * (1 / 3) * (1 - 1 / 3) ** 2, rel=3e-3)
    assert c.boxes < 5000


def test_an_input_that_never_changes_does_not_loosen_the_bound():
    """A range of one point, also at zero where no slope exists, leaves the centred form to the others."""
    still = Envelope((0.0, 0.0), (0.1, 0.9), (0.5, 0.5))
    v = [Factor("speed", 0, p, signed=False) for p in (1.0, 2.0)]
    x, i = Factor("position", 0, 0.5, signed=False), Factor("current", 0, 1.0, signed=False)
    made = make_model(terms=(output(4.0, v[0]), output(-4.0, v[1]), output(0.2, i), output(1.0, x)), envelope=still)
    c = made.certify()
    assert c.gain == pytest.approx(1.1, rel=3e-3)
    assert c.boxes < 300


# ----------- The proof of hydraulic networks: no run gives more energy than it took, and no input exceeds the bounds.


TICKS = 100_000


def test_the_bound_is_that_of_held_pressures_friction_and_side_forces():
    """Drives reach 3 m/s and 0.2 m/s of lead, accelerations 200 m/s2; gas is 300 N at the end of the positions."""
    side = replace(
        NO_SIDE,
        lead_s=-1e-3,
        max_acceleration_m_s2=200.0,
        viscous_Ns_m=10.0,
        mass_kg=2.0,
        position_m=(-0.036, 0.036),
        gas_N=(-300.0, 100.0),
        friction=(FrictionElement(1e5, 20.0),),
    )
    certificate = hydraulic_model(replace(LINEAR, side=side, friction_growth_1_N=1e-4)).certify()
    oil, friction = 2.4 * 1e4, 20.0 * (1.0 + 1e-4 * 1e4)
    assert certificate.force_bound_N == pytest.approx(oil + friction + 10.0 * 3.2 + 400.0 + 300.0)
    assert certificate.envelope_N == pytest.approx(certificate.force_bound_N - 10.0 * 1.5 - 100.0)
    assert certificate.holds


@pytest.mark.parametrize("seed", range(12))
def test_a_network_gives_no_more_energy_than_it_took(seed):
    """At a given stroke, whatever the speeds and currents: what is stored grows by no more than drive times force."""
    random = Random(seed)
    body = random_hydraulic(random)
    body = replace(body, side=replace(NO_SIDE, friction=body.side.friction), bypass=body.bypass and GROOVE, most_N=1e9)
    model = hydraulic_model(body, make_sampling(random.choice((200.0, 2000.0))))
    run, interval = model.make_predictor(), 1.0 / model.sampling.rate_Hz
    springs = model.body.lay_out(model.operating_range).n[SPRING_STATES]
    before = largest = 0.0
    for speed, current in zip(*limited(model, list(hostile_inputs(model, random, 300)))[1:], strict=True):
        run.tick(0.004, speed, current)
        p_c, p_r, rubbing = run.s[PRESSURE_C], run.s[PRESSURE_R], run.s[springs : springs + len(body.side.friction)]
        after = energy(body, 0.004, p_c, p_r, rubbing)
        largest = max(largest, after)
        taken = interval * speed * ((1.0 + body.area_ratio) * p_c - p_r + sum(rubbing))
        assert after - before <= taken + 1e-9 * (largest + abs(taken)) + 1e-20
        before = after
    assert largest > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_no_input_exceeds_the_bounds(seed):
    random = Random(100 + seed)
    model = hydraulic_model(random_hydraulic(random), make_sampling(random.choice((200.0, 1000.0, 4000.0))))
    within = replace(model, force_envelope_N=(-1e300, 1e300)).make_predictor()
    low, high = envelope = -0.3 * model.force_envelope_N[1], 0.2 * model.force_envelope_N[1]
    held = replace(model, force_envelope_N=envelope).make_predictor()
    bound, most = model.certify().force_bound_N, model.body.most_N
    for one in hostile_inputs(model, random, TICKS // 5):
        assert abs(within.tick(*one)) <= bound
        assert max(abs(within.s[PRESSURE_C]), abs(within.s[PRESSURE_R])) <= most
        assert low <= held.tick(*one) <= high


def test_what_is_claimed_says_both_bounds_and_nothing_of_two_runs():
    model = hydraulic_model(make_hydraulic(PLAIN_VALVE))
    stored = model.certify().to_mapping()
    inside, anywhere = (stored[key] for key in ("force_bound_N", "force_bound_any_input_N"))
    text = summarize(stored)
    assert text.startswith("passive: ")
    forgotten = f"its start is forgotten after {7.0 * model.body.relax_s:.2g} s"
    assert text.endswith(f"at most {inside:.0f} N within the envelope, {anywhere:.0f} N for any input; {forgotten}")
    assert "difference" not in text + str(stored["claim"])
    assert model.is_stable()
