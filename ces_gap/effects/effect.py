"""What an effect is: physics around a simulation that nobody may open, with parameters in SI units.

An effect changes what drives the simulation (`drive`), what comes out of it (`respond`), or both. With its magnitude at
zero it changes nothing. Each module of `ces_gap.effects` holds one effect in one or more forms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import ClassVar

import numpy as np

from ces_gap.trace import F, Trace, TraceInputs

SENSOR, MOTION, VALVE, FLUID, PARALLEL, CELL = 0, 1, 2, 3, 4, 5  # stages, from the outside in and out again


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect in SI units: `name` ends with its unit; [`low`, `high`] is what a real damper can have.

    `starts` are where searches begin. `scale` is how it is searched: "linear", "log", or "inverse" (a stiffness
    is searched as compliance, so that no effect is 0). A `magnitude` scales the whole effect: at its neutral value
    (0; for "inverse" infinity) there is none.
    """

    name: str
    low: float
    high: float
    starts: tuple[float, ...]
    what: str
    scale: str = "linear"
    magnitude: bool = False
    neutral: float = 0.0

    def to_search(self, value: float) -> float:
        """Return the searched number of a value; raises nothing inside the bounds."""
        return _TO[self.scale](value)

    def to_value(self, searched: float) -> float:
        """Return the value of a searched number, held inside the bounds."""
        return float(min(max(_FROM[self.scale](searched), self.low), self.high))

    def search_bounds(self) -> tuple[float, float]:
        """Return the searched numbers of the bounds, in order."""
        a, b = self.to_search(self.low), self.to_search(self.high)
        return (a, b) if a <= b else (b, a)


def _log(value: float) -> float:
    return float(np.log(value))


def _exp(searched: float) -> float:
    return float(np.exp(min(searched, 700.0)))


def _inverse(value: float) -> float:
    return 1.0 / value if value > 0.0 else float("inf")


_TO: dict[str, Callable[[float], float]] = {"linear": float, "log": _log, "inverse": _inverse}
_FROM: dict[str, Callable[[float], float]] = {"linear": float, "log": _exp, "inverse": _inverse}


@dataclass(frozen=True)
class Effect:
    """One form of one effect. Subclasses set the class variables and override `drive`, `respond`, or both.

    `values` are in the order of `parameters`. Both methods get whole arrays (n,) on the trace's grid and return new
    ones; they never change what they are given, give finite numbers for every value inside the bounds, and vary
    smoothly with the values. They may look at `trace.time_s`, `trace.rate_Hz` and `trace.acceleration`, but never
    at `trace.force`: the effect must run where no force is measured.
    """

    name: ClassVar[str] = ""
    form: ClassVar[str] = ""
    stage: ClassVar[int] = PARALLEL
    reruns: ClassVar[bool] = False  # True if `drive` is not the identity: the simulation is asked again
    needs: ClassVar[str] = ""  # what a recording must hold for it to show, such as "a changing current"
    parameters: ClassVar[tuple[EffectParameter, ...]] = ()

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return the values at which searches on this trace begin: all products of the parameters' starts."""
        return list(product(*(p.starts for p in self.parameters)))

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return what drives the damper inside the effect; `force` [N] is the present estimate of the damper's."""
        return inputs

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] outside the effect, `force` being that inside; `inputs` drive the damper inside."""
        return force


@dataclass(frozen=True)
class Setting:
    """An effect with its parameters' values."""

    effect: Effect
    values: tuple[float, ...]

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name

    def values_by_name(self) -> dict[str, float]:
        """Return the values by name."""
        return {p.name: v for p, v in zip(self.effect.parameters, self.values, strict=True)}


@dataclass(frozen=True)
class Composition:
    """Several effects at once, applied by stage: outer ones drive first and respond last."""

    settings: tuple[Setting, ...] = field(default=())

    @property
    def names(self) -> tuple[str, ...]:
        """The effects' names."""
        return tuple(s.name for s in self.settings)

    def drive(self, trace: Trace, force: F) -> TraceInputs:
        """Return what drives the simulation."""
        inputs = trace.inputs
        for setting in sorted(self.settings, key=lambda s: s.effect.stage):
            if setting.effect.reruns:
                inputs = setting.effect.drive(trace, inputs, force, setting.values)
        return inputs

    def respond(self, trace: Trace, inputs: TraceInputs, force: F) -> F:
        """Return the force [N] outside all effects."""
        for setting in sorted(self.settings, key=lambda s: s.effect.stage):
            force = setting.effect.respond(trace, inputs, force, setting.values)
        return force
