"""The proof of models with physics inside: bounds that no input exceeds, by hand and by search."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from random import Random

import pytest
from physical_models import (
    CHAMBERS,
    FITTED,
    NO_SIDE,
    RELAXATION,
    fitted_model,
    hostile_inputs,
    physical_model,
    random_chambers,
    random_relaxation,
)

from ces_observer.proof.certificate import summarize
from ces_observer.structures.chambers import bound_energy
from ces_observer.structures.curves import FlowMap, IncreasingCurve

SPEED = 1.0  # end of the envelope of the small models


def test_the_bound_of_a_relaxation_is_the_force_that_passes_the_largest_drive():
    """At 1 m/s the harder curve gives 1800 N; with reach 2 it goes on straight to 2 m/s; the spring adds 100 N."""
    certificate = physical_model(RELAXATION).certify()
    assert certificate.envelope_N == pytest.approx(1800.0 + 100.0)
    assert certificate.force_bound_N == pytest.approx(1800.0 + 1100.0 / 0.9 + 100.0)


def test_lead_inertia_viscosity_and_gas_enter_the_bound():
    side = replace(
        NO_SIDE, lead_s=-1e-3, max_acceleration_m_s2=200.0, viscous_Ns_m=10.0, mass_kg=2.0, gas_N=(-300.0, 100.0)
    )
    certificate = physical_model(replace(RELAXATION, side=side)).certify()
    drive = 1.0 + 0.2
    passed = 1800.0 + 0.2 * 1100.0 / 0.9
    assert certificate.envelope_N == pytest.approx(passed + 100.0 + 10.0 * drive + 400.0 + 300.0)


def test_a_curve_that_overtakes_another_beyond_its_end_is_covered():
    """At the last node the first curve is above, at the largest drive the second."""
    curves = FlowMap((-0.1, 0.0, 0.1), ((-120.0, 0.0, 120.0), (-100.0, -90.0, 100.0)))
    certificate = physical_model(replace(RELAXATION, map=curves, springs=())).certify()
    assert certificate.envelope_N == pytest.approx(100.0 + 0.9 * 1900.0)
    chambers = physical_model(replace(CHAMBERS, map=FlowMap((-0.1, 0.0, 0.1), ((-9, 0, 120), (-8, 0, 10)))))
    run, bound = chambers.make_predictor(), chambers.certify().force_bound_N
    assert max(abs(run.tick(0.0, -2.0, current)) for current in (0.0, 0.5, 1.0) * 300) <= bound


@pytest.mark.slow
def test_the_energy_bound_of_chambers_covers_a_dense_grid_of_pressures():
    """Every pressure with more energy dissipates more than the drive supplies, at every setting."""
    bound = bound_energy(CHAMBERS, SPEED)
    c_c, c_r, mount, ratio = CHAMBERS.compression_m_N, CHAMBERS.rebound_m_N, CHAMBERS.mount_m_N, 1.4
    valves, worst = CHAMBERS.map.inverses, 0.0
    for angle in range(720):
        d_c, d_r = math.cos(math.pi * angle / 360), math.sin(math.pi * angle / 360)
        for size in (10.0 * 1.03**k for k in range(250)):
            p_c, p_r = size * d_c, size * d_r
            lost = (p_c - p_r) * CHAMBERS.check(p_c - p_r) - p_c * CHAMBERS.refill(-p_c)
            lost += min(p_r * valve(p_r) for valve in valves)
            if lost <= SPEED * abs(ratio * p_c - p_r):
                worst = max(worst, 0.5 * (c_c * p_c**2 + c_r * p_r**2 + mount * (ratio * p_c - p_r) ** 2))
    assert worst <= bound <= 1.1 * worst


@pytest.mark.parametrize("name", FITTED)
def test_the_bound_of_fitted_models_is_reached_within_a_half(name):
    """The largest force that constant inputs of the envelope give, against its proved bound."""
    model = fitted_model(name)
    certificate, run = model.certify(), model.make_predictor()
    low, high = model.envelope.current_A
    largest = 0.0
    for speed in model.envelope.speed_m_s:
        for current in (low, 0.5 * (low + high), high):
            largest = max(largest, *(abs(run.tick(0.0, speed, current)) for _ in range(300)))
    assert largest <= certificate.envelope_N <= 1.5 * largest
    assert certificate.envelope_N < certificate.force_bound_N


def energy(run):
    """Return the state of which a quadratic form is the energy, and that form's weights."""
    return [run._force, *run._stretched] if hasattr(run, "_stretched") else list(run.pressures)


def energy_between(model, one, two):
    """Return the energy of the difference of two runs."""
    body, (a, *b) = model.body, [x - y for x, y in zip(energy(one), energy(two), strict=True)]
    if model.structure == "relaxation":
        stretched = zip(b, body.springs, strict=True)
        return body.compliance_m_N * a * a + sum(h * h / spring.stiffness_N_m for h, spring in stretched)
    force = (1.0 + body.area_ratio) * a - b[0]
    return body.compression_m_N * a * a + body.rebound_m_N * b[0] ** 2 + body.mount_m_N * force * force


MODELS = [*FITTED, *((make, seed) for make in (random_relaxation, random_chambers) for seed in range(6))]


@pytest.mark.parametrize("which", MODELS)
@pytest.mark.slow
def test_the_energy_of_a_difference_never_grows(which):
    """Two runs with the same currents and other speeds, then with the same inputs."""
    model = fitted_model(which) if isinstance(which, str) else physical_model(which[0](Random(which[1])))
    random = Random(3)
    one, two = model.make_predictor(), model.make_predictor()
    energies = []
    for start in range(4):
        for position, speed, current in hostile_inputs(model, random, 60):
            one.tick(position, speed, current)
            two.tick(-position, -0.5 * speed, current)
        one.tick(0.0, 0.0, 0.0), two.tick(0.0, 0.0, 0.0)  # the next accelerations are the same
        energies = [energy_between(model, one, two)]
        for inputs in hostile_inputs(model, random, 200 + start):
            one.tick(*inputs), two.tick(*inputs)
            energies.append(energy_between(model, one, two))
        size = energy_between(model, one, model.make_predictor())
        assert all(after <= before * (1.0 + 1e-9) + 1e-12 * size for before, after in pairwise(energies))
    assert energies[0] > 0.0


def test_a_bound_that_is_not_finite_proves_nothing():
    """Nothing passes the valves: the pressures at which 1 m/s would are beyond all that are searched."""
    closed = IncreasingCurve((-1.0, 0.0, 1.0), (-1e-14, 0.0, 1e-14))
    curve = (-1e9, 0.0, 1e9)
    tight = replace(CHAMBERS, check=closed, refill=closed, map=FlowMap((-1e-4, 0.0, 1e-4), (curve, curve)))
    model = replace(physical_model(CHAMBERS), body=tight)
    assert not model.certify().holds
    assert not model.is_stable()
    assert model.certify().doubt == "the bound on its force is not finite"
    assert physical_model(CHAMBERS).is_stable()


def test_a_stored_certificate_is_told_in_a_sentence():
    stored = physical_model(RELAXATION).certify().to_mapping()
    inside = f"{stored['force_bound_N']:.0f} N within the envelope"
    assert summarize(stored) == (
        f"passive: the difference of two runs never grows, and |force| at most {inside}, 3122 N for any input"
    )
