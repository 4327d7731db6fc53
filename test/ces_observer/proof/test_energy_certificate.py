"""The proof of hydraulic networks: no run gives more energy than it took, and no input exceeds the bounds."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import pytest
from hydraulic_models import GROOVE, hydraulic_model, make_hydraulic, random_hydraulic
from physical_models import LINEAR, NO_SIDE, PLAIN_VALVE, hostile_inputs
from physical_twins import energy, limited
from samplings import make_sampling

from ces_observer.proof.certificate import summarize
from ces_observer.structures.physical import FrictionElement
from ces_observer.tick.mount import SPRING_STATES
from ces_observer.tick.pressures import PRESSURE_C, PRESSURE_R

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
