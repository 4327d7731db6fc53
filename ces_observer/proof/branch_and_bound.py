"""The maximum of a sum of terms over a box of inputs: branch and bound with outward rounding.

Boxes are halved, the worst first, until the bound meets an actual value. Every input may take any value in its range.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence

from ces_observer.proof.interval_sums import Box, Product, Sums
from ces_observer.proof.intervals import Interval

MAX_BOXES = 40_000
MAX_WORK = 4_000_000  # interval products: a few seconds at most, for any file
GAIN_GAP = 0.002  # relative distance of bound and actual value at which halving stops


def bound_maximum(
    groups: Sequence[Sequence[Product]],
    ranges: Mapping[str, Interval],
    enough: float = 0.0,
    gap: float = GAIN_GAP,
    max_boxes: int = MAX_BOXES,
) -> tuple[float, int]:
    """Return an upper bound on the maximum over the `ranges` of the sum over groups of |sum of the group's terms|.

    Past forces in the terms are left out. The second number is the count of boxes. The search ends early at a bound of
    at most `enough`, at an actual value above `enough` unless that is zero, and at MAX_WORK.
    """
    sums = Sums(groups)
    root, kinks = sums.root(ranges), sums.kinks()
    heap = [(-sums.bound(root), 0, root)]
    reached = sums.value(root)
    count, max_boxes = 1, min(max_boxes, MAX_WORK // max(sums.work, 1))
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
