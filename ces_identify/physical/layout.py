"""The parameters of a hydraulic network: a vector to fit, without bounds, and the values that a model file holds.

A fit changes `theta`: logarithms of what is positive, other numbers in units of their usual size. Each entry has a
centre, its usual value in dampers, and a weight with which its squared distance from there counts, against a squared
error of (J / 100)^2 for each recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from ces_data.arrays import F, I
from ces_identify.physical.laws import NODES, STARTS, STEP, KindStart, LawEdge, NodeEdge
from ces_identify.training import Training
from ces_observer.structures.hydraulic import NEVER_S, RELAXATIONS

CURRENTS = 6  # nodes of the valve's characteristic
POSITIONS = 5  # nodes of the gas force
BYPASS_M = 0.0025  # between nodes of the bypass
ACCELERATION_MARGIN = 1.2
YIELD_WAY = 0.05  # share of the stroke by which a yielding spring turns from one limit to the other, at most
FORCE_PERCENTILE, SPEED_PERCENTILE = 99.5, 99.9


@dataclass(frozen=True)
class DataScales:
    """What is read off the data: scales of force [N] and speed [m/s], ranges of current and position, acceleration."""

    force_N: float
    speed_m_s: float
    currents_A: F
    positions_m: F
    max_acceleration_m_s2: float
    interval_s: float
    relax_s: float


def read_scales(data: Training, rate_Hz: float, forget_s: float = 5.0) -> DataScales:
    """Return the scales of the training data, and nodes spread over the currents and positions; what is stored relaxes
    so that after `forget_s` it is gone.
    """
    position, speed, current = data.inputs
    scored = (data.estimation > 0.0) | (data.selection > 0.0)
    low, high = float(current.min()), float(current.max())
    if high - low < 1e-6 * max(1.0, abs(high)):
        low, high = low - 0.5, high + 0.5
    ends = np.percentile(position, [0.1, 99.9])
    if ends[1] - ends[0] < 1e-9:
        ends = ends + np.array([-1e-3, 1e-3])
    jumps = np.concatenate([np.abs(np.diff(speed[a:b])) for a, b in data.segments])
    return DataScales(
        float(np.percentile(np.abs(data.measured[scored]), FORCE_PERCENTILE)),
        float(np.percentile(np.abs(speed), SPEED_PERCENTILE)),
        np.linspace(low, high, CURRENTS),
        np.linspace(float(ends[0]), float(ends[1]), POSITIONS),
        ACCELERATION_MARGIN * rate_Hz * float(np.percentile(jumps, SPEED_PERCENTILE)),
        1.0 / rate_Hz,
        forget_s / RELAXATIONS,
    )


WEIGHT = 1e-4
VALVE_S, VALVE_WEIGHT = 5e-3, 3.0  # centre of the valve's lags; relative to WEIGHT
HELD_WEIGHT = 300.0  # of the valve's path where the current was held: nothing in the recordings knows it
CHAMBER_M_N, MOUNT_M_N = 2e-7, 5e-8
CLOSING_S = 1e-3
LIMIT = 60.0  # of a logarithm
LEAST_SHARE = 1e-9  # of a piece of the setting's rise, relative to the largest: less is lost in rounding


@dataclass(frozen=True)
class Group:
    """Parameters that belong together: `centre`, `weight` (n,); the values are exp(theta), or `unit` theta."""

    name: str
    centre: F
    weight: F
    unit: float | None = None

    def values(self, theta: F) -> F:
        """Return the values of the group."""
        if self.name == "setting":
            shares = np.exp(np.clip(theta, -LIMIT, LIMIT))
            shares = np.maximum(shares, LEAST_SHARE * shares.max())
            return np.append(0.0, np.cumsum(shares) / shares.sum())
        return np.exp(np.clip(theta, -LIMIT, LIMIT)) if self.unit is None else self.unit * theta

    def derivatives(self, theta: F) -> F:
        """Return their derivatives (values, n)."""
        if self.name == "setting":
            shares = np.diff(self.values(theta))
            return np.vstack([np.zeros(len(theta)), np.cumsum(np.diag(shares) - np.outer(shares, shares), axis=0)])
        return np.diag(self.values(theta)) if self.unit is None else self.unit * np.eye(len(theta))


@dataclass(frozen=True)
class Bump(Group):
    """The opening of a bypass at `nodes` (m,) [m] about a stretch of the stroke: the law from which its fit starts.

    Its parameters: logarithm of the opening within, middle [`unit` m], logarithms of half the length and of the edges.
    """

    nodes: F = field(default_factory=lambda: np.empty(0))

    def values(self, theta: F) -> F:
        """Return the openings (m,)."""
        high, middle, half, edge = theta
        beyond = (np.abs(self.nodes - (self.unit or 1.0) * middle) - np.exp(half)) / np.exp(edge)
        return np.asarray(np.exp(np.clip(high - np.logaddexp(0.0, beyond), -LIMIT, LIMIT)))

    def derivatives(self, theta: F) -> F:
        """Return their derivatives (m, 4)."""
        at = self.values(theta)
        return np.column_stack([(self.values(theta + step) - at) / STEP for step in STEP * np.eye(len(theta))])


def positive_group(name: str, centre: float | F, weight: float = 1.0) -> Group:
    """Return a group of positive numbers."""
    at = np.log(np.atleast_1d(np.asarray(centre, dtype=np.float64)))
    return Group(name, at, np.full(len(at), WEIGHT * weight))


def signed_group(name: str, unit: float, centre: float = 0.0, count: int = 1) -> Group:
    """Return a group of numbers of either sign, whose usual size is `unit`."""
    return Group(name, np.full(count, centre), np.full(count, WEIGHT), unit)


def make_groups(scales: DataScales, kind: KindStart, held: bool, bypass: Group) -> list[Group]:
    """Return the groups, those of the valve first; `held` says that the current was. Numbers have a file's names."""
    size, speed, span = scales.force_N, scales.speed_m_s, float(np.ptp(scales.currents_A))
    path = HELD_WEIGHT if held else 1.0
    least, moved, way = np.reshape(kind.friction, (-1, 3)).T
    return [
        positive_group("rise_s", VALVE_S, VALVE_WEIGHT * path),
        positive_group("fall_s", VALVE_S, VALVE_WEIGHT * path),
        positive_group("hysteresis_A", 0.01 * span, path),
        positive_group("delay_ticks", 5e-4 / scales.interval_s, path),
        Group("setting", np.zeros(len(scales.currents_A) - 1), np.full(len(scales.currents_A) - 1, WEIGHT)),
        signed_group("lead_s", 5e-4),
        positive_group("viscous_Ns_m", 0.01 * size / speed),
        positive_group("mass_kg", 0.5),
        signed_group("gas_N", 0.05 * size, count=len(scales.positions_m)),
        positive_group("area_ratio", 0.35),
        positive_group("compression_m_N", CHAMBER_M_N * kind.compression),
        signed_group("compression_growth_1_m", 10.0, -0.5),
        positive_group("rebound_m_N", CHAMBER_M_N * kind.rebound),
        signed_group("rebound_growth_1_m", 10.0, 0.5),
        positive_group("mount_m_N", MOUNT_M_N),
        positive_group("creep_m_Ns", kind.creep_m_Ns),
        positive_group("reservoir_N", 0.07 * size),
        positive_group("air", 3.0),
        bypass,
        positive_group("bypass_laminar_N", np.full(min(len(bypass.centre), 1), 0.03 * size)),
        positive_group("friction", size * (least + moved) / way),
        positive_group("friction_yield", size * least),
        positive_group("friction_moved", size * moved),
        positive_group("friction_growth_1_N", 0.1 / size),
        positive_group("closing_s", np.full(3, CLOSING_S)),
    ]


@dataclass(frozen=True)
class Layout:
    """Groups and edges in the order of theta. Edges have nodes at `flows` [m/s], and rises in units of `force_N`.

    Springs are stiffer than `stiffer_1_m` times their yield force: so they forget where they were within YIELD_WAY.
    """

    groups: tuple[Group, ...]
    edges: tuple[LawEdge | NodeEdge, ...]
    flows: F
    force_N: float
    stiffer_1_m: float

    @cached_property
    def to_nodes(self) -> F:
        """The matrix (nodes, nodes - 1) from the rises between an edge's nodes [force_N] to their drops [N]."""
        matrix, zero = np.zeros((len(self.flows), len(self.flows) - 1)), int(np.flatnonzero(self.flows == 0.0)[0])
        for j in range(len(self.flows)):
            matrix[j, zero:j] = self.force_N
            matrix[j, j:zero] = -self.force_N
        return matrix

    @cached_property
    def centre(self) -> F:
        """Usual values of the parameters, from which a fit starts."""
        return np.concatenate([*(g.centre for g in self.groups), *(e.start for e in self.edges)])

    @cached_property
    def weight(self) -> F:
        """Weights of squared distances from the centre."""
        return np.concatenate([*(g.weight for g in self.groups), *(e.weight for e in self.edges)])

    @cached_property
    def owners(self) -> list[str]:
        """The name of the group, or of the edge, of each entry of theta."""
        names = [g.name for g in self.groups for _ in g.centre]
        return names + [name for name, e in zip(EDGE_NAMES, self.edges, strict=True) for _ in e.start]

    def split(self, theta: F) -> tuple[list[F], list[F]]:
        """Return the parameters of each group, and of each edge."""
        ends = np.cumsum([len(g.centre) for g in self.groups] + [len(e.start) for e in self.edges])
        parts = np.split(theta, ends[:-1])
        return parts[: len(self.groups)], parts[len(self.groups) :]

    def values(self, theta: F) -> dict[str, F]:
        """Return the values by the names of groups and edges; those of an edge are nodes (rows, flows)."""
        own, edges = self.split(theta)
        values = {g.name: g.values(part) for g, part in zip(self.groups, own, strict=True)}
        for name, edge, part in zip(EDGE_NAMES, self.edges, edges, strict=True):
            values[name] = edge.rises(part) @ self.to_nodes.T
        values["friction"] = values["friction"] + self.stiffer_1_m * (
            values["friction_yield"] + values["friction_moved"]
        )
        return values

    def derivatives(self, theta: F) -> F:
        """Return the derivatives (values, theta) of all values, in the order of the groups and edges."""
        own, edges = self.split(theta)
        blocks = [g.derivatives(part) for g, part in zip(self.groups, own, strict=True)]
        for edge, part in zip(self.edges, edges, strict=True):
            blocks.append(np.kron(np.eye(edge.rows), self.to_nodes) @ edge.derivatives(part))
        matrix = np.asarray(block_diag(*blocks))
        stiffness, *limits = self.columns(("friction", "friction_yield", "friction_moved"))
        for m in range(self.sizes["friction"]):
            matrix[stiffness + m] += self.stiffer_1_m * sum(matrix[limit + m] for limit in limits)
        return matrix

    @cached_property
    def sizes(self) -> dict[str, int]:
        """The number of values of each group and edge."""
        edges = {name: len(self.flows) * e.rows for name, e in zip(EDGE_NAMES, self.edges, strict=True)}
        return {**{g.name: len(g.values(g.centre)) for g in self.groups}, **edges}

    @property
    def size(self) -> int:
        """The number of all values."""
        return sum(self.sizes.values())

    def columns(self, names: Sequence[str]) -> I:
        """Return the index of the first value of each named group or edge among all values."""
        first = dict(zip(self.sizes, np.cumsum([0, *self.sizes.values()]), strict=False))
        return np.array([first[name] for name in names], dtype=np.int64)


EDGE_NAMES = ("piston", "base", "external")


def first_layout(scales: DataScales, kind: str, rows: int, held: bool, bypassed: F) -> Layout:
    """Return the layout from which a fit starts: laws for the edges, and for a bypass at nodes (m,) [m] if any."""
    start = STARTS[kind]
    edges = (start.piston, start.base, start.external)
    laws = tuple(LawEdge(edge, rows if edge.moved else 1) for edge in edges)
    bypass = Group("bypass", np.empty(0), np.empty(0))
    if len(bypassed):
        span = float(np.ptp(bypassed))
        opening = np.log(0.1 * scales.speed_m_s / np.sqrt(0.25 * scales.force_N))  # a tenth of the flow at 1/4 force
        law = np.array([opening + 1.0, 0.0, np.log(0.25 * span), np.log(0.05 * span)])
        bypass = Bump("bypass", law, np.full(4, 0.1 * WEIGHT), 0.25 * span, bypassed)
    groups = make_groups(scales, start, held, bypass)
    forgets = scales.relax_s < NEVER_S  # a twin of a simulation need not
    stiffer_1_m = 2.0 / (YIELD_WAY * float(np.ptp(scales.positions_m))) if forgets else 0.0
    return Layout(tuple(groups), laws, scales.speed_m_s * NODES, scales.force_N, stiffer_1_m)


def as_floats(values: F) -> tuple[float, ...]:
    """Return an array as plain floats."""
    return tuple(map(float, values))
