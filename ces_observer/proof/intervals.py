"""Interval arithmetic with outward rounding, and the maximum of a sum of terms over a box of inputs.

The theory is that of Moore, Kearfott & Cloud, Introduction to Interval Analysis, 2009. Groups of terms go in once;
bounds on the sum over groups of |sum of the group's terms| come out for each box. Each box has the tighter bound of the
natural and the centred form, whose excess shrinks with the square of the box (ch. 5-6). Branch and bound halves boxes,
the worst first, until the bound meets an actual value. Every input may take any value in its range.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from math import inf, nextafter, prod
from typing import Any, Protocol

from ces_observer.limits import ProofLimits

Interval = tuple[float, float]


def up(value: float) -> float:
    """Return the next larger float: rounding outward."""
    return nextafter(value, inf)


def down(value: float) -> float:
    """Return the next smaller float: rounding outward."""
    return nextafter(value, -inf)


def product(left: Interval, right: Interval) -> Interval:
    """Return an interval that holds every product of a number of `one` and a number of `two`."""
    a, b, c, d = left[0] * right[0], left[0] * right[1], left[1] * right[0], left[1] * right[1]
    return down(min(a, b, c, d)), up(max(a, b, c, d))


def add(left: Interval, right: Interval) -> Interval:
    """Return an interval that holds every sum of a number of `one` and a number of `two`."""
    return down(left[0] + right[0]), up(left[1] + right[1])


def largest(interval: Interval) -> float:
    """Return the largest magnitude in an interval."""
    return max(abs(interval[0]), abs(interval[1]))


Box = tuple[Interval, ...]  # a range of each variable
Row = tuple[float, tuple[int, ...]]  # coefficient and factors of a term
Slope = tuple[int, float, int, tuple[int, ...]]  # variable, coefficient, factor differentiated by it, the others
MIN_SHARE = 1.0 - 1e-12  # of a value computed without outward rounding that is certainly reached


class BoundedFactor(Protocol):
    """A function of one variable, with its bounds; equal ones have equal hashes and are bounded once."""

    @property
    def variable(self) -> tuple[str, int]:
        """The variable: a signal and its lag."""

    @property
    def kinks(self) -> tuple[float, ...]:
        """The values, besides zero, at which its slope jumps."""

    def at(self, value: float) -> float:
        """Return the factor at `value` of its variable."""

    def variable_range(self, ranges: Mapping[str, Interval]) -> Interval:
        """Return the range of the variable from those of the inputs."""

    def interval(self, at: Interval) -> Interval:
        """Return an interval that holds the factor for every value of the variable in `at`."""

    def slope_interval(self, at: Interval) -> Interval | None:
        """Return an interval that holds the derivative over `at`, None if there is no bound."""


class Product(Protocol):
    """A coefficient times factors; its past force, if any, is left out of `inputs`."""

    @property
    def coefficient(self) -> float:
        """The coefficient."""

    @property
    def inputs(self) -> tuple[Any, ...]:
        """The factors, each a BoundedFactor."""


class Sums:
    """The sum over groups of |sum of the group's terms|, past forces left out; `variables` are signal and lag."""

    def __init__(self, groups: Sequence[Sequence[Product]]) -> None:
        self.factors: list[BoundedFactor] = list(
            dict.fromkeys(f for group in groups for term in group for f in term.inputs)
        )
        self.variables = sorted({f.variable for f in self.factors})
        place = {variable: i for i, variable in enumerate(self.variables)}
        at = {f: i for i, f in enumerate(self.factors)}
        self._places = [place[f.variable] for f in self.factors]
        self._groups: list[list[Row]] = [
            [(term.coefficient, tuple(at[f] for f in term.inputs)) for term in group] for group in groups
        ]
        self._slopes = [self._slopes_of(rows) for rows in self._groups]

    @property
    def work(self) -> int:
        """The approximate number of interval products per box."""
        terms = sum(len(factors) + 1 for rows in self._groups for _, factors in rows)
        slopes = sum(len(others) + 3 for group in self._slopes for *_, others in group)
        return 2 * terms + slopes + 3 * len(self.factors)

    def root(self, ranges: Mapping[str, Interval]) -> Box:
        """Return the whole box: the range of each variable, from those of the inputs."""
        sides = {place: f.variable_range(ranges) for place, f in zip(self._places, self.factors, strict=True)}
        return tuple(sides[place] for place in range(len(self.variables)))

    def kinks(self) -> list[list[float]]:
        """Return for each variable the values at which a factor's slope jumps, zero first."""
        kinks: list[set[float]] = [{0.0} for _ in self.variables]
        for place, f in zip(self._places, self.factors, strict=True):
            kinks[place] |= set(f.kinks)
        return [sorted(values, key=lambda at: (at != 0.0, at)) for values in kinks]

    def bound(self, box: Box) -> float:
        """Return an upper bound over `box`."""
        powers = self._powers(box)
        natural = [_sum(rows, powers) for rows in self._groups]
        if all(low == high for low, high in box):
            return _total(natural)
        middle = tuple((0.5 * (low + high),) * 2 for low, high in box)
        centre = self._powers(middle)
        steep = [f.slope_interval(box[place]) for f, place in zip(self.factors, self._places, strict=True)]
        away = [
            (0.0, 0.0) if low == high else (down(low - at), up(high - at))
            for (low, high), (at, _) in zip(box, middle, strict=True)
        ]
        tight = []
        for rows, slopes, (low, high) in zip(self._groups, self._slopes, natural, strict=True):
            c_low, c_high = _centred_form(_sum(rows, centre), slopes, powers, steep, away)
            tight.append((max(low, c_low), min(high, c_high)))
        return _total(tight)

    def value(self, box: Box) -> float:
        """Return a value certainly reached in `box`: the largest of its middle and two corners."""
        points = ([0.5 * (low + high) for low, high in box], [low for low, _ in box], [high for _, high in box])
        return max(self._at(point) for point in points) * MIN_SHARE

    def _at(self, point: Sequence[float]) -> float:
        powers = [f.at(point[place]) for f, place in zip(self.factors, self._places, strict=True)]
        return sum(abs(sum(c * prod([powers[f] for f in factors]) for c, factors in rows)) for rows in self._groups)

    def _powers(self, box: Box) -> list[Interval]:
        return [f.interval(box[place]) for f, place in zip(self.factors, self._places, strict=True)]

    def _slopes_of(self, rows: Sequence[Row]) -> list[Slope]:
        """Return the derivatives of a group's terms, by variable."""
        slopes = [
            (self._places[f], coefficient, f, factors[:n] + factors[n + 1 :])
            for coefficient, factors in rows
            for n, f in enumerate(factors)
        ]
        return sorted(slopes, key=lambda slope: slope[0])


def _sum(rows: Sequence[Row], powers: Sequence[Interval]) -> Interval:
    """Return the natural form: an interval that holds the sum of the terms."""
    low = high = 0.0
    for coefficient, factors in rows:
        value = _multiply((coefficient, coefficient), factors, powers)
        low, high = down(low + value[0]), up(high + value[1])
    return low, high


def _centred_form(
    middle: Interval,
    slopes: Sequence[Slope],
    powers: Sequence[Interval],
    steep: Sequence[Interval | None],
    away: Sequence[Interval],
) -> Interval:
    """Return the centred form: the value in the `middle` plus slopes times distances."""
    low, high = middle
    by_variable: dict[int, Interval] = {}
    for variable, coefficient, differentiated, others in slopes:
        if away[variable] == (0.0, 0.0):
            continue
        slope = steep[differentiated]
        if slope is None:
            return -inf, inf
        part = _multiply(product((coefficient, coefficient), slope), others, powers)
        sum_low, sum_high = by_variable.get(variable, (0.0, 0.0))
        by_variable[variable] = down(sum_low + part[0]), up(sum_high + part[1])
    for variable, slope in by_variable.items():
        moved = product(slope, away[variable])
        low, high = down(low + moved[0]), up(high + moved[1])
    return low, high


def _multiply(value: Interval, factors: Sequence[int], powers: Sequence[Interval]) -> Interval:
    for f in factors:
        value = product(value, powers[f])
    return value


def _total(groups: Sequence[Interval]) -> float:
    """Return an upper bound of the sum of absolute group sums."""
    total = 0.0
    for low, high in groups:
        total = up(total + max(abs(low), abs(high)))
    return total


GAIN_GAP = 0.002  # relative distance of bound and actual value at which halving stops


def bound_maximum(
    groups: Sequence[Sequence[Product]],
    ranges: Mapping[str, Interval],
    enough: float = 0.0,
    gap: float = GAIN_GAP,
    max_boxes: int = ProofLimits.MAX_BOXES,
) -> tuple[float, int]:
    """Return an upper bound on the maximum over the `ranges` of the sum over groups of |sum of the group's terms|.

    Past forces in the terms are left out. The second number is the count of boxes. The search ends early at a bound of
    at most `enough`, at an actual value above `enough` unless that is zero, and at ProofLimits.MAX_WORK.
    """
    sums = Sums(groups)
    root, kinks = sums.root(ranges), sums.kinks()
    heap = [(-sums.bound(root), 0, root)]
    reached = sums.value(root)
    count, max_boxes = 1, min(max_boxes, ProofLimits.MAX_WORK // max(sums.work, 1))
    while True:
        bound, _, box = heap[0]
        decided = -bound <= enough or (enough and reached > enough)
        if decided or -bound <= reached + gap * max(abs(reached), 1e-3) or count >= max_boxes or not box:
            return -bound, count
        heapq.heappop(heap)
        for half in _split_box(box, root, kinks):
            value = min(sums.bound(half), -bound)
            reached = max(reached, sums.value(half))
            heapq.heappush(heap, (-value, count, half))
            count += 1


def _split_box(box: Box, root: Box, kinks: Sequence[Sequence[float]]) -> tuple[Box, Box]:
    """Return `box` cut in two across its widest side relative to `root`, at one of the side's `kinks` if any."""
    shares = [(high - low) / max(r[1] - r[0], 1e-300) for (low, high), r in zip(box, root, strict=True)]
    side = shares.index(max(shares))
    low, high = box[side]
    cut = next((at for at in kinks[side] if low < at < high), 0.5 * (low + high))
    return (*box[:side], (low, cut), *box[side + 1 :]), (*box[:side], (cut, high), *box[side + 1 :])
