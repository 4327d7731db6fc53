import math
from dataclasses import replace

import pytest
from trained_models import NETWORK, network_model

from ces_observer.model import parse_model
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.network import Network, SigmoidUnit
from ces_observer.structures.structure import OperatingRange

BOUNDS = {"position": (-0.1, 0.1), "speed": (-1.0, 1.0), "current": (0.0, 1.0)}


def run(network, limits=(-9e3, 9e3)):
    return network.make_predictor(OperatingRange(1000.0, BOUNDS, limits))


def test_force_is_the_sum_of_the_affine_part_and_the_sigmoids():
    v, i = Regressor("speed", 1, 0.2, 0.5), Regressor("current", 0, 0.5, 0.25)
    network = Network(
        (v, i), 100.0, 0.3, (2.0, -1.0), (SigmoidUnit(4.0, 0.7, (1.5, -2.0)), SigmoidUnit(-1.0, 0.0, (0.0, 3.0)))
    )
    r = run(network)
    r.tick(0.0, 0.6, 0.1)
    a, b = (0.6 - 0.2) / 0.5, (0.9 - 0.5) / 0.25
    s = [1 / (1 + math.exp(-(1.5 * a - 2.0 * b + 0.7))), 1 / (1 + math.exp(-3.0 * b))]
    assert r.tick(0.0, -0.4, 0.9) == pytest.approx(100.0 * (0.3 + 2.0 * a - b + 4.0 * s[0] - s[1]), rel=1e-12)


def test_past_forces_are_its_own_and_zero_before_the_start():
    network = Network((Regressor("force", 2, 10.0, 50.0),), 50.0, 0.1, (0.5,), ())
    r = run(network)
    forces = [r.tick(0.0, 0.0, 0.0) for _ in range(4)]
    first = 50.0 * (0.1 + 0.5 * (0.0 - 10.0) / 50.0)
    assert forces == pytest.approx([first, first, *[50.0 * (0.1 + 0.5 * (first - 10.0) / 50.0)] * 2])


def test_inputs_before_the_first_tick_are_the_first_ones():
    r = run(Network((Regressor("speed", 7, 0.0, 1.0),), 1.0, 0.0, (1.0,), ()))
    assert r.tick(0.0, 0.25, 0.0) == 0.25


def test_a_force_out_of_its_envelope_is_held_also_as_a_past_force():
    r = run(Network((Regressor("force", 1, 0.0, 50.0),), 50.0, -3.0, (-0.5,), ()), (-100.0, 1e3))
    assert (r.tick(0.0, 0.0, 0.0), r.held) == (-100.0, True)
    assert (r.tick(0.0, 0.0, 0.0), r.held) == (50.0 * (-3.0 + 0.5 * 100.0 / 50.0), False)


def test_saturated_sigmoids_do_not_overflow():
    r = run(Network((Regressor("speed", 0, 0.0, 1e-9),), 1.0, 0.0, (0.0,), (SigmoidUnit(1.0, 0.0, (1e9,)),)))
    assert r.tick(0.0, -1.0, 0.0) == pytest.approx(0.0, abs=1e-300)
    assert r.tick(0.0, 1.0, 0.0) == 1.0


def test_the_largest_network_fits_the_file_and_reads_back():
    regressors = tuple(Regressor("speed", lag, 0.123456789, 0.987654321) for lag in range(40))
    unit = SigmoidUnit(-1.234567890123456, 1.1, (0.1234567890123456,) * 40)
    model = network_model(replace(NETWORK, regressors=regressors, linear=(0.1,) * 40, units=(unit,) * 200))
    assert len(model.to_json()) < 1_000_000
    assert parse_model(model.to_json(), "m.json") == model
