"""The layout of a physical model's parameters: named groups in, one vector to fit and one for the kernels out.

A fit changes `theta`, whose entries have bounds; the kernels take `k` = matrix theta + offset. Increasing curves are
fitted by the rises between their nodes, which have a lower bound, so that every `theta` within its bounds is a valid
model.

All physical models share the parameters of valve path and side forces, with starts read off the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from ces_data.arrays import F, I
from ces_identify.trained.training import Training
from ces_observer.structures.curves import IncreasingCurve
from ces_observer.structures.physical import FrictionElement, PhysicalStructure, SideForces, ValvePath

MIN_SCALE = 0.3  # of a group's mean magnitude: least scale of an entry in the penalty


@dataclass(frozen=True)
class Group:
    """A group of parameters: `start`, `low`, `high` (n,), and `matrix` (m, n), `offset` (m,) that give its part of k.

    `scale` (n,) is the change of an entry that the penalty counts as one; the entries sum to at most `max_sum`.
    """

    name: str
    start: F
    low: F
    high: F
    matrix: F
    offset: F
    scale: F
    max_sum: float = np.inf


def group(
    name: str,
    start: float | Sequence[float] | F,
    low: float | F = 0.0,
    high: float | F = np.inf,
    matrix: F | None = None,
    offset: F | None = None,
    scale: float | None = None,
    max_sum: float = np.inf,
) -> Group:
    """Return a group; by default its parameters are its part of k, and the scale is the start's magnitude."""
    at = np.atleast_1d(np.asarray(start, dtype=np.float64))
    matrix = np.eye(len(at)) if matrix is None else matrix
    sizes = np.maximum(np.abs(at), MIN_SCALE * np.abs(at).mean()) if scale is None else np.full(len(at), scale)
    return Group(
        name,
        at,
        np.broadcast_to(np.asarray(low, dtype=np.float64), at.shape),
        np.broadcast_to(np.asarray(high, dtype=np.float64), at.shape),
        matrix,
        np.zeros(matrix.shape[0]) if offset is None else offset,
        sizes,
        max_sum,
    )


def rises_to_nodes(nodes: int, zero: int) -> F:
    """Return the matrix (nodes, nodes - 1) from rises between nodes to values; node `zero` has the value 0."""
    matrix = np.zeros((nodes, nodes - 1))
    for j in range(nodes):
        if j > zero:
            matrix[j, zero:j] = 1.0
        else:
            matrix[j, j:zero] = -1.0
    return matrix


@dataclass(frozen=True)
class Layout:
    """Groups in the order of the kernels' vector."""

    groups: tuple[Group, ...]

    @cached_property
    def start(self) -> F:
        """Parameters from which a fit starts."""
        return np.concatenate([g.start for g in self.groups])

    @cached_property
    def low(self) -> F:
        """Lower bounds."""
        return np.concatenate([g.low for g in self.groups])

    @cached_property
    def high(self) -> F:
        """Upper bounds."""
        return np.concatenate([g.high for g in self.groups])

    @cached_property
    def scale(self) -> F:
        """Changes that the penalty counts as one."""
        return np.concatenate([g.scale for g in self.groups])

    @cached_property
    def matrix(self) -> F:
        """The matrix (k, theta)."""
        return np.asarray(block_diag(*(g.matrix for g in self.groups)))

    @cached_property
    def offset(self) -> F:
        """The offset (k,)."""
        return np.concatenate([g.offset for g in self.groups])

    def k(self, theta: F) -> F:
        """Return the kernels' vector."""
        return np.asarray(self.matrix @ theta + self.offset)

    def places(self, names: Sequence[str]) -> I:
        """Return the index in k of the first parameter of each named group."""
        sizes = [len(g.offset) for g in self.groups]
        first = dict(zip((g.name for g in self.groups), np.cumsum([0, *sizes[:-1]]), strict=True))
        return np.array([first[name] for name in names], dtype=np.int64)

    def part(self, k: F, name: str) -> F:
        """Return the part of the kernels' vector (or of rows of it) that belongs to a group."""
        first = int(self.places([name])[0])
        size = next(len(g.offset) for g in self.groups if g.name == name)
        return k[..., first : first + size]

    @staticmethod
    def penalty_weight(penalty: float) -> float:
        """Return the weight of the squared change of a parameter, in its scale, for a penalty [J %]."""
        return (0.01 * penalty) ** 2

    def perturbed(self, random: np.random.Generator, spread: float) -> F:
        """Return a start whose entries are scaled log-normally, within the bounds."""
        factors = [np.full(len(g.start), np.exp(spread * random.standard_normal())) for g in self.groups]
        return self.project(self.start * np.concatenate(factors))

    def project(self, theta: F) -> F:
        """Return the parameters moved into their bounds."""
        inside = np.clip(theta, self.low, self.high)
        first = 0
        for g in self.groups:
            part = inside[first : first + len(g.start)]
            if part.sum() > g.max_sum:
                part *= g.max_sum / part.sum()
            first += len(g.start)
        return inside


CURRENTS = 6  # nodes of the valve's characteristic
POSITIONS = 5  # nodes of the gas force
LAG_S, MAX_LAG_S = 6e-3, 0.2
DELAY_S, MAX_DELAY_S = 5e-4, 0.02
LOOP, MAX_LOOP = 0.01, 0.2  # half width of the magnetic loop, relative to the range of currents
MAX_LEAD_S = 3e-3
MASS_KG, MAX_MASS_KG = 0.5, 20.0
ACCELERATION_MARGIN = 1.2
MIN_RISE = 1e-3  # of a curve between nodes, relative to that of a straight line from end to end
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


def read_scales(data: Training, rate_Hz: float) -> DataScales:
    """Return the scales of the training data, and nodes spread over the currents and positions."""
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
    )


def scales_of(body: PhysicalStructure, force_N: float, speed_m_s: float, interval_s: float) -> DataScales:
    """Return the scales and nodes with which a fit made `body`."""
    currents, positions = np.array(body.valve.characteristic.at), np.array(body.side.position_m)
    return DataScales(force_N, speed_m_s, currents, positions, body.side.max_acceleration_m_s2, interval_s)


def valve_groups(scales: DataScales) -> list[Group]:
    """Return lags, loop, delay [ticks] and characteristic, in the order that the kernels expect."""
    span = float(np.ptp(scales.currents_A))
    nodes = len(scales.currents_A)
    rises = np.vstack([rises_to_nodes(nodes - 1, 0), np.zeros((1, nodes - 2))])
    even = np.full(nodes - 2, 1.0 / (nodes - 1))
    return [
        group("rise_s", LAG_S, 0.0, MAX_LAG_S),
        group("fall_s", LAG_S, 0.0, MAX_LAG_S),
        group("hysteresis_A", LOOP * span, 0.0, MAX_LOOP * span),
        group("delay_ticks", DELAY_S / scales.interval_s, 0.0, MAX_DELAY_S / scales.interval_s),
        group("setting", even, MIN_RISE, 1.0, rises, np.append(np.zeros(nodes - 1), 1.0),
              max_sum=1.0 - MIN_RISE),
    ]  # fmt: skip


def side_groups(scales: DataScales) -> list[Group]:
    """Return lead, viscous and inertia forces, and the gas force over the stroke."""
    size = scales.force_N
    viscous = 0.01 * size / scales.speed_m_s
    return [
        group("lead_s", 0.0, -MAX_LEAD_S, MAX_LEAD_S, scale=5e-4),
        group("viscous_Ns_m", viscous, 0.0, 100.0 * viscous),
        group("mass_kg", MASS_KG, 0.0, MAX_MASS_KG),
        group("gas_N", np.zeros(POSITIONS), -5.0 * size, 5.0 * size, scale=0.05 * size),
    ]


def build_valve(scales: DataScales, values: dict[str, F]) -> ValvePath:
    """Return the valve path."""
    characteristic = IncreasingCurve(as_floats(scales.currents_A), as_floats(values["setting"]))
    numbers = (float(values[name][0]) for name in ("delay_ticks", "hysteresis_A", "rise_s", "fall_s"))
    return ValvePath(characteristic, *numbers)


def build_side(scales: DataScales, values: dict[str, F], friction: tuple[FrictionElement, ...] = ()) -> SideForces:
    """Return the side forces."""
    lead_s, viscous_Ns_m, mass_kg = (float(values[name][0]) for name in ("lead_s", "viscous_Ns_m", "mass_kg"))
    gas = as_floats(scales.positions_m), as_floats(values["gas_N"])
    return SideForces(lead_s, scales.max_acceleration_m_s2, viscous_Ns_m, mass_kg, *gas, friction)


def shared_parameters(valve: ValvePath, side: SideForces) -> F:
    """Return the kernels' first parameters: those of `valve_groups` and `side_groups`, in this order."""
    path = [valve.rise_s, valve.fall_s, valve.hysteresis_A, valve.delay_ticks, *valve.characteristic.values]
    return np.array([*path, side.lead_s, side.viscous_Ns_m, side.mass_kg, *side.gas_N])


def as_floats(values: F) -> tuple[float, ...]:
    """Return an array as plain floats."""
    return tuple(map(float, values))
