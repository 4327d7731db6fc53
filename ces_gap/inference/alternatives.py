"""Rivals: effects that explain the evidence as well as one of those that were found, put in its place.

The others of the composition are refitted beside them: what two effects leave alone says little of what they leave
with a third.
"""

from __future__ import annotations

from collections.abc import Sequence

from ces_gap.inference.comparison import MIN_GAIN_SHARE, MIN_GAIN_Z, compute_paired_gain
from ces_gap.inference.fit import EffectFit
from ces_gap.inference.search import EffectSearchResult
from ces_gap.inference.verdict import NEGLIGIBLE_SHARE


def find_alternatives(result: EffectSearchResult) -> list[EffectFit]:
    """Return the fits that differ from the best in one effect."""
    best = result.best
    if best is None:
        return []
    some = result.alone if len(best.effects) == 1 else result.tried
    return [f for f in some if len(f.names) == len(best.names) and len(set(best.names) - set(f.names)) == 1]


def min_unexplained_shares(result: EffectSearchResult) -> dict[str, float]:
    """Return the least share of the gap's energy that each effect leaves: alone, in the best, in the place of another.

    What a contender shares with the best says nothing of it, and is not counted.
    """
    left = {fit.names[0]: fit.cost for fit in result.alone}
    best = result.best
    for fit in (*find_alternatives(result), *([best] if best is not None else [])):
        own = fit.names if best is None or fit is best else set(fit.names) - set(best.names)
        left.update({name: min(left[name], fit.cost) for name in own})
    return {name: (cost - len(result.baseline_residual)) / result.gap_energy for name, cost in left.items()}


def interchangeable_effects(result: EffectSearchResult) -> tuple[tuple[str, ...], ...]:
    """Return each effect of the best composition that others can replace, with those others, the best first."""
    best = result.best
    groups: dict[str, list[str]] = {}
    if best is None:
        return ()
    for fit in sorted(find_alternatives(result), key=lambda f: f.cost):
        (member,) = set(best.names) - set(fit.names)
        (other,) = set(fit.names) - set(best.names)
        if _is_as_good(result, best, fit):
            groups.setdefault(member, [member]).append(other)
    return tuple(tuple(dict.fromkeys(groups[name])) for name in best.names if name in groups)


def merge_groups(groups: Sequence[tuple[str, ...]], classes: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    """Return all groups, largest first, those that are a part of another left out."""
    kept: list[tuple[str, ...]] = []
    for group in sorted((*groups, *classes), key=len, reverse=True):
        if not any(set(group) <= set(larger) for larger in kept):
            kept.append(group)
    return tuple(kept)


def _is_as_good(found: EffectSearchResult, best: EffectFit, fit: EffectFit) -> bool:
    """True if what the best gains over the fit is next to nothing, or little and within twice its error."""
    paired = compute_paired_gain(found.evidence, fit.left_out, best.left_out)
    share = paired.energy / found.gap_energy
    return share < NEGLIGIBLE_SHARE or (share < MIN_GAIN_SHARE and paired.z < MIN_GAIN_Z)
