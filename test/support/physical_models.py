"""Models with the physics inside for tests: fitted ones, small ones by hand, random valid ones, and hostile inputs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from random import Random

from samplings import make_sampling

from ces_observer.model import Envelope, Model, load_model
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.curves import FlowMap, IncreasingCurve
from ces_observer.structures.physical import FrictionElement, SideForces, ValvePath
from ces_observer.structures.relaxation import Relaxation, YieldingSpring

SEEDS = Path(__file__).resolve().parents[2] / "bench" / "fuzz" / "seeds" / "model"
FITTED = ("chambers", "chambers_hysteretic", "relaxation", "relaxation_hysteretic")
ENVELOPE = Envelope((-0.05, 0.05), (-1.0, 1.0), (0.0, 1.0))
PLAIN_VALVE = ValvePath(IncreasingCurve((0.0, 1.0), (0.0, 1.0)), 0.0, 0.0, 0.0, 0.0)
NO_SIDE = SideForces(0.0, 1e4, 0.0, 0.0, (-0.05, 0.05), (0.0, 0.0), ())

RELAXATION = Relaxation(
    PLAIN_VALVE,
    1e-6,
    0.0,
    FlowMap((-1.0, -0.1, 0.1, 1.0), ((-900.0, -200.0, 100.0, 400.0), (-1800.0, -700.0, 500.0, 1200.0))),
    (YieldingSpring(1e5, (50.0, 100.0)),),
    NO_SIDE,
    2.0,
)
CHAMBERS = Chambers(
    PLAIN_VALVE,
    0.4,
    2e-7,
    1e-7,
    3e-7,
    IncreasingCurve((-500.0, 0.0, 100.0, 400.0), (-0.01, 0.0, 0.5, 3.0)),
    IncreasingCurve((-500.0, 0.0, 100.0), (-0.001, 0.0, 2.0)),
    FlowMap((-0.01, 0.0, 0.1, 1.0), ((-500.0, 0.0, 200.0, 900.0), (-500.0, 0.0, 800.0, 2500.0))),
    1e-4,
    replace(NO_SIDE, friction=(FrictionElement(1e5, 20.0),)),
    2.0,
)


def physical_model(body: Relaxation | Chambers, rate_Hz: float = 1000.0) -> Model:
    """Return a model with its proved bound as force envelope."""
    model = Model(make_sampling(rate_Hz), body, ENVELOPE, (-1e9, 1e9))
    bound = model.certify().force_bound_N
    return replace(model, force_envelope_N=(-bound, bound))


def fitted_model(name: str) -> Model:
    """Return one of the fitted models."""
    return load_model(SEEDS / f"{name}.json")


def random_relaxation(random: Random) -> Relaxation:
    """Return a valid relaxation model, within some orders of magnitude of real dampers."""
    rows = random.randint(2, 5)
    springs = tuple(
        YieldingSpring(_log(random, 1e3, 1e8), tuple(random.choice((0.0, _log(random, 1.0, 1e3))) for _ in range(rows)))
        for _ in range(random.randint(0, 4))
    )
    return Relaxation(
        _random_valve(random),
        _log(random, 1e-9, 1e-4),
        random.choice((0.0, _log(random, 1e-8, 1e-2))),
        _random_map(random, rows, random.randint(2, 12)),
        springs,
        _random_side(random),
        random.uniform(1.0, 4.0),
    )


def random_chambers(random: Random) -> Chambers:
    """Return a valid model with chambers, within some orders of magnitude of real dampers."""
    friction = tuple(
        FrictionElement(_log(random, 1.0, 1e8), _log(random, 0.1, 200.0)) for _ in range(random.randint(0, 3))
    )
    return Chambers(
        _random_valve(random),
        random.choice((0.0, 0.3, _log(random, 0.01, 5.0))),
        _log(random, 1e-9, 1e-5),
        _log(random, 1e-9, 1e-5),
        random.choice((0.0, _log(random, 1e-9, 1e-5))),
        _random_flow(random),
        _random_flow(random),
        _random_map(random, random.randint(2, 5), random.randint(2, 12)),
        random.choice((0.0, _log(random, 1e-6, 1e-2))),
        replace(_random_side(random), friction=friction),
        random.uniform(1.0, 4.0),
    )


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


def _log(random: Random, low: float, high: float) -> float:
    return low * (high / low) ** random.random()


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
    return SideForces(
        random.uniform(-3e-3, 3e-3),
        _log(random, 10.0, 1e4),
        random.choice((0.0, _log(random, 1.0, 1e3))),
        random.choice((0.0, _log(random, 0.1, 10.0))),
        (-0.04, 0.0, 0.03),
        tuple(random.uniform(-500.0, 500.0) for _ in range(3)),
        (),
    )


def _random_flow(random: Random) -> IncreasingCurve:
    """Return a curve through the origin, steep or flat in turn."""
    below, above = (random.randint(1, 5) for _ in range(2))
    at, flow = ([0.0, *accumulate(_rises(random, above, size))] for size in (1000.0, 1.0))
    back, leak = ([0.0, *accumulate(_rises(random, below, size))] for size in (1000.0, 0.1))
    return IncreasingCurve((*(-x for x in back[:0:-1]), *at), (*(-y for y in leak[:0:-1]), *flow))


def _random_map(random: Random, rows: int, nodes: int) -> FlowMap:
    at = [0.0, *accumulate(_rises(random, nodes, 2.0))]
    zero = random.randint(0, nodes - 1)
    curves = [[0.0, *accumulate(_rises(random, nodes, 3000.0))] for _ in range(rows)]
    return FlowMap(_through_zero(at, zero), tuple(_through_zero(curve, zero) for curve in curves))


def _through_zero(values: Sequence[float], zero: int) -> tuple[float, ...]:
    return tuple(value - values[zero] for value in values)


def _rises(random: Random, count: int, size: float) -> list[float]:
    return [size / count * _log(random, 1e-4, 2.0) for _ in range(count)]
