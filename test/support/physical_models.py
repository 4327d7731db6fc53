"""A small hydraulic network by hand, fitted ones, and hostile inputs for models with the physics inside."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from random import Random

from ces_observer.model import Model, load_model
from ces_observer.structures.curves import FlowMap, IncreasingCurve
from ces_observer.structures.hydraulic import Hydraulic, SideForces, ValvePath

SEEDS = Path(__file__).resolve().parents[2] / "bench" / "fuzz" / "seeds" / "model"
FITTED = ("hydraulic", "hydraulic_bypass")
PLAIN_VALVE = ValvePath(IncreasingCurve((0.0, 1.0), (0.0, 1.0)), 0.0, 0.0, 0.0, 0.0)
NO_SIDE = SideForces(0.0, 1e4, 0.0, 0.0, (-0.05, 0.05), (0.0, 0.0), ())


def straight(*forces: float) -> FlowMap:
    """Return an edge whose drop [N] is `forces` a metre per second."""
    return FlowMap((-1.0, 0.0, 1.0), tuple((-force, 0.0, force) for force in forces))


LINEAR = Hydraulic(
    kind="uniflow",
    valve=PLAIN_VALVE,
    area_ratio=0.4,
    compression_m_N=2e-7,
    rebound_m_N=1e-7,
    compression_growth_1_m=0.0,
    rebound_growth_1_m=0.0,
    mount_m_N=3e-7,
    creep_m_Ns=2e-6,
    fade_1_W=0.0,
    reservoir_N=1e6,
    air=0.0,
    most_N=1e4,
    piston=straight(200.0),
    base=straight(1000.0),
    external=straight(300.0, 1500.0),
    bypass=None,
    bypass_laminar_N=30.0,
    laminar_N=1.0,
    piston_s=0.0,
    base_s=0.0,
    external_s=0.0,
    friction_growth_1_N=0.0,
    relax_s=1e6,
    leak_s=1e6,
    side=NO_SIDE,
    reach=2.0,
)


def fitted_model(name: str) -> Model:
    """Return one of the fitted models."""
    return load_model(SEEDS / f"{name}.json")


def hostile_inputs(model: Model, random: Random, count: int) -> Iterator[tuple[float, float, float]]:
    """Yield position, speed and current: jumps between the ends of the reach and beyond, in stretches of one kind."""
    e, reach = model.envelope, model.body.reach
    spans = [tuple(1.5 * reach * bound for bound in pair) for pair in (e.position_m, e.speed_m_s, e.current_A)]
    point = [0.0, 0.0, e.current_A[0]]
    done = 0
    while done < count:
        kind, length = random.choice(KINDS), min(random.choice((1, 7, 40, 200)), count - done)
        for k in range(length):
            for n, (low, high) in enumerate(spans):
                point[n] = kind(random, k + n, low, high, point[n])
            yield point[0], point[1], point[2]
        done += length


def _alternate(_: Random, k: int, low: float, high: float, last: float) -> float:
    return (low, high)[k % 2]


def _jump(random: Random, _: int, low: float, high: float, last: float) -> float:
    return random.choice((low, high, 0.0, 1e-9 * high, -1e300, 1e300))


def _hold(_: Random, k: int, low: float, high: float, last: float) -> float:
    return last


def _anywhere(random: Random, _: int, low: float, high: float, last: float) -> float:
    return random.uniform(low, high)


def _small(random: Random, _: int, low: float, high: float, last: float) -> float:
    return random.gauss(0.0, 1e-3 * (high - low))


def _swing(_: Random, k: int, low: float, high: float, last: float) -> float:
    return 0.5 * (low + high) + 0.5 * (high - low) * math.sin(0.3 * k)


KINDS = (_alternate, _jump, _hold, _anywhere, _small, _swing)
