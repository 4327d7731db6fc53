"""Hydraulic networks for tests: one of a usual size with round numbers, random valid ones, and their models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate
from math import exp
from random import Random
from typing import Any

from samplings import make_sampling

from ces_observer.model import Envelope, Model, Sampling
from ces_observer.structures.curves import Bypass, FlowMap, IncreasingCurve
from ces_observer.structures.hydraulic import KINDS, FrictionElement, Hydraulic, SideForces, ValvePath

ENVELOPE = Envelope((-0.018, 0.018), (-1.5, 1.4), (0.1, 0.9))
SAMPLING = make_sampling(outlier_m=0.004, warm_up_s=0.1)
POSITIONS, GAS = (-0.02, -0.01, 0.0, 0.01, 0.02), (-40.0, -25.0, 0.0, 30.0, 80.0)
FLOWS = (0.004, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.2)  # [m/s]
GROOVE = Bypass((-0.01, -0.005, 0.0, 0.005, 0.01), (1e-6, 0.004, 0.012, 0.004, 1e-12))


def make_hydraulic(valve: ValvePath, **changes: Any) -> Hydraulic:
    """Return a twin tube whose piston valve the current moves, as identification gives it, with `changes`."""
    side = SideForces(-3e-5, 140.0, 50.0, 0.4, POSITIONS, GAS, (FrictionElement(1e5, 18.0, 7.0),))
    numbers = {
        "kind": "twin tube",
        "area_ratio": 0.4,
        "compression_m_N": 3e-7,
        "rebound_m_N": 1e-7,
        "compression_growth_1_m": -4.0,
        "rebound_growth_1_m": 5.0,
        "mount_m_N": 4e-7,
        "creep_m_Ns": 1e-6,
        "fade_1_W": 1e-5,
        "reservoir_N": 200.0,
        "air": 0.5,
        "most_N": 20_000.0,
        "piston": _edge((300.0, 1500.0, 3000.0), 0.01, 400.0),
        "base": _edge((400.0,), 0.05, 300.0, back=0.05),
        "external": _edge((2000.0,), 0.02, 3000.0),
        "bypass": None,
        "bypass_laminar_N": 40.0,
        "laminar_N": 20.0,
        "piston_s": 1e-3,
        "base_s": 2e-3,
        "external_s": 0.0,
        "friction_growth_1_N": 5e-5,
        "relax_s": 0.7,
        "leak_s": 0.5,
        "side": side,
        "reach": 2.0,
    }
    return Hydraulic(valve=valve, **{**numbers, **changes})


def hydraulic_model(body: Hydraulic, sampling: Sampling = SAMPLING) -> Model:
    """Return a model with the force envelope that its certificate proves."""
    model = Model(sampling, body, ENVELOPE, (-1e12, 1e12))
    bound = model.certify().bounds["force_bound_any_input_N"]
    return replace(model, force_envelope_N=(-bound, bound))


def random_hydraulic(random: Random) -> Hydraulic:
    """Return a valid network, within some orders of magnitude of real dampers."""
    lags = [random.choice((0.0, _log(random, 1e-4, 0.1))) for _ in range(3)]
    growths = [random.choice((0.0, random.uniform(-20.0, 20.0), random.uniform(-100.0, 100.0))) for _ in range(2)]
    return Hydraulic(
        random.choice(KINDS),
        _random_valve(random),
        random.choice((0.0, 0.3, _log(random, 0.01, 5.0))),
        _log(random, 1e-9, 1e-5),
        _log(random, 1e-9, 1e-5),
        *growths,
        random.choice((0.0, _log(random, 1e-9, 1e-5))),
        random.choice((0.0, _log(random, 1e-8, 1e-4))),
        random.choice((0.0, 1.0, -1.0)) * _log(random, 1e-4, 1.0),
        _log(random, 1.0, 1e5),
        random.choice((0.0, _log(random, 1e-3, 100.0))),
        _log(random, 300.0, 1e6),
        **dict(zip(("piston", "base", "external"), _random_edges(random), strict=True)),
        bypass=random.choice((None, _random_bypass(random))),
        bypass_laminar_N=_log(random, 1e-6, 1e4),
        laminar_N=_log(random, 1e-3, 1e3),
        **dict(zip(("piston_s", "base_s", "external_s"), lags, strict=True)),
        friction_growth_1_N=random.choice((0.0, _log(random, 1e-6, 1e-2))),
        relax_s=_log(random, 0.01, 10.0),
        leak_s=_log(random, 0.01, 10.0),
        side=_random_side(random),
        reach=random.uniform(1.0, 4.0),
    )


def _edge(levels: Sequence[float], width: float, slope: float, back: float = 1.0) -> FlowMap:
    """Return a valve that blows off at each level [N], by 1 / e at a flow `width` [m/s]; back, at a share of it."""
    rows = []
    for level in levels:
        forces = [level * (1.0 - exp(-flow / width)) + slope * flow for flow in FLOWS]
        rows.append((*(-back * force for force in reversed(forces)), 0.0, *forces))
    return FlowMap((*(-flow for flow in reversed(FLOWS)), 0.0, *FLOWS), tuple(rows))


def _log(random: Random, low: float, high: float) -> float:
    return float(low * (high / low) ** random.random())


def _random_valve(random: Random) -> ValvePath:
    ends = sorted(random.uniform(0.0, 1.0) for _ in range(random.randint(0, 4)))
    settings = sorted(random.uniform(0.01, 0.99) for _ in ends)
    return ValvePath(
        IncreasingCurve((-0.1, *ends, 1.1), (0.0, *settings, 1.0)),
        random.choice((0.0, 1.0, random.uniform(0.0, 20.0))),
        random.choice((0.0, _log(random, 1e-3, 0.3))),
        random.choice((0.0, _log(random, 1e-4, 0.1))),
        random.choice((0.0, _log(random, 1e-4, 0.1))),
    )


def _random_side(random: Random) -> SideForces:
    elements = (
        FrictionElement(
            _log(random, 1.0, 1e8), _log(random, 0.1, 200.0), random.choice((0.0, _log(random, 0.1, 200.0)))
        )
        for _ in range(random.choice((0, 1, 4)))
    )
    return SideForces(
        random.uniform(-3e-3, 3e-3),
        _log(random, 10.0, 1e4),
        random.choice((0.0, _log(random, 1.0, 1e3))),
        random.choice((0.0, _log(random, 0.1, 10.0))),
        (-0.04, 0.0, 0.03),
        tuple(random.uniform(-500.0, 500.0) for _ in range(3)),
        tuple(elements),
    )


def _random_edges(random: Random) -> list[FlowMap]:
    """Return three edges with curves through the origin, steep or flat in turn, for one setting or several."""
    nodes, leak = random.randint(3, 14), random.choice((1.0, 1e-3))
    zero = random.randint(0, nodes - 1)
    at = _through_zero(random, nodes, 2.0 * leak, zero)
    counts = [random.choice((1, 1, 2, 3, 5)) for _ in range(3)]
    return [FlowMap(at, tuple(_through_zero(random, nodes, 3000.0, zero) for _ in range(n))) for n in counts]


def _through_zero(random: Random, count: int, size: float, zero: int) -> tuple[float, ...]:
    """Return numbers that rise; the one of index `zero` is 0."""
    values = [0.0, *accumulate(size / count * _log(random, 1e-4, 2.0) for _ in range(count - 1))]
    return tuple(value - values[zero] for value in values)


def _random_bypass(random: Random) -> Bypass:
    count = random.randint(2, 9)
    at = accumulate((_log(random, 1e-4, 0.01) for _ in range(count)), initial=-0.02)
    return Bypass(tuple(at), tuple(random.choice((1e-12, _log(random, 1e-6, 0.1))) for _ in range(count + 1)))
