"""The base class of effects: physics around a simulation that is a black box, with parameters in SI units.

An effect changes the inputs of the simulation (`drive`), its force (`respond`), or its twin (`edit`). With its
magnitude at zero it changes nothing. Each module of `ces_gap.effects.library` holds one effect in one or more forms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.network import TwinRun
from ces_gap.trace import Trace, TraceInputs

# Stages, from the outside in, then outward.
SIMULATION, SENSOR, MOTION, VALVE, FLUID, PARALLEL, CELL = range(-1, 6)


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect in SI units: `name` ends with the unit, [`low`, `high`] is plausible for any machine.

    Searches begin at `starts` and keep to the `usual` range of dampers until a fit ends at its bound. `scale` of the
    search is "linear", "log" or "inverse" (a stiffness is searched as compliance, so that no effect is 0). A
    `magnitude` scales the whole effect: at its `neutral` value (0; infinity for "inverse") there is no effect.
    """

    name: str
    low: float
    high: float
    starts: tuple[float, ...]
    what: str
    scale: str = "linear"
    magnitude: bool = False
    neutral: float = 0.0
    usual: tuple[float, float] | None = None  # all of [`low`, `high`] if None
    step: float = 0.0  # of the search variable for derivatives; 0: a share of its range

    def to_search(self, value: float) -> float:
        """Return the search variable of a value."""
        return _SCALES[self.scale][0](value)

    def to_value(self, searched: float) -> float:
        """Return the value of a search variable, clipped to the bounds."""
        return float(min(max(_SCALES[self.scale][1](searched), self.low), self.high))

    def search_bounds(self, usual: bool = False) -> tuple[float, float]:
        """Return the bounds of the search variable in ascending order, those of the `usual` range if so asked."""
        ends = self.usual if usual and self.usual else (self.low, self.high)
        low, high = sorted(map(self.to_search, ends))
        return low, high


def magnitude(
    name: str,
    low: float,
    high: float,
    starts: tuple[float, ...],
    what: str,
    neutral: float = 0.0,
    usual: tuple[float, float] | None = None,
) -> EffectParameter:
    """Return a parameter that scales the whole effect, which does nothing at `neutral`."""
    return EffectParameter(name, low, high, starts, what, magnitude=True, neutral=neutral, usual=usual)


def stiffness(name: str, low: float, high: float, starts: tuple[float, ...], what: str) -> EffectParameter:
    """Return a stiffness or a limit: a magnitude that is searched as its inverse, without effect at infinity."""
    return EffectParameter(name, low, high, starts, what, "inverse", magnitude=True, neutral=float("inf"))


def _inverse(value: float) -> float:
    return 1.0 / value if value > 0.0 else float("inf")


_SCALES: dict[str, tuple[Callable[[float], float], Callable[[float], float]]] = {  # to the search variable, and back
    "linear": (float, float),
    "log": (lambda value: float(np.log(value)), lambda searched: float(np.exp(min(searched, 700.0)))),
    "inverse": (_inverse, _inverse),
}


@dataclass(frozen=True)
class Effect:
    """One form of one effect. Subclasses set the class variables and override `drive` and `respond`, or `edit`.

    `values` are in the order of `parameters`. `drive` and `respond` get arrays (n,) on the trace's grid and return new
    ones, finite for all values inside the bounds and smooth in the values; they never change their arguments. They may
    read `trace.time_s`, `trace.rate_Hz` and `trace.acceleration`, but not `trace.force`: an effect also runs without a
    measured force.
    """

    name: ClassVar[str] = ""
    form: ClassVar[str] = ""
    summary: ClassVar[str] = ""  # the effect in a few words, for the report
    visible: ClassVar[str] = ""  # where and when it shows, in a few words
    bench: ClassVar[tuple[str, str]] = ("", "")  # table and column of `ces characterise` that the effect changes most
    mistaken_for: ClassVar[tuple[str, ...]] = ()  # effects that look most like it
    stage: ClassVar[int] = PARALLEL
    reruns: ClassVar[bool] = False  # True if `drive` is not the identity: the simulation runs again
    edits: ClassVar[bool] = False  # True if `edit` is not the identity: a form inside the damper, for its twin only
    nuisance: ClassVar[bool] = False  # True if it competes with no effect: a cause only where nothing else is better
    prior_share: ClassVar[float] = 0.0  # of the gap's energy, by which a flexible map must explain more than an effect
    limit: ClassVar[str] = ""  # effect to which this form tends at a bound: significance decides between the two
    needs: ClassVar[str] = ""  # what a recording must contain for the effect to be visible: "a changing current"
    parameters: ClassVar[tuple[EffectParameter, ...]] = ()

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return the start values of searches on this trace: all combinations of the parameters' starts."""
        return list(product(*(p.starts for p in self.parameters)))

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the inputs of the damper inside the effect; `force` [N] (n,) is the damper's estimated force."""
        return inputs

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        """Return the run of the simulation's twin with the effect inside."""
        return run

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) outside the effect from `force` and `inputs` of the damper inside."""
        return force


@dataclass(frozen=True)
class Setting:
    """An effect with parameter values."""

    effect: Effect
    values: tuple[float, ...]

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name


@dataclass(frozen=True)
class Composition:
    """Several effects, nested by stage: outer effects drive first and respond last."""

    settings: tuple[Setting, ...] = ()

    @property
    def reruns(self) -> bool:
        """Whether one of the effects changes the simulation's inputs."""
        return any(s.effect.reruns for s in self.settings)

    @property
    def edits(self) -> bool:
        """Whether one of the effects lies inside the damper."""
        return any(s.effect.edits for s in self.settings)

    @property
    def network_share(self) -> float:
        """The share of the simulation's force in whose place the network of an effect stands."""
        return sum(s.values[0] for s in self.settings if s.effect.edits and s.effect.stage == SIMULATION)

    def edit(self, run: TwinRun) -> TwinRun:
        """Return the run of the simulation's twin with the effects that lie inside."""
        for setting in sorted(self.settings, key=lambda s: s.effect.stage):
            run = setting.effect.edit(run, setting.values)
        return run

    def drive(self, trace: Trace, force: F) -> TraceInputs:
        """Return the inputs of the simulation inside all effects."""
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
