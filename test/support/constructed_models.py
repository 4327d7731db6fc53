"""A model that uses every kind of constructed input, and these alone, for tests."""

from __future__ import annotations

from collections.abc import Sequence

from samplings import make_sampling

from ces_observer.flat import ArrayLayout
from ces_observer.model import Envelope, Model
from ces_observer.structures.constructed_inputs import (
    ConstructedInput,
    Frequency,
    Hysteresis,
    Lag,
    lay_out_constructed,
    make_memberships,
)
from ces_observer.structures.polynomial import Factor, Polynomial, Term
from ces_observer.tick.constructed import constructed_update

STOP = Hysteresis("hysteresis", "stop", "position", 0.002)
PLAY = Hysteresis("remanence", "play", "current", 0.05)
LAG = Lag("valve", "current", 0.008)
FREQUENCY = Frequency("frequency", 0.25, (0.5, 20.0), 1e-4)
LOW, MID, HIGH = make_memberships("by_current", "current", (0.2, 0.5, 1.1))
SHORT, LONG = make_memberships("by_stop", "hysteresis", (-0.001, 0.001), STOP)


def used(one: object, lag: int = 0, power: float = 1.0, signed: bool = False) -> Factor:
    """Return a factor of a constructed input."""
    return Factor(one.name, lag, power, signed, one)  # type: ignore[attr-defined]


FIRST = Factor("force", 1)
SPEED = Factor("speed", 0, 0.5)
TERMS = (
    Term(7.0, ()),
    Term(900.0, (SPEED,)),
    Term(8e4, (used(STOP, 0, 1.0, True),)),
    Term(300.0, (used(STOP, 3, 0.5, True), used(PLAY, 2, 2.0))),
    Term(20.0, (used(FREQUENCY, 1, 0.5), Factor("speed", 1, 1.0))),
    Term(0.6, (FIRST, used(LOW, 4))),
    Term(0.3, (FIRST, used(MID, 4), Factor("speed", 0, 1.0, False))),
    Term(-0.5, (FIRST, used(HIGH, 4))),
    Term(0.02, (FIRST, used(LONG), used(PLAY), used(FREQUENCY, 0, 0.5))),
    Term(-0.01, (FIRST, used(LAG))),
    Term(25.0, (used(LAG, 3, 2.0), Factor("speed", 1, 0.5))),
    Term(40.0, (used(SHORT), Factor("current", 4, 1.0, False))),
    Term(15.0, (used(PLAY, 5, 1.0, True), used(FREQUENCY), Factor("position", 0), used(LOW, 4))),
)
ENVELOPE = Envelope((-0.05, 0.05), (-2.0, 2.0), (0.0, 1.5))


def constructed_damper(terms: tuple[Term, ...] = TERMS, rate_Hz: float = 1000.0) -> Model:
    """Return a contraction with a stop, a play, a lag, a frequency and hats over current and stop."""
    settings = make_sampling(rate_Hz, 0.02, warm_up_s=0.1)
    return Model(settings, Polynomial(terms), ENVELOPE, (-8000.0, 8000.0))


class ConstructedRun:
    """Constructed inputs tick by tick: `update` returns position, speed, current and each of them."""

    def __init__(self, constructed: Sequence[ConstructedInput], rate_Hz: float) -> None:
        layout, self._count, self._started = ArrayLayout(0, 0, 3, 0), len(constructed), False
        self._table, _ = lay_out_constructed(layout, constructed, rate_Hz, 0)
        self._p, self._n, self._s, _ = layout.arrays()

    def update(self, values: Sequence[float]) -> list[float]:
        """Return all signals at the next tick's position [m], speed [m/s] and current [A]."""
        self._s[:3] = values
        constructed_update(self._p, self._n, self._s, self._table, self._count, 0, self._started)
        self._started = True
        return self._s[: 3 + self._count]
