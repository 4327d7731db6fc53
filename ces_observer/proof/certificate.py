"""A proof that a polynomial NARX cannot lose stability: its own past counts for less than one, for every input.

The terms are affine in past forces, so the free run is y(k) = sum_j a_j(u) y(k - j) + b(u), with u the inputs now and
before, each clamped to the envelope. If sum_j |a_j(u)| <= g < 1 for every u in the envelope, the recursion is a
contraction: two runs from different pasts approach each other as g^(k / longest output lag), and from a past of zeros
|y| <= max |b| / (1 - g) for ever. Both maxima are bounded by interval arithmetic with outward rounding
(ces_observer.proof.interval_sums): boxes of inputs are halved, the worst first, until bound and an actual value meet.
Nothing is sampled; every lagged input is free to be anything in its range. Sub-models blended by memberships are
bounded together: a membership is a function of its signal, and boxes are cut where it bends.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from ces_observer.model import Envelope, Model, Term
from ces_observer.proof.interval_sums import Box, Sums
from ces_observer.proof.intervals import down, up
from ces_observer.structures import fuzzy_bounds, network_bounds

MOST_BOXES = 40_000
MOST_WORK = 4_000_000  # interval products: a few seconds, whatever a file asks for
GAIN_GAP = 0.002  # relative distance of bound and actual value at which halving stops
DRIVE_GAP, DRIVE_BOXES = 0.05, 4_000  # the drive has many inputs and need not be tight
CLAIM = "sum |a_j(u)| <= gain < 1 and |b(u)| <= drive_N for every input in the input envelope"
METHOD = "interval branch and bound, outward rounding"


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
    an actual value above it where it is not zero, ends the search early; so does MOST_WORK.
    """
    sums = Sums(groups)
    root, kinks = sums.root(envelope), sums.kinks()
    heap = [(-sums.bound(root), 0, root)]
    reached = sums.value(root)
    count, most_boxes = 1, min(most_boxes, MOST_WORK // max(sums.work, 1))
    while True:
        bound, _, box = heap[0]
        settled = -bound <= enough or (enough and reached > enough)
        if settled or -bound <= reached + gap * max(abs(reached), 1e-3) or count >= most_boxes or not box:
            return -bound, count
        heapq.heappop(heap)
        for half in _halves(box, root, kinks):
            value = min(sums.bound(half), -bound)
            reached = max(reached, sums.value(half))
            heapq.heappush(heap, (-value, count, half))
            count += 1


def _halves(box: Box, root: Box, kinks: Sequence[Sequence[float]]) -> tuple[Box, Box]:
    """Return `box` cut in two across its widest side relative to the whole envelope, at one of its `kinks` if any."""
    shares = [(high - low) / max(r[1] - r[0], 1e-300) for (low, high), r in zip(box, root, strict=True)]
    side = shares.index(max(shares))
    low, high = box[side]
    cut = next((at for at in kinks[side] if low < at < high), 0.5 * (low + high))
    return (*box[:side], (low, cut), *box[side + 1 :]), (*box[:side], (cut, high), *box[side + 1 :])
