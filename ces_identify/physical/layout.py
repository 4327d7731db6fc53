"""The layout of a physical model's parameters: named groups in, one vector to fit and one for the kernels out.

A fit changes `theta`, whose entries have bounds; the kernels take `k` = matrix theta + offset. Increasing curves are
fitted by the rises between their nodes, which have a lower bound, so that every `theta` within its bounds is a valid
model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from ces_identify.numerics.arrays import F, I

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
