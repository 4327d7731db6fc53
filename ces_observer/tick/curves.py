"""Piecewise-linear curves: their nodes stand in one table of p and rise, their values in another of the same length.

Beyond both ends the outer pieces go on straight.
"""

from ces_observer.tick.arrays import Floats
from ces_observer.tick.model import lies_within

MIN_RISE = 1e-12  # between nodes, relative to the largest: less is lost in the rounding of a blend of two curves


def interpolate(p: Floats, at: int, values: int, nodes: int, x: float) -> float:
    """Return the value at x of the curve through `nodes` nodes; a node belongs to the piece on its right."""
    j = 0
    while j < nodes - 2 and x >= p[at + j + 1]:
        j += 1
    value = p[values + j]
    return value + (p[values + j + 1] - value) * ((x - p[at + j]) / (p[at + j + 1] - p[at + j]))


def find_on_line(p: Floats, at: int, values: int, nodes: int, x: float) -> float:
    """Return the value at x by the slope of its piece; a node belongs to the piece on its left."""
    j = 0
    while j < nodes - 2 and x > p[at + j + 1]:
        j += 1
    value = p[values + j]
    node = p[at + j]
    return value + (p[values + j + 1] - value) / (p[at + j + 1] - node) * (x - node)


def is_curve(p: Floats, at: int, values: int, nodes: int, first: int, numbers: int) -> bool:
    """Return whether both tables of a curve lie behind the named places of p, which end at `first`, and nodes rise."""
    return (
        lies_within(at, nodes, first, numbers)
        and lies_within(values, nodes, first, numbers)
        and is_rising(p, at, nodes)
    )


def is_rising(p: Floats, at: int, nodes: int) -> bool:
    """Return whether at least two nodes rise by more than rounding errors."""
    largest = 0.0
    for j in range(nodes):
        size = abs(p[at + j])
        largest = size if size > largest else largest
    for j in range(nodes - 1):
        if not p[at + j + 1] - p[at + j] > MIN_RISE * largest:
            return False
    return nodes >= 2
