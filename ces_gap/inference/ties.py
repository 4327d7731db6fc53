"""Ties on held-out recordings: effects that explain the fitted recordings about as well may not hold on others."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from ces_gap.inference.fit import Z95

CLEARLY_MORE = 1.15  # times the gap (RMS) that the best explanation leaves: what leaves more is no tie


@dataclass(frozen=True)
class ClosedShare:
    """The share of the held-out gap's energy that an explanation closes, with the ends of its 95 % interval."""

    value: float
    low: float
    high: float

    def probability_above(self, share: float) -> float:
        """Return the probability that the true share is above `share`; 0 if nothing is known."""
        return probability_below(-self.value, -share, self.high - self.low)


def probability_below(value: float, limit: float, width: float) -> float:
    """Return the probability that a quantity measured as `value` is below `limit`; its 95 % interval is `width` wide.

    The error is taken as normal. An unknown value is not below anything.
    """
    if math.isnan(value) or math.isnan(limit):
        return 0.0
    error = width / (2.0 * Z95) if 0.0 < width < math.inf else 0.0
    if error > 0.0 and math.isfinite(limit - value):
        return 0.5 * math.erfc((value - limit) / error / math.sqrt(2.0))
    return float(value <= limit)


def confirm_ties(
    groups: Sequence[tuple[str, ...]],
    composition: Collection[str],
    best: ClosedShare,
    others: Mapping[frozenset[str], ClosedShare],
) -> tuple[tuple[str, ...], ...]:
    """Return the `groups` (`search.interchangeable_effects`) that held-out recordings confirm.

    Each begins with an effect of the `composition`, which is the `best` explanation. One that can replace it stays,
    unless the composition with this replacement is among the `others` and leaves clearly more.
    """
    confirmed = []
    for member, *replacements in groups:
        rest = frozenset(composition) - {member}
        scored = {name: others.get(rest | {name}) for name in replacements}
        close = [name for name, other in scored.items() if other is None or not leaves_clearly_more(other, best)]
        if close:
            confirmed.append((member, *close))
    return tuple(confirmed)


def leaves_clearly_more(other: ClosedShare, best: ClosedShare) -> bool:
    """True if `other` leaves `CLEARLY_MORE` of the gap than `best`, or closes less by more than its interval."""
    return 1.0 - other.value > CLEARLY_MORE**2 * (1.0 - best.value) or other.high < best.value
