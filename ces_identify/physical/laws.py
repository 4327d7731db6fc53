"""The law of a valve, from which a fit of its curve starts: a bleed beside a disc that opens, in series with a port.

For each direction of flow, with all forces on the rod side's area [N] and flows as speeds of it [m/s], at a setting s:

    drop = inner + port q^2,    q = bleed + disc
    inner = linear bleed + quadratic e^(by_setting s) bleed^2
    disc  = opening width ln( (1 + e^((inner - preload e^(rise s)) / width)) / (1 + e^(-preload e^(rise s) / width)) )
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander

from ces_data.arrays import F

LOGARITHMIC = np.array([True, True, False, True, False, True, True, True])  # numbers of a law, as in `side_rises`
# Flows of one direction, relative to the largest speed.
SIDE = np.array([0.003, 0.007, 0.014, 0.025, 0.042, 0.068, 0.105, 0.16, 0.24, 0.35, 0.5, 0.72, 1.05])
NODES = np.concatenate([-SIDE[::-1], [0.0], SIDE])
BISECTIONS = 50
STEP = 1e-6
LEAST_RISE, MOST_CHANGE = 1e-5, 8.0  # the latter as a logarithm
LAW_WEIGHT, NODE_WEIGHT = 3e-5, 1e-5  # of squared parameters, against a squared error of (J / 100)^2 a recording
# Laws, in units of the largest force and speed: easy, shut, moved by the current, at the foot, for a thick fluid.
EASY = (0.02, 0.05, 0.0, 0.01, 0.0, 8.0, 0.02, 0.05)
SHUT = (8.0, 8.0, 0.0, 1.0, 0.0, 0.3, 0.15, 0.05)  # opens within reach: a valve shut for good would never be found open
MOVED = (0.8, 1.0, 0.5, 0.12, 1.2, 2.0, 0.05, 0.15)
FOOT = (0.5, 0.5, 0.0, 0.05, 0.0, 3.0, 0.05, 0.3)
THICK = (1.0, 0.5, 0.3, 0.3, 0.5, 3.0, 0.1, 0.1)
# Springs that yield: force at the lowest current, and what the highest adds, relative to the largest force; way [m].
RUB = ((0.006, 0.006, 6e-5), (0.012, 0.012, 2e-4), (0.025, 0.025, 8e-4))  # seals
PLUG = ((0.02, 0.1, 2e-4), (0.03, 0.2, 5e-4), (0.02, 0.1, 1.5e-3))  # a fluid that yields


@dataclass(frozen=True)
class EdgeStart:
    """Where the fit of an edge starts: laws for flows onward and back, and whether the current moves it."""

    onward: tuple[float, ...]
    back: tuple[float, ...]
    moved: bool = False


@dataclass(frozen=True)
class KindStart:
    """Where the fit of a kind of damper starts: its edges, and compliances relative to the chambers' usual one."""

    piston: EdgeStart
    base: EdgeStart
    external: EdgeStart
    compression: float = 1.0
    rebound: float = 1.0
    friction: tuple[tuple[float, float, float], ...] = RUB
    creep_m_Ns: float = 1e-7

    @property
    def closed(self) -> bool:
        """Whether no valve leads to the reservoir: without a leak, what both chambers store would stay for ever."""
        return {(edge.onward, edge.back) for edge in (self.base, self.external)} == {(SHUT, SHUT)}


STARTS = {
    "uniflow": KindStart(EdgeStart(EASY, SHUT), EdgeStart(SHUT, EASY), EdgeStart(MOVED, EASY, moved=True)),
    "twin tube": KindStart(EdgeStart(MOVED, MOVED, moved=True), EdgeStart(FOOT, EASY), EdgeStart(SHUT, SHUT)),
    "monotube": KindStart(
        EdgeStart(MOVED, MOVED, moved=True), EdgeStart(SHUT, SHUT), EdgeStart(SHUT, SHUT), compression=100.0
    ),
    "magneto-rheological": KindStart(
        EdgeStart(THICK, THICK, moved=True),
        EdgeStart(FOOT, EASY),
        EdgeStart(SHUT, SHUT),
        friction=PLUG,
        creep_m_Ns=1e-5,
    ),
}


def pack(start: EdgeStart) -> F:
    """Return the parameters (16,) of an edge: logarithms of what is positive."""
    laws = np.array([start.onward, start.back])
    logs = np.log(np.where(LOGARITHMIC, laws, 1.0))
    return np.where(LOGARITHMIC, logs, laws).ravel()


def side_rises(laws: F, rows: int) -> F:
    """Return the rises (laws, rows, 13) of the drops from node to node in one direction, for packed laws (laws, 8).

    They are in units of the largest force, and found by bisection of the inner drop.
    """
    settings = (np.arange(rows) / max(rows - 1, 1))[:, None]
    numbers = np.where(LOGARITHMIC, np.exp(np.where(LOGARITHMIC, laws, 0.0)), laws)
    linear, quadratic, by_setting, preload, rise, opening, width, port = numbers.T[:, :, None, None]
    quadratic = quadratic * np.exp(by_setting * settings)
    preload = preload * np.exp(rise * settings)
    low = np.zeros((len(laws), rows, len(SIDE)))
    high = linear * SIDE + quadratic * SIDE**2
    closed = np.logaddexp(0.0, -preload / width)
    for _ in range(BISECTIONS):
        inner = 0.5 * (low + high)
        bleed = 2.0 * inner / (linear + np.sqrt(linear**2 + 4.0 * quadratic * inner))
        flow = bleed + opening * width * (np.logaddexp(0.0, (inner - preload) / width) - closed)
        low, high = np.where(flow < SIDE, inner, low), np.where(flow < SIDE, high, inner)
    return np.diff(high + port * SIDE**2, prepend=0.0, axis=2)


class LawEdge:
    """An edge fitted by its laws: 16 parameters for all of its curves."""

    def __init__(self, start: EdgeStart, rows: int) -> None:
        self.rows, self.start = rows, pack(start)
        self.weight = np.full(16, LAW_WEIGHT)

    def rises(self, values: F) -> F:
        """Return the rises (rows, 26) between nodes for parameters (16,), in units of the largest force."""
        onward, back = side_rises(values.reshape(2, 8), self.rows)
        return np.hstack([back[:, ::-1], onward])

    def derivatives(self, values: F) -> F:
        """Return the derivatives (rows * 26, 16) of the rises, by differences."""
        derivatives, width = np.zeros((self.rows, 2 * len(SIDE), 16)), len(SIDE)
        for part, law in enumerate(values.reshape(2, 8)):
            at, *moved = side_rises(law + STEP * np.vstack([np.zeros(8), np.eye(8)]), self.rows)
            changes = (np.stack(moved, axis=2) - at[:, :, None]) / STEP
            nodes = slice(width - 1, None, -1) if part else slice(width, None)
            derivatives[:, nodes, 8 * part : 8 * part + 8] = changes
        return derivatives.reshape(-1, 16)


class NodeEdge:
    """An edge fitted by the rises between its nodes: the logarithms of how much larger they are than in `base`.

    These are free in each row, or polynomials over the rows of a `degree`, where few currents were recorded.
    """

    def __init__(self, base: F, degree: int | None = None) -> None:
        self.rows, self._base = len(base), np.maximum(base, LEAST_RISE)
        few = degree is not None and self.rows > degree + 1
        settings = np.linspace(-1.0, 1.0, self.rows)
        self._shapes: F = np.asarray(legvander(settings, degree or 0), np.float64) if few else np.eye(self.rows)
        self.start = np.zeros(self._shapes.shape[1] * base.shape[1])
        self.weight = np.full(len(self.start), NODE_WEIGHT)

    def rises(self, values: F) -> F:
        """Return the rises (rows, 26) between nodes for parameters (shapes * 26,)."""
        larger = self._shapes @ values.reshape(self._shapes.shape[1], -1)
        return np.asarray(self._base * np.exp(np.clip(larger, -MOST_CHANGE, MOST_CHANGE)))

    def derivatives(self, values: F) -> F:
        """Return the derivatives (rows * 26, shapes * 26) of the rises."""
        return np.asarray(self.rises(values).reshape(-1, 1) * np.kron(self._shapes, np.eye(self._base.shape[1])))
