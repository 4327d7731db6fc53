"""How much a neuro-fuzzy model's past forces can count for, and what its inputs alone can make: proved bounds.

The rules' shares are of inputs only, never negative, and sum to one, so each tick is a blend of the rules' affine
recursions: sum_j |sum_r share_r a_rj| <= max_r sum_j |a_rj|. If every rule's sum is below one, the blend is a
contraction whatever the inputs, and from a past of zeros |y| <= max |b| / (1 - max sum) for ever, b being the largest
that any rule makes of the inputs alone: bounded over the input envelope by interval arithmetic, outward rounded.
"""

from __future__ import annotations

from collections.abc import Mapping

from ces_observer.proof.intervals import largest, up
from ces_observer.structures.fuzzy import Fuzzy, Rule
from ces_observer.structures.lagged import Range
from ces_observer.structures.network_bounds import affine, regressor_interval

CLAIM = "sum_j |a_j| <= gain < 1 in every rule, so in every blend; |b| <= drive_N for every input in the input envelope"
METHOD = "convex blend of the rules; interval arithmetic, outward rounding"


def bounds(fuzzy: Fuzzy, envelope: Mapping[str, Range]) -> tuple[float, float]:
    """Return upper bounds on the sum of absolute gains of past forces, and on |force| [N] at a past of zeros."""
    at = [regressor_interval(r, envelope) for r in fuzzy.regressors]
    drive = max(largest(affine(rule.constant, rule.linear, at)) for rule in fuzzy.rules)
    return max(_gain(fuzzy, rule) for rule in fuzzy.rules), up(drive * fuzzy.scale_N)


def _gain(fuzzy: Fuzzy, rule: Rule) -> float:
    total = 0.0
    for slope, regressor in zip(rule.linear, fuzzy.regressors, strict=True):
        if regressor.signal == "force":
            total = up(total + up(abs(slope) * up(fuzzy.scale_N / regressor.spread)))
    return total
