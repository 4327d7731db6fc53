"""Hydraulic networks as a family of models: their parameters, compiled free run and structure.

Fits, batch runs, standard errors, refits and the report know the network only through these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_identify.physical.hydraulic_kernels import run_network
from ces_identify.physical.laws import NodeEdge
from ces_identify.physical.layout import (
    BYPASS_M,
    EDGE_NAMES,
    DataScales,
    Layout,
    as_floats,
    first_layout,
    positive_group,
)
from ces_identify.physical.network_step import NetworkArrays
from ces_identify.physical.valve_kernels import RunData, Score
from ces_identify.trained.training import Training
from ces_observer.model import Model
from ces_observer.structures.curves import Bypass, FlowMap, IncreasingCurve
from ces_observer.structures.hydraulic import Hydraulic
from ces_observer.structures.physical import INPUTS, FrictionElement, SideForces, ValvePath, widen

FITTED_RATE_HZ = 500.0  # rate of the ticks whose errors a fit counts: forces hold nothing faster
LAMINAR = 2e-3  # drop below which openings are laminar, relative to the largest force
UNLIMITED_N = 1e9
MOST = 2.0  # pressures at which they are held, relative to the largest that the recordings need
REACH = 2.0
HELD_DEGREE = 2  # of a valve's change over its rows where the current was held at a few values
LEAST_OPENING = 1e-6  # of a bypass, relative to its largest
NO_FIT = np.empty((0, 0))
PLACES = (
    "lead_s", "viscous_Ns_m", "mass_kg", "gas_N", "ratio", "compression", "rebound", "mount", "creep", "fade_1_W",
    "reservoir", *EDGE_NAMES, "bypass", "narrow_N", "friction", "friction_yield", "friction_moved", "growth",
    "closing_s",
)  # fmt: skip


@dataclass(frozen=True)
class HydraulicModels:
    """All networks of one `kind` and `layout`, to be fitted to `training`, whose current was `held` or not.

    `bypassed` are the bypass' nodes [m].
    """

    training: Training
    scales: DataScales
    kind: str
    layout: Layout
    bypassed: F
    laminar_N: float
    most_N: float = UNLIMITED_N
    held: bool = False

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
        tail = self.layout.tail
        if len(self.bypassed):
            freed = positive_group("bypass", np.maximum(values["bypass"], LEAST_OPENING * values["bypass"].max()))
            tail, own["bypass"] = (freed, *tail[1:]), freed.centre
        degree = HELD_DEGREE if self.held else None
        edges = tuple(NodeEdge(np.diff(values[name]) / self.layout.force_N, degree) for name in EDGE_NAMES)
        layout = replace(self.layout, tail=tail, edges=edges)
        return replace(self, layout=layout), np.concatenate([*own.values(), *(e.start for e in edges)])

    def at_interval(self, training: Training, interval_s: float, theta: F) -> tuple[HydraulicModels, F]:
        """Return the models on ticks that are `interval_s` apart, and parameters of the same damper as `theta`."""
        ratio, moved = self.scales.interval_s / interval_s, theta.copy()
        moved[[name == "delay_ticks" for name in self.layout.owners]] += np.log(ratio)
        return replace(self, training=training, scales=replace(self.scales, interval_s=interval_s)), moved

    @cached_property
    def data(self) -> RunData:
        """The inputs of the training data."""
        position, speed, current = (np.ascontiguousarray(row) for row in self.training.inputs)
        return RunData(position, speed, current, self.training.segments)

    @cached_property
    def stride(self) -> int:
        """Only every `stride`-th tick counts in a fit."""
        return max(1, round(1.0 / (self.scales.interval_s * FITTED_RATE_HZ)))

    def arrays(self, theta: F) -> NetworkArrays:
        """Return the kernel's view of the network with these parameters."""
        s, rows = self.scales, np.array([e.rows for e in self.layout.edges], dtype=np.int64)
        friction = len(next(g for g in self.layout.tail if g.name == "friction").centre)
        return NetworkArrays(
            self.layout.k(theta), self.layout.places(PLACES), s.currents_A, self.layout.flows, s.positions_m,
            self.bypassed, rows, friction, self.laminar_N, self.most_N, s.interval_s, s.max_acceleration_m_s2,
        )  # fmt: skip

    def force(self, theta: F) -> F:
        """Return the free run (ticks,) [N]."""
        return self._run(theta, self._score(np.zeros(len(self.training.measured)), 1), NO_FIT, NO_FIT)[0]

    def cost(self, theta: F, weights: F) -> float:
        """Return the mean J [%] over the recordings for weights (ticks,) as in `Training`."""
        last, force = self._last.get("run", (np.empty(0), np.empty(0)))
        return self.training.cost(force if np.array_equal(last, theta) else self.force(theta), weights)

    @cached_property
    def _last(self) -> dict[str, tuple[F, F]]:
        """The parameters of the last run, and its force: its cost on other ticks needs no new run."""
        return {}

    def error(self, theta: F, weights: F) -> float:
        """Return the squared error for weights (ticks,) as in `Training`."""
        return self._run(theta, self._score(weights, self.stride), NO_FIT, NO_FIT)[1] * self.stride

    def normal_equations(self, theta: F, weights: F) -> tuple[float, F, F]:
        """Return the squared error, its Gauss-Newton matrix and the gradient of half of it, by the parameters."""
        error, matrix, gradients = self.sensitivities(theta, weights, np.zeros(len(weights), np.int64))
        return error, matrix, gradients[0]

    def sensitivities(self, theta: F, weights: F, blocks: I) -> tuple[float, F, F]:
        """Return error, Gauss-Newton matrix, and the gradients (blocks, parameters) of each block of ticks."""
        to = self.layout.derivatives(theta)
        matrix, gradients = np.zeros((len(to), len(to))), np.zeros((int(blocks.max()) + 1, len(to)))
        score = Score(self.training.measured, np.sqrt(weights), blocks, self.stride)
        _, error = self._run(theta, score, matrix, gradients)
        return error * self.stride, self.stride * (to.T @ matrix @ to), self.stride * (gradients @ to)

    def _score(self, weights: F, stride: int) -> Score:
        return Score(self.training.measured, np.sqrt(weights), np.zeros(len(weights), np.int64), stride)

    def _run(self, theta: F, score: Score, matrix: F, gradients: F) -> tuple[F, float]:
        force = np.empty(len(self.training.measured))
        error, _, _ = run_network(self.arrays(theta), self.data, score, force, matrix, gradients)
        self._last["run"] = theta, force
        return force, float(error)

    def body(self, theta: F) -> Hydraulic:
        """Return the structure with these parameters."""
        values, s = self.layout.values(theta), self.scales
        number = {name: float(one[0]) for name, one in values.items() if one.size == 1}
        flows = as_floats(self.layout.flows)
        edges: dict[str, Any] = {n: FlowMap(flows, tuple(map(as_floats, values[n]))) for n in EDGE_NAMES}
        friction = zip(values["friction"], values["friction_yield"], values["friction_moved"], strict=True)
        path = (number[name] for name in ("delay_ticks", "hysteresis_A", "rise_s", "fall_s"))
        lags: dict[str, Any] = dict(
            zip(("piston_s", "base_s", "external_s"), as_floats(values["closing_s"]), strict=True)
        )
        return Hydraulic(
            kind=self.kind,
            valve=ValvePath(IncreasingCurve(as_floats(s.currents_A), as_floats(values["setting"])), *path),
            area_ratio=number["ratio"],
            compression_m_N=number["compression"],
            rebound_m_N=number["rebound"],
            compression_growth_1_m=number["compression_growth"],
            rebound_growth_1_m=number["rebound_growth"],
            mount_m_N=number["mount"],
            creep_m_Ns=number["creep"],
            fade_1_W=number["fade_1_W"],
            reservoir_N=number["reservoir"],
            air=number["air"],
            most_N=self.most_N,
            **edges,
            bypass=Bypass(as_floats(self.bypassed), as_floats(values["bypass"])) if len(self.bypassed) else None,
            bypass_laminar_N=number.get("narrow_N", self.laminar_N),
            laminar_N=self.laminar_N,
            **lags,
            friction_growth_1_N=number["growth"],
            side=SideForces(
                number["lead_s"], s.max_acceleration_m_s2, number["viscous_Ns_m"], number["mass_kg"],
                as_floats(s.positions_m), as_floats(values["gas_N"]),
                tuple(FrictionElement(*map(float, one)) for one in friction),
            ),
            reach=REACH,
        )  # fmt: skip

    def hold_pressures(self, theta: F) -> HydraulicModels:
        """Return the models whose pressures are held well beyond those that the recordings need."""
        force = np.empty(len(self.training.measured))
        score = self._score(np.zeros(len(force)), 1)
        _, _, most = run_network(self.arrays(theta), self.data, score, force, NO_FIT, NO_FIT)
        return replace(self, most_N=float(min(max(MOST * most, self.scales.force_N), UNLIMITED_N)))


def _own_values(body: Hydraulic) -> dict[str, object]:
    """Return the values of a structure by the names of a layout's groups."""
    valve, side = body.valve, body.side
    return {
        "rise_s": valve.rise_s,
        "fall_s": valve.fall_s,
        "hysteresis_A": valve.hysteresis_A,
        "delay_ticks": valve.delay_ticks,
        "setting": valve.characteristic.values,
        "lead_s": side.lead_s,
        "viscous_Ns_m": side.viscous_Ns_m,
        "mass_kg": side.mass_kg,
        "gas_N": side.gas_N,
        "ratio": body.area_ratio,
        "compression": body.compression_m_N,
        "compression_growth": body.compression_growth_1_m,
        "rebound": body.rebound_m_N,
        "rebound_growth": body.rebound_growth_1_m,
        "mount": body.mount_m_N,
        "creep": body.creep_m_Ns,
        "fade_1_W": body.fade_1_W,
        "reservoir": body.reservoir_N,
        "air": body.air,
        "bypass": body.bypass.values if body.bypass else (),
        "narrow_N": body.bypass_laminar_N if body.bypass else (),
        "friction": [one.stiffness_N_m for one in side.friction],
        "friction_yield": [one.yield_N for one in side.friction],
        "friction_moved": [one.moved_N for one in side.friction],
        "growth": body.friction_growth_1_N,
        "closing_s": (body.piston_s, body.base_s, body.external_s),
    }


def arrays_of(body: Hydraulic, interval_s: float) -> NetworkArrays:
    """Return the kernel's view of a structure."""
    own = _own_values(body)
    names = list(own)
    parts = {name: np.atleast_1d(np.asarray(value, dtype=np.float64)).ravel() for name, value in own.items()}
    parts |= {name: np.ravel(getattr(body, name).rows) for name in EDGE_NAMES}
    cut = names.index("bypass")
    order = [*names[:cut], *EDGE_NAMES, *names[cut:]]
    first = dict(zip(order, np.cumsum([0, *(len(parts[name]) for name in order[:-1])]), strict=True))
    return NetworkArrays(
        np.concatenate([parts[name] for name in order]), np.array([first[n] for n in PLACES], dtype=np.int64),
        np.array(body.valve.characteristic.at), np.array(body.piston.at), np.array(body.side.position_m),
        np.array(body.bypass.position_m if body.bypass else ()),
        np.array([len(getattr(body, name).rows) for name in EDGE_NAMES], dtype=np.int64), len(body.side.friction),
        body.laminar_N, body.most_N, interval_s, body.side.max_acceleration_m_s2,
    )  # fmt: skip


def free_run(body: Hydraulic, interval_s: float, data: RunData) -> F:
    """Return the force (ticks,) [N] of a structure."""
    ticks = len(data.position)
    force = np.full(ticks, np.nan)
    nothing = Score(np.zeros(ticks), np.zeros(ticks), np.zeros(ticks, np.int64), 1)
    run_network(arrays_of(body, interval_s), data, nothing, force, NO_FIT, NO_FIT)
    return force


def run_model(body: Hydraulic, model: Model, inputs: F, segments: I) -> tuple[F, Mask]:
    """Return the batch run of a network, as `StructureKit.batch_run` describes it."""
    ranges = widen(model.envelope.by_signal, body.reach)
    limited = [np.ascontiguousarray(np.clip(row, *ranges[name])) for row, name in zip(inputs, INPUTS, strict=True)]
    data = RunData(limited[0], limited[1], limited[2], np.asarray(segments, np.int64))
    force = free_run(body, 1.0 / model.sampling.rate_Hz, data)
    for start, stop in segments:
        force[start:stop][np.logical_or.accumulate(~np.isfinite(force[start:stop]))] = np.nan
    low, high = model.force_envelope_N
    return np.clip(force, low, high), (force < low) | (force > high)
