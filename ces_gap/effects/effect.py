"""The base class of effects: physics around a simulation that is a black box, with parameters in SI units.

An effect changes the inputs of the simulation (`drive`), its force (`respond`), or its twin (`edit`), a hydraulic
network: a form outside a simulation cannot say what happens in a chamber. The force of a simulation with such an effect
is that of the simulation, plus the twin's with the effect, minus the twin's without. With its magnitude at zero an
effect changes nothing. Each module of `ces_gap.effects.library` holds one effect in one or more forms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F
from ces_gap.grid import apply_response
from ces_gap.trace import Trace, TraceInputs
from ces_identify.physical.layout import EDGE_NAMES
from ces_identify.physical.models import free_run
from ces_observer.structures.curves import FlowMap
from ces_observer.structures.hydraulic import Hydraulic

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


BEYOND = 4.0  # times the largest flow, by which changed curves reach beyond their nodes
MIN_GAP = 1e-6  # between flows of a changed curve, relative to the largest
ROUNDS = 4  # of an iteration: eight give the same parameters within a tenth of their errors
COLUMN_DAMPING = 0.1  # ratio of a column of oil behind a valve that has opened
MIN_RISE = 1e-9  # between its drops, relative to the largest


@dataclass(frozen=True)
class TwinRun:
    """A network and its inputs at steps of `step_s`: `position` [m], `speed` [m/s] and `current` [A], each (m,).

    A column of oil whose mass rings on a spring has `column_s2`, its mass over the stiffness [s²]; 0 without one.
    """

    body: Hydraulic
    position: F
    speed: F
    current: F
    step_s: float
    column_s2: float = 0.0

    def force(self) -> F:
        """Return the force (m,) [N], not finite where a step has no solution."""
        inputs = np.stack([self.position, self.speed, self.current])
        force = free_run(self.body, self.step_s, inputs, np.array([[0, len(self.position)]]))
        if self.column_s2 == 0.0 or not np.isfinite(force).all():
            return force
        return apply_response(force, 1.0 / self.step_s, lambda w: 1.0 / column_response(self.column_s2, w))

    def soften(self, by_m_N: float) -> TwinRun:
        """Return the run behind a spring of a compliance [m/N]; the column's mass rings on that, too."""
        more_s2 = self.body.side.mass_kg * by_m_N if self.column_s2 > 0.0 else 0.0
        softer = self.with_body(mount_m_N=self.body.mount_m_N + by_m_N)
        return replace(softer, column_s2=self.column_s2 + more_s2)

    def with_body(self, **numbers: object) -> TwinRun:
        """Return the run with other numbers of the network."""
        return replace(self, body=replace(self.body, **numbers))  # type: ignore[arg-type]

    def behind_spring(self, deflect: Callable[[F], F], softest_m_N: float) -> TwinRun:
        """Return the run behind a spring that the force (m,) of oil and friction `deflect`s by (m,) [m].

        The mount, whose equations a step solves, is as soft as the spring is anywhere; where this is stiffer, the
        motion is moved back by the difference, which follows from the force by iteration (Picard): a contraction.
        """
        side = replace(self.body.side, gas_N=tuple(0.0 for _ in self.body.side.gas_N), viscous_Ns_m=0.0, mass_kg=0.0)
        inner = self.soften(softest_m_N)
        back = np.zeros_like(self.position)
        for _ in range(ROUNDS):
            force = inner.move(back).with_body(side=side).force()
            back = softest_m_N * force - deflect(force)
        return inner.move(back)

    def move(self, by_m: F) -> TwinRun:
        """Return the run with its position moved by (m,) [m]."""
        return replace(self, position=self.position + by_m, speed=self.speed + np.gradient(by_m, self.step_s))

    def with_flow(self, edge: str, change: Callable[[F, F], F], drops: Sequence[float] = ()) -> TwinRun:
        """Return the run with the flow [m/s] through an edge replaced by `change`(flow, drop), which must rise.

        Curves are changed at their nodes, beyond them and at further `drops` [N].
        """
        changed = [change_curve(flow, drop, change, drops) for drop, flow in _curves(self.body, edge)]
        return self.with_body(**tabulate(self.body, {edge: changed}))


def column_response(column_s2: float, frequency: F) -> NDArray[np.complex128]:
    """Return the valve's force over the rod's at angular frequencies [rad/s], for a column of oil between them.

    With a mass m of oil on a spring k, f + (2 z / w) df/dt + (m / k) d²f/dt² is the force of the valve and m dv/dt.
    """
    ratio = np.sqrt(column_s2) * frequency
    return np.asarray(1.0 + 2j * COLUMN_DAMPING * ratio - ratio**2)


Curve = tuple[F, F]
"""Drops [N] and flows [m/s] (k,), both rising."""


def _curves(body: Hydraulic, edge: str) -> list[Curve]:
    """Return the curves of an edge, with a node far beyond either end."""
    flow: FlowMap = getattr(body, edge)
    at = np.array(flow.at)
    wide = np.concatenate([[at[0] - BEYOND * np.ptp(at)], at, [at[-1] + BEYOND * np.ptp(at)]])
    curves = []
    for row in flow.rows:
        drop = np.array(row)
        low, high = (drop[1] - drop[0]) / (at[1] - at[0]), (drop[-1] - drop[-2]) / (at[-1] - at[-2])
        ends = drop[0] + low * (wide[0] - at[0]), drop[-1] + high * (wide[-1] - at[-1])
        curves.append((np.concatenate([[ends[0]], drop, [ends[1]]]), wide))
    return curves


def change_curve(flow: F, drop: F, change: Callable[[F, F], F], drops: Sequence[float]) -> Curve:
    """Return a curve with its flow replaced by `change`(flow, drop)."""
    at = np.unique(np.concatenate([drop, np.asarray(drops, dtype=np.float64)]))
    return at, change(np.interp(at, drop, flow), at)


def tabulate(body: Hydraulic, changed: dict[str, list[Curve]]) -> dict[str, FlowMap]:
    """Return all edges of a network, some of them `changed`, over flows that hold the nodes of every curve."""
    largest = max(map(abs, body.piston.at))
    nodes = np.unique(np.concatenate([body.piston.at, *(flow for curves in changed.values() for _, flow in curves)]))
    nodes = nodes[np.insert(np.diff(nodes) > MIN_GAP * largest, 0, True)]
    nodes = np.unique(np.append(nodes[np.abs(nodes) > MIN_GAP * largest], 0.0))
    at = tuple(nodes.tolist())
    edges = {name: changed.get(name) or _curves(body, name) for name in EDGE_NAMES}
    return {name: FlowMap(at, tuple(_drops_at(nodes, curve) for curve in curves)) for name, curves in edges.items()}


def _drops_at(nodes: F, curve: Curve) -> tuple[float, ...]:
    """Return the drops [N] of a curve at flows `nodes` (k,), straight beyond its ends, 0 at no flow."""
    drop, flow = curve
    out = np.interp(nodes, flow, drop)
    for (a, b), beyond in (((0, 1), nodes < flow[0]), ((-2, -1), nodes > flow[-1])):
        slope = (drop[b] - drop[a]) / max(flow[b] - flow[a], 1e-12)
        end = b if a else a
        out[beyond] = drop[end] + slope * (nodes[beyond] - flow[end])
    out -= out[nodes == 0.0]
    rises = np.maximum(np.diff(out), MIN_RISE * float(np.abs(out).max()))
    rising = np.insert(np.cumsum(rises), 0, 0.0)
    return tuple((rising - rising[nodes == 0.0]).tolist())
