"""Sums of terms over boxes of their inputs, bounded by interval arithmetic with outward rounding.

Groups of terms go in, compiled once; bounds on the sum over groups of |sum of the group's terms| come out, box by box.
A factor that many terms share is bounded once for a box. Each box is bounded by the tighter of the natural and the
centred form, which shrinks with the square of the box (Moore, Kearfott & Cloud, Introduction to Interval Analysis,
2009, ch. 5-6).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign, inf, prod

from ces_observer.model import Envelope, Factor, Term
from ces_observer.proof.intervals import Interval, down, product, up
from ces_observer.structures.constructed import Hat

Box = tuple[Interval, ...]  # a range of each variable
Row = tuple[float, tuple[int, ...]]  # coefficient and factors of a term
Slope = tuple[int, float, int, tuple[int, ...]]  # variable, coefficient, factor differentiated by it, the others
LEAST_SIZE = 1e-100  # a slope nearer to zero than that may overflow: as good as none
LEAST_SHARE = 1.0 - 1e-12  # of a value computed without outward rounding that is surely reached


class Sums:
    """The sum over groups of |sum of the group's terms|, past forces left out; `variables` are signal and lag."""

    def __init__(self, groups: Sequence[Sequence[Term]]) -> None:
        self.factors = list(dict.fromkeys(f for group in groups for term in group for f in term.inputs))
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
        """Return how many interval products, about, a box takes."""
        terms = sum(len(factors) + 1 for rows in self._groups for _, factors in rows)
        slopes = sum(len(others) + 3 for group in self._slopes for *_, others in group)
        return 2 * terms + slopes + 3 * len(self.factors)

    def root(self, envelope: Envelope) -> Box:
        """Return the whole box: the range of each variable."""
        ranges = {place: _range(envelope, f) for place, f in zip(self._places, self.factors, strict=True)}
        return tuple(ranges[place] for place in range(len(self.variables)))

    def kinks(self) -> list[list[float]]:
        """Return where a factor of each variable bends: at zero, and where memberships do."""
        found: list[set[float]] = [{0.0} for _ in self.variables]
        for place, f in zip(self._places, self.factors, strict=True):
            found[place] |= set(f.definition.kinks) if isinstance(f.definition, Hat) else set()
        return [sorted(one, key=lambda at: (at != 0.0, at)) for one in found]

    def bound(self, box: Box) -> float:
        """Return an upper bound over `box`."""
        powers = self._powers(box)
        natural = [_sum(rows, powers) for rows in self._groups]
        if all(low == high for low, high in box):
            return _total(natural)
        middle = tuple((0.5 * (low + high),) * 2 for low, high in box)
        centre = self._powers(middle)
        steep = [slope_interval(f, box[place]) for f, place in zip(self.factors, self._places, strict=True)]
        away = [
            (0.0, 0.0) if low == high else (down(low - at), up(high - at))
            for (low, high), (at, _) in zip(box, middle, strict=True)
        ]
        tight = []
        for rows, slopes, (low, high) in zip(self._groups, self._slopes, natural, strict=True):
            c_low, c_high = _centred(_sum(rows, centre), slopes, powers, steep, away)
            tight.append((max(low, c_low), min(high, c_high)))
        return _total(tight)

    def value(self, box: Box) -> float:
        """Return what is surely reached in `box`: the largest value in its middle and two corners."""
        points = ([0.5 * (low + high) for low, high in box], [low for low, _ in box], [high for _, high in box])
        return max(self._at(point) for point in points) * LEAST_SHARE

    def _at(self, point: Sequence[float]) -> float:
        powers = [_power(f, point[place]) for f, place in zip(self.factors, self._places, strict=True)]
        return sum(abs(sum(c * prod([powers[f] for f in factors]) for c, factors in rows)) for rows in self._groups)

    def _powers(self, box: Box) -> list[Interval]:
        return [power_interval(f, box[place]) for f, place in zip(self.factors, self._places, strict=True)]

    def _slopes_of(self, rows: Sequence[Row]) -> list[Slope]:
        """Return the derivatives of a group's terms, by variable."""
        slopes = [
            (self._places[f], coefficient, f, factors[:n] + factors[n + 1 :])
            for coefficient, factors in rows
            for n, f in enumerate(factors)
        ]
        return sorted(slopes, key=lambda slope: slope[0])


def power_interval(factor: Factor, at: Interval) -> Interval:
    """Return an interval that holds sign(s) |s|^p (or |s|^p) for every s in `at`; powers are rounded by two floats.

    For a hat, s is the signal it is of, and the interval holds its membership.
    """
    if isinstance(factor.definition, Hat):
        return factor.definition.interval(at)
    low, high = at
    if factor.signed:
        at_zero = 0.0**factor.power  # power 0 is a sign: at zero it may be taken as either
        lowest = copysign(abs(low) ** factor.power, low) if low else -at_zero
        highest = copysign(abs(high) ** factor.power, high) if high else at_zero
        return down(down(lowest)), up(up(highest))
    smallest = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
    largest = max(abs(low), abs(high))
    return max(0.0, down(down(smallest**factor.power))), up(up(largest**factor.power))


def slope_interval(factor: Factor, at: Interval) -> Interval | None:
    """Return an interval that holds the derivative of the factor over `at`, None if `at` nears zero (but for a hat)."""
    if isinstance(factor.definition, Hat):
        return factor.definition.slope_interval(at)
    if at[0] <= LEAST_SIZE and at[1] >= -LEAST_SIZE:
        return None
    ends = [factor.power * abs(s) ** (factor.power - 1.0) for s in at]
    low, high = down(down(down(min(ends)))), up(up(up(max(ends))))
    return (low, high) if factor.signed or at[0] > 0.0 else (-high, -low)


def _sum(rows: Sequence[Row], powers: Sequence[Interval]) -> Interval:
    """Return an interval that holds the sum of the terms: each factor's range, multiplied and added."""
    low = high = 0.0
    for coefficient, factors in rows:
        value = _multiplied((coefficient, coefficient), factors, powers)
        low, high = down(low + value[0]), up(high + value[1])
    return low, high


def _centred(
    middle: Interval,
    slopes: Sequence[Slope],
    powers: Sequence[Interval],
    steep: Sequence[Interval | None],
    away: Sequence[Interval],
) -> Interval:
    """Return an interval that holds the group's sum: its value in the `middle`, plus slopes times distances."""
    low, high = middle
    by_variable: dict[int, Interval] = {}
    for variable, coefficient, differentiated, others in slopes:
        if away[variable] == (0.0, 0.0):
            continue
        slope = steep[differentiated]
        if slope is None:
            return -inf, inf
        one = _multiplied(product((coefficient, coefficient), slope), others, powers)
        sum_low, sum_high = by_variable.get(variable, (0.0, 0.0))
        by_variable[variable] = down(sum_low + one[0]), up(sum_high + one[1])
    for variable, slope in by_variable.items():
        moved = product(slope, away[variable])
        low, high = down(low + moved[0]), up(high + moved[1])
    return low, high


def _multiplied(value: Interval, factors: Sequence[int], powers: Sequence[Interval]) -> Interval:
    for f in factors:
        value = product(value, powers[f])
    return value


def _total(groups: Sequence[Interval]) -> float:
    """Return an upper bound of the sum of absolute group sums."""
    total = 0.0
    for low, high in groups:
        total = up(total + max(abs(low), abs(high)))
    return total


def _power(factor: Factor, at: float) -> float:
    if isinstance(factor.definition, Hat):
        return factor.definition.at(at)
    size = float(abs(at) ** factor.power)
    return copysign(size, at) if factor.signed else size


def _range(envelope: Envelope, factor: Factor) -> Interval:
    """Return the range of the factor's variable."""
    definition, ranges = factor.definition, envelope.by_signal
    if isinstance(definition, Hat):
        return definition.base_range(ranges)
    return ranges[factor.signal] if definition is None else definition.range(ranges)
