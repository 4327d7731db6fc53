"""A proof that a polynomial NARX cannot lose stability: its own past counts for less than one, for every input.

The terms are affine in past forces, so the free run is y(k) = sum_j a_j(u) y(k - j) + b(u), with u the inputs now and
before, each clamped to the envelope. If sum_j |a_j(u)| <= g < 1 for every u in the envelope, the recursion is a
contraction: two runs from different pasts approach each other as g^(k / longest output lag), and from a past of zeros
|y| <= max |b| / (1 - g) for ever. Both maxima are bounded by interval arithmetic with outward rounding (Moore, Kearfott
& Cloud, Introduction to Interval Analysis, 2009, ch. 5-6): boxes of inputs are halved, the worst first, until bound
and an actual value meet. Each box is bounded by the tighter of the natural
and the centred form, which shrinks with the square of the box. Nothing is sampled; every lagged input is free to be
anything in its range.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import copysign, inf

from ces_observer import fuzzy_bounds, network_bounds
from ces_observer.intervals import Interval, down, product, up
from ces_observer.model import Envelope, Factor, Model, Term

MOST_BOXES = 40_000
GAIN_GAP = 0.002  # relative distance of bound and actual value at which halving stops
DRIVE_GAP, DRIVE_BOXES = 0.05, 4_000  # the drive has many inputs and need not be tight
CLAIM = "sum |a_j(u)| <= gain < 1 and |b(u)| <= drive_N for every input in the input envelope"
METHOD = "interval branch and bound, outward rounding"

Variable = tuple[str, int]  # signal, lag
Box = tuple[Interval, ...]


@dataclass(frozen=True)
class Certificate:
    """Proved bounds: `gain` on sum |a_j|, `drive_N` on |b|, and with gain < 1 `force_N` on |y|."""

    gain: float
    drive_N: float
    boxes: int
    claim: str = CLAIM
    method: str = METHOD

    @property
    def holds(self) -> bool:
        """True if the model is a contraction."""
        return self.gain < 1.0

    @property
    def force_N(self) -> float:
        """Bound on the force [N], infinite without a contraction."""
        return up(self.drive_N / (1.0 - self.gain)) if self.holds else inf

    def to_mapping(self) -> dict[str, object]:
        """Return what the model file keeps of the proof."""
        return {
            "claim": self.claim,
            "method": self.method,
            "gain": self.gain,
            "drive_N": self.drive_N,
            "force_bound_N": self.force_N,
            "boxes": self.boxes,
        }


def certify(model: Model) -> Certificate:
    """Return the proved bounds of `model`; they may be loose (never wrong) if the boxes run out.

    Networks and neuro-fuzzy models have their own proofs: `network_bounds`, `fuzzy_bounds`.
    """
    if model.network is not None:
        return Certificate(
            *network_bounds.bounds(model.network, model.envelope.by_signal),
            1,
            network_bounds.CLAIM,
            network_bounds.METHOD,
        )
    if model.fuzzy is not None:
        return Certificate(
            *fuzzy_bounds.bounds(model.fuzzy, model.envelope.by_signal), 1, fuzzy_bounds.CLAIM, fuzzy_bounds.METHOD
        )
    gain, boxes = maximum(_by_output_lag(model), model.envelope)
    inputs_alone = [term for term in model.terms if not term.output_lag]
    drive, more = maximum([inputs_alone], model.envelope, gap=DRIVE_GAP, most_boxes=DRIVE_BOXES)
    return Certificate(gain, drive, boxes + more)


def is_contraction(model: Model) -> bool:
    """Prove anew, and no more than needed, that past forces count for less than one: what a vehicle asks of a model."""
    if model.structure != "polynomial_narx":
        return certify(model).holds
    return maximum(_by_output_lag(model), model.envelope, enough=down(1.0))[0] < 1.0


def _by_output_lag(model: Model) -> list[list[Term]]:
    lags = sorted({term.output_lag for term in model.terms if term.output_lag})
    return [[term for term in model.terms if term.output_lag == lag] for lag in lags]


def maximum(
    groups: Sequence[Sequence[Term]],
    envelope: Envelope,
    enough: float = 0.0,
    gap: float = GAIN_GAP,
    most_boxes: int = MOST_BOXES,
) -> tuple[float, int]:
    """Return an upper bound on the maximum over the envelope of the sum over groups of |sum of the group's terms|.

    Past forces in the terms are left out. The second number is how many boxes it took. A bound of at most `enough`, or
    an actual value above it where it is not zero, ends the search early.
    """
    variables = sorted({(f.signal, f.lag) for group in groups for term in group for f in term.inputs})
    place = {variable: i for i, variable in enumerate(variables)}
    root: Box = tuple(_range(envelope, signal) for signal, _ in variables)
    heap = [(-_bound(groups, root, place), 0, root)]
    reached = _bound(groups, _middle(root), place)
    count = 1
    while True:
        bound, _, box = heap[0]
        settled = -bound <= enough or (enough and reached > enough)
        if settled or -bound <= reached + gap * max(abs(reached), 1e-3) or count >= most_boxes or not box:
            return -bound, count
        heapq.heappop(heap)
        for half in _halves(box, root):
            value = min(_bound(groups, half, place), -bound)
            reached = max(reached, _value(groups, half, place))
            heapq.heappush(heap, (-value, count, half))
            count += 1


def power_interval(factor: Factor, at: Interval) -> Interval:
    """Return an interval that holds sign(s) |s|^p (or |s|^p) for every s in `at`; powers are rounded by two floats."""
    low, high = at
    if factor.signed:
        at_zero = 0.0**factor.power  # power 0 is a sign: at zero it may be taken as either
        lowest = copysign(abs(low) ** factor.power, low) if low else -at_zero
        highest = copysign(abs(high) ** factor.power, high) if high else at_zero
        return down(down(lowest)), up(up(highest))
    smallest = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
    largest = max(abs(low), abs(high))
    return max(0.0, down(down(smallest**factor.power))), up(up(largest**factor.power))


def _bound(groups: Sequence[Sequence[Term]], box: Box, place: Mapping[Variable, int]) -> float:
    """Return an upper bound of the sum of absolute group sums over `box`."""
    total = 0.0
    for group in groups:
        low, high = _natural(group, box, place)
        if any(a < b for a, b in box):
            c_low, c_high = _centred(group, box, place)
            low, high = max(low, c_low), min(high, c_high)
        total = up(total + max(abs(low), abs(high)))
    return total


def _natural(group: Sequence[Term], box: Box, place: Mapping[Variable, int]) -> Interval:
    """Return an interval that holds the group's sum: each factor's range, multiplied and added."""
    low = high = 0.0
    for term in group:
        value = (term.coefficient, term.coefficient)
        for f in term.inputs:
            value = product(value, power_interval(f, box[place[(f.signal, f.lag)]]))
        low, high = down(low + value[0]), up(high + value[1])
    return low, high


def _centred(group: Sequence[Term], box: Box, place: Mapping[Variable, int]) -> Interval:
    """Return an interval that holds the group's sum: its value in the middle, plus slopes times distances."""
    middle = _middle(box)
    low, high = _natural(group, middle, place)
    for i, (a, b) in enumerate(box):
        if a == b:
            continue
        slope = _slope(group, box, place, i)
        if slope is None:
            return -inf, inf
        moved = product(slope, (down(a - middle[i][0]), up(b - middle[i][0])))
        low, high = down(low + moved[0]), up(high + moved[1])
    return low, high


def _slope(group: Sequence[Term], box: Box, place: Mapping[Variable, int], i: int) -> Interval | None:
    """Return an interval that holds the group's derivative by variable `i`, None where it may be unbounded."""
    low = high = 0.0
    for term in group:
        for n, differentiated in enumerate(term.inputs):
            if place[(differentiated.signal, differentiated.lag)] != i:
                continue
            steep = slope_interval(differentiated, box[i])
            if steep is None:
                return None
            value = product((term.coefficient, term.coefficient), steep)
            for m, f in enumerate(term.inputs):
                if m != n:
                    value = product(value, power_interval(f, box[place[(f.signal, f.lag)]]))
            low, high = down(low + value[0]), up(high + value[1])
    return low, high


def slope_interval(factor: Factor, at: Interval) -> Interval | None:
    """Return an interval that holds the derivative of the factor over `at`, None if `at` holds zero."""
    if at[0] <= 0.0 <= at[1]:
        return None
    ends = [factor.power * abs(s) ** (factor.power - 1.0) for s in at]
    low, high = down(down(down(min(ends)))), up(up(up(max(ends))))
    return (low, high) if factor.signed or at[0] > 0.0 else (-high, -low)


def _value(groups: Sequence[Sequence[Term]], box: Box, place: Mapping[Variable, int]) -> float:
    """Return what the sum can actually reach: a lower bound of its largest value on the corners and middle of `box`."""
    points = (_middle(box), tuple((low, low) for low, _ in box), tuple((high, high) for _, high in box))
    return max(_least(groups, point, place) for point in points)


def _least(groups: Sequence[Sequence[Term]], point: Box, place: Mapping[Variable, int]) -> float:
    return _bound(groups, point, place) * (1.0 - 1e-12)


def _middle(box: Box) -> Box:
    return tuple((0.5 * (low + high),) * 2 for low, high in box)


def _halves(box: Box, root: Box) -> tuple[Box, Box]:
    """Return `box` cut in two across its widest side relative to the whole envelope, at zero where it holds zero."""
    shares = [(high - low) / max(r[1] - r[0], 1e-300) for (low, high), r in zip(box, root, strict=True)]
    side = shares.index(max(shares))
    low, high = box[side]
    cut = 0.0 if low < 0.0 < high else 0.5 * (low + high)
    return (*box[:side], (low, cut), *box[side + 1 :]), (*box[:side], (cut, high), *box[side + 1 :])


def _range(envelope: Envelope, signal: str) -> Interval:
    return {"position": envelope.position_m, "speed": envelope.speed_m_s, "current": envelope.current_A}[signal]
