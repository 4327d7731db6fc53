"""Small sigmoid networks and neuro-fuzzy models for tests."""

from __future__ import annotations

from random import Random

from samplings import make_sampling

from ces_observer.model import Envelope, Model
from ces_observer.structures.experts import Expert, Experts
from ces_observer.structures.fuzzy import Bell, Fuzzy, Premise, Rule
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.network import Network, SigmoidUnit

SAMPLING = make_sampling()
WIDE = (-1e9, 1e9)
ENVELOPE = Envelope((-0.1, 0.1), (-1.0, 1.0), (0.0, 1.0))
REGRESSORS = (
    Regressor("force", 1, 0.0, 500.0),
    Regressor("force", 3, 100.0, 400.0),
    Regressor("speed", 0, 0.1, 0.4),
    Regressor("current", 5, 0.5, 0.2),
    Regressor("position", 2, 0.0, 0.05),
)
NETWORK = Network(
    REGRESSORS,
    500.0,
    0.1,
    (0.5, 0.1, 0.2, 0.0, 0.05),
    (SigmoidUnit(1.5, -0.3, (0.2, 0.0, 2.0, 1.0, 0.0)), SigmoidUnit(-0.6, 0.5, (0.5, -0.1, -1.0, 0.4, 0.3))),
)
FUZZY = Fuzzy(
    REGRESSORS,
    500.0,
    (
        Premise("speed", 0, (Bell(-0.5, 0.4, 2.0), Bell(0.5, 0.4, 1.5))),
        Premise("current", 4, (Bell(0.2, 0.5, 2.0), Bell(0.9, 0.3, 3.0))),
    ),
    (
        Rule((0, 0), -0.2, (0.6, 0.1, 0.3, 0.1, 0.0)),
        Rule((0, 1), -0.1, (0.2, -0.1, 0.9, 0.3, 0.1)),
        Rule((1, 0), 0.3, (0.5, 0.2, 0.5, 0.0, 0.2)),
        Rule((1, 1), 0.0, (-0.3, 0.0, 1.1, -0.2, 0.0)),
    ),
)


def network_model(network: Network = NETWORK, force_N: tuple[float, float] = (-9e3, 9e3)) -> Model:
    return Model(SAMPLING, network, ENVELOPE, force_N)


def fuzzy_model(fuzzy: Fuzzy = FUZZY, force_N: tuple[float, float] = (-9e3, 9e3)) -> Model:
    return Model(SAMPLING, fuzzy, ENVELOPE, force_N)


def random_network(chance: Random) -> Model:
    """A network that is proved stable, with a force that is not held."""
    units = tuple(
        SigmoidUnit(chance.uniform(-1, 1), chance.uniform(-1, 1), tuple(chance.uniform(-0.6, 0.6) for _ in REGRESSORS))
        for _ in range(4)
    )
    linear = (chance.uniform(-0.3, 0.5), chance.uniform(-0.1, 0.1), *(chance.uniform(-1, 1) for _ in range(3)))
    return network_model(Network(REGRESSORS, 500.0, chance.uniform(-1, 1), linear, units), WIDE)


def random_fuzzy(chance: Random) -> Model:
    """Rules that are proved stable, with a force that is not held."""
    rules = tuple(
        Rule(
            rule.memberships,
            chance.uniform(-1, 1),
            (chance.uniform(-0.7, 0.7), chance.uniform(-0.2, 0.2), *(chance.uniform(-1, 1) for _ in range(3))),
        )
        for rule in FUZZY.rules
    )
    return fuzzy_model(Fuzzy(REGRESSORS, 500.0, FUZZY.premises, rules), WIDE)


def experts_model(chance: Random | None = None, force_N: tuple[float, float] = (-9e3, 9e3)) -> Model:
    """Random experts that are proved to forget."""
    chance = chance or Random(1)
    past, inputs = REGRESSORS[0], tuple(r for r in REGRESSORS if r.signal != "force")

    def row(size: float) -> tuple[float, ...]:
        return tuple(chance.uniform(-size, size) for _ in range(1 + len(inputs)))

    gains = [(chance.uniform(0.0, 0.9), chance.uniform(0.0, 0.9)) for _ in range(3)]
    experts = (Expert(row(2.0), row(1.0), row(1.0), low, high - low, chance.uniform(0.1, 1.0)) for low, high in gains)
    return Model(SAMPLING, Experts(inputs, past, past.spread, tuple(experts)), ENVELOPE, force_N)
