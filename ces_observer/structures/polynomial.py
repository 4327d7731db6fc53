"""A polynomial NARX run tick by tick: position, speed and current in, force out, from its own past forces."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import copysign, inf, sqrt
from typing import Any, Protocol

from ces_observer.model import Model
from ces_observer.structures.constructed import Construction
from ces_observer.structures.tick_source import tick_source

IN_REACH = {"abs": abs, "min": min, "max": max, "sqrt": sqrt, "copysign": copysign, "inf": inf, "deque": deque}


class Tick(Protocol):
    """The work of one tick."""

    def __call__(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick's inputs [m, m/s, A]; infinite if it left the force envelope."""


class Polynomial:
    """The free run of a model; `clamped` tells whether the last tick's inputs were outside the envelope.

    `tick` is a function written for the model's terms, `ces_observer.structures.tick_source` tells how; it keeps what
    the lags need and nothing more. Raises ModelError for a model with a number that is not finite.
    """

    __slots__ = ("_construction", "_forces", "_pasts", "clamped", "tick")

    clamped: bool
    tick: Tick

    def __init__(self, model: Model) -> None:
        self._construction = Construction(model.constructed, model.sampling.rate_Hz)
        self.tick, self._pasts, self._forces = _compiled(model)(self, self._construction.arrive)
        self.reset()

    def reset(self) -> None:
        """Forget the past: forces before now count as zero, inputs before now as the first ones to come."""
        for past in self._pasts:
            past.clear()
        self._forces.extend([0.0] * (self._forces.maxlen or 0))
        self._construction.reset()
        self.clamped = False


Make = Callable[[Polynomial, Callable[..., list[float]]], tuple[Tick, list[deque[float]], deque[float]]]


def _compiled(model: Model) -> Make:
    """Return `make` of the model's source text, which reaches nothing but IN_REACH."""
    names: dict[str, Any] = {"__builtins__": {}, **IN_REACH}
    exec(compile(tick_source(model), "<tick of a polynomial model>", "exec"), names)
    make: Make = names["make"]
    return make
