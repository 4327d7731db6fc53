"""Hydraulic networks as a family of models: their parameters, compiled free run and structure.

Fits, batch runs, standard errors, refits and the report know the network only through these.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from ces_data.arrays import F, I
from ces_identify.limits import EnvelopeLimits
from ces_identify.numerics.core import batch_run, run_batch
from ces_identify.numerics.least_squares import NormalEquations
from ces_identify.physical.hydraulic_kernels import Score, run_network
from ces_identify.physical.laws import STARTS, NodeEdge
from ces_identify.physical.layout import (
    BYPASS_M,
    EDGE_NAMES,
    DataScales,
    Layout,
    as_floats,
    first_layout,
    positive_group,
)
from ces_identify.training import Training
from ces_observer.records import clip_numbers
from ces_observer.structures.curves import Bypass, FlowMap, IncreasingCurve
from ces_observer.structures.hydraulic import LONG_TICK, NEVER_S, FrictionElement, Hydraulic, SideForces, ValvePath
from ces_observer.structures.structure import OperatingRange

FITTED_RATE_HZ = 500.0  # rate of the ticks whose errors a fit counts: forces hold nothing faster
LAMINAR = 2e-3  # drop below which openings are laminar, relative to the largest force
UNLIMITED_N = 1e9
HELD_DEGREE = 2  # of a valve's change over its rows where the current was held at a few values
LEAST_OPENING = 1e-6  # of a bypass, relative to its largest
COLUMNS = (
    "lead_s", "viscous_Ns_m", "mass_kg", "gas_N", "area_ratio", "compression_m_N", "rebound_m_N", "mount_m_N",
    "creep_m_Ns", "reservoir_N", *EDGE_NAMES, "bypass", "bypass_laminar_N", "friction", "friction_yield",
    "friction_moved", "friction_growth_1_N", "closing_s",
)  # of the groups that the kernel names, in its order  # fmt: skip


@dataclass(frozen=True)
class HydraulicModels:
    """All networks of one `kind` and `layout`, to be fitted to `training`, whose current was `held` or not.

    `bypassed` are the bypass' nodes [m]. If it `leaks`, chambers empty also where a valve leads to the reservoir.
    """

    training: Training
    scales: DataScales
    kind: str
    layout: Layout
    bypassed: F
    laminar_N: float
    most_N: float = UNLIMITED_N
    held: bool = False
    leaks: bool = False

    @classmethod
    def first(
        cls, training: Training, scales: DataScales, kind: str, rows: int, held: bool, bypass: bool = False
    ) -> HydraulicModels:
        """Return the models from which the fit of a kind starts, with `rows` curves for the valve of the current."""
        low, high = scales.positions_m[0], scales.positions_m[-1]
        nodes = np.linspace(low, high, max(2, round((high - low) / BYPASS_M) + 1) if bypass else 0)
        layout = first_layout(scales, kind, rows, held, nodes)
        return cls(training, scales, kind, layout, nodes, LAMINAR * scales.force_N, held=held)

    def free(self, theta: F) -> tuple[HydraulicModels, F]:
        """Return the models whose edges' and bypass' nodes are free, about those of `theta`, and their parameters."""
        values = self.layout.values(theta)
        own = dict(zip((g.name for g in self.layout.groups), self.layout.split(theta)[0], strict=True))
        groups = self.layout.groups
        if len(self.bypassed):
            freed = positive_group("bypass", np.maximum(values["bypass"], LEAST_OPENING * values["bypass"].max()))
            groups, own["bypass"] = tuple(freed if g.name == freed.name else g for g in groups), freed.centre
        degree = HELD_DEGREE if self.held else None
        edges = tuple(NodeEdge(np.diff(values[name]) / self.layout.force_N, degree) for name in EDGE_NAMES)
        layout = replace(self.layout, groups=groups, edges=edges)
        return replace(self, layout=layout), np.concatenate([*own.values(), *(e.start for e in edges)])

    def at_interval(self, training: Training, interval_s: float, theta: F) -> tuple[HydraulicModels, F]:
        """Return the models on ticks that are `interval_s` apart, and parameters of the same damper as `theta`."""
        ratio, moved = self.scales.interval_s / interval_s, theta.copy()
        moved[[name == "delay_ticks" for name in self.layout.owners]] += np.log(ratio)
        return replace(self, training=training, scales=replace(self.scales, interval_s=interval_s)), moved

    @cached_property
    def stride(self) -> int:
        """Only every `stride`-th tick counts in a fit."""
        return max(1, round(1.0 / (self.scales.interval_s * FITTED_RATE_HZ)))

    def _arrays(self, body: Hydraulic) -> tuple[F, I, F, I]:
        """Return the arrays of the tick; parameters on the way of a fit may be far from those of a damper."""
        layout = body.lay_out(unlimited(self.scales.interval_s))
        state, memory = np.zeros(layout.states), np.zeros(layout.flags, np.int64)
        return np.array(layout.p), np.array(layout.n, np.int64), state, memory

    def force(self, theta: F) -> F:
        """Return the free run (ticks,) [N]; NaN from a step without a solution to the end of its segment."""
        force, held = np.zeros(len(self.training.measured)), np.zeros(len(self.training.measured), np.bool_)
        batch_run(*Hydraulic.runs)(*self._arrays(self.body(theta)), *self._data, force, held)
        self._last["run"] = theta, force
        return force

    def cost(self, theta: F, weights: F) -> float:
        """Return the mean J [%] over the recordings for weights (ticks,) as in `Training`."""
        last, force = self._last.get("run", (np.empty(0), np.empty(0)))
        return self.training.cost(force if np.array_equal(last, theta) else self.force(theta), weights)

    @property
    def _data(self) -> tuple[F, I]:
        return np.ascontiguousarray(self.training.inputs), np.asarray(self.training.segments, np.int64)

    @cached_property
    def _last(self) -> dict[str, tuple[F, F]]:
        """The parameters of the last run, and its force: its cost on other ticks needs no new run."""
        return {}

    def error(self, theta: F, weights: F) -> float:
        """Return the squared error for weights (ticks,) as in `Training`."""
        error = np.sqrt(weights) * (self.force(theta) - self.training.measured)
        counted = error[:: self.stride][weights[:: self.stride] > 0.0]
        return float(counted @ counted) * self.stride

    def normal_equations(self, theta: F, weights: F) -> NormalEquations:
        """Return the normal equations by the parameters, for weights (ticks,) as in `Training`."""
        error, matrix, gradients = self.sensitivities(theta, weights, np.zeros(len(weights), np.int64))
        return NormalEquations(error, matrix, -gradients[0])

    def sensitivities(self, theta: F, weights: F, blocks: I) -> tuple[float, F, F]:
        """Return error, Gauss-Newton matrix, and half the error's gradients (blocks, parameters) on blocks of ticks."""
        error, _, matrix, gradients = self._differentiate(theta, weights, blocks)
        to = self.layout.derivatives(theta)
        return error * self.stride, self.stride * (to.T @ matrix @ to), self.stride * (gradients @ to)

    def _differentiate(self, theta: F, weights: F, blocks: I) -> tuple[float, float, F, F]:
        """Return the squared error, the largest pressure [N], and matrix and gradients by the layout's values."""
        size, force = self.layout.size, np.empty(len(self.training.measured))
        matrix, gradients = np.zeros((size, size)), np.zeros((int(blocks.max()) + 1, size))
        score = Score(self.training.measured, np.sqrt(weights), blocks, self.stride)
        body, columns = self.body(theta), self.layout.columns(COLUMNS)
        oil = np.array([body.reservoir_N, body.air])
        error, most = run_network(*self._arrays(body), columns, oil, *self._data, score, force, matrix, gradients)
        self._last["run"] = theta, force
        return float(error), float(most), matrix, gradients

    def body(self, theta: F) -> Hydraulic:
        """Return the structure with these parameters, within what a file may hold: a fit may lead far beyond."""
        values, s = self.layout.values(theta), self.scales
        number = {name: float(one[0]) for name, one in values.items() if one.size == 1}
        number |= zip(("piston_s", "base_s", "external_s"), as_floats(values["closing_s"]), strict=True)
        number |= {"most_N": self.most_N, "laminar_N": self.laminar_N, "fade_1_W": 0.0}
        number |= {"relax_s": s.relax_s, "leak_s": s.relax_s if self.leaks or STARTS[self.kind].closed else NEVER_S}
        number.setdefault("bypass_laminar_N", self.laminar_N)
        flows = as_floats(self.layout.flows)
        edges: dict[str, Any] = {n: FlowMap(flows, tuple(map(as_floats, values[n]))) for n in EDGE_NAMES}
        friction = zip(values["friction"], values["friction_yield"], values["friction_moved"], strict=True)
        path = (number[name] for name in ("delay_ticks", "hysteresis_A", "rise_s", "fall_s"))
        numbers: dict[str, Any] = {f.name: number[f.name] for f in fields(Hydraulic) if f.name in number}
        body = Hydraulic(
            kind=self.kind,
            valve=ValvePath(IncreasingCurve(as_floats(s.currents_A), as_floats(values["setting"])), *path),
            **numbers,
            **edges,
            bypass=Bypass(as_floats(self.bypassed), as_floats(values["bypass"])) if len(self.bypassed) else None,
            side=SideForces(
                number["lead_s"], s.max_acceleration_m_s2, number["viscous_Ns_m"], number["mass_kg"],
                as_floats(s.positions_m), as_floats(values["gas_N"]),
                tuple(FrictionElement(*map(float, numbers)) for numbers in friction),
            ),
            reach=EnvelopeLimits.REACH,
        )  # fmt: skip
        return clip_numbers(body)

    def hold_pressures(self, theta: F) -> HydraulicModels:
        """Return the models whose pressures are held well beyond those that the recordings need."""
        ticks = len(self.training.measured)
        _, most, _, _ = self._differentiate(theta, np.zeros(ticks), np.zeros(ticks, np.int64))
        return replace(
            self, most_N=float(min(max(EnvelopeLimits.HELD_PRESSURE * most, self.scales.force_N), UNLIMITED_N))
        )


def unlimited(interval_s: float) -> OperatingRange:
    """Return an operating range that clamps no input and holds no force."""
    return replace(LONG_TICK, rate_Hz=1.0 / interval_s)


def free_run(body: Hydraulic, interval_s: float, inputs: F, segments: I) -> F:
    """Return the force (ticks,) [N] of a structure, NaN from a step without a solution to the end of its segment."""
    return run_batch(body, unlimited(interval_s), inputs, segments)[0]
