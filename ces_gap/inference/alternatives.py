"""Alternatives: effects that replace one effect of the best composition and explain the evidence about as well.

The other effects of the composition are refitted with each alternative.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ces_gap.inference.comparison import MIN_GAIN_SHARE, MIN_GAIN_Z, compute_paired_gain, prior_cost
from ces_gap.inference.fit import EffectFit
from ces_gap.inference.nested_forms import loses_to_nested_form
from ces_gap.inference.search import EffectSearchResult
from ces_gap.inference.verdict import NEGLIGIBLE_SHARE
from ces_gap.intake.checks import is_current_constant

ALIKE_AT_CONSTANT_CURRENT = frozenset(("current_scale", "force_scale"))
MAX_ALIKE_SHARE = 0.1  # of the gap's energy by which one of these may leave more than the other


def find_alternatives(result: EffectSearchResult) -> list[EffectFit]:
    """Return the fits that differ from the best in one effect."""
    best = result.best
    if best is None:
        return []
    fits = result.alone if len(best.effects) == 1 else result.tried
    near = [f for f in fits if len(f.names) == len(best.names) and len(set(best.names) - set(f.names)) == 1]
    return [f for f in near if not loses_to_nested_form(result.evidence, f, best)]


def _is_rival(best: EffectFit, fit: EffectFit) -> bool:
    """True unless the fit replaces the simulation's timing, or an effect by that timing or a map of its calibration."""
    exchanged = [e for e in (*best.effects, *fit.effects) if (e.name in best.names) != (e.name in fit.names)]
    maps = [e for e in fit.effects if e.prior_share > 0.0 and e.name not in best.names]
    return not maps and not any(e.nuisance for e in exchanged)


def min_unexplained_shares(result: EffectSearchResult) -> dict[str, float]:
    """Return the smallest share of the gap's energy that each effect leaves: alone, in the best, or as an alternative.

    An alternative counts only for the effect that it adds, not for those that it shares with the best. An effect that
    loses to a nested form counts as leaving clearly more.
    """
    best, clear = result.best, MIN_GAIN_SHARE * result.gap_energy
    costs = {fit.names[0]: _cost(result, fit) for fit in result.alone if not fit.effects[0].nuisance}
    if best is not None and len(best.effects) == 1:
        lost = [f for f in result.alone if loses_to_nested_form(result.evidence, f, best)]
        costs.update({f.names[0]: max(f.cost, best.cost + clear) for f in lost})
    for fit in (*find_alternatives(result), *([best] if best is not None else [])):
        names = fit.names if best is None or fit is best else set(fit.names) - set(best.names)
        costs.update({name: min(costs[name], _cost(result, fit)) for name in names if name in costs})
    return {name: (cost - len(result.baseline_residual)) / result.gap_energy for name, cost in costs.items()}


def _no_allowance(fit: EffectFit) -> float:
    return 0.0


def interchangeable_effects(
    result: EffectSearchResult, allowance: Callable[[EffectFit], float] = _no_allowance
) -> tuple[tuple[str, ...], ...]:
    """Return groups: an effect of the best composition, followed by those that can replace it, best first.

    The `allowance` of a fit is the whitened energy that it may leave because of a surrogate's error.
    """
    best = result.best
    groups: dict[str, list[str]] = {}
    if best is None:
        return ()
    for fit in sorted(find_alternatives(result), key=lambda f: f.cost):
        (member,) = set(best.names) - set(fit.names)
        (other,) = set(fit.names) - set(best.names)
        if _is_rival(best, fit) and _is_as_good(result, best, fit, allowance(fit)):
            groups.setdefault(member, [member]).append(other)
    return tuple(tuple(dict.fromkeys(groups[name])) for name in best.names if name in groups)


def merge_groups(groups: Sequence[tuple[str, ...]], classes: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    """Return all groups, largest first, without those that are part of another."""
    merged: list[tuple[str, ...]] = []
    for group in sorted((*groups, *classes), key=len, reverse=True):
        if not any(set(group) <= set(larger) for larger in merged):
            merged.append(group)
    return tuple(merged)


def _cost(result: EffectSearchResult, fit: EffectFit) -> float:
    return fit.cost + prior_cost(fit, result.gap_energy)


def _is_as_good(result: EffectSearchResult, best: EffectFit, fit: EffectFit, allowance: float) -> bool:
    """True if the best gains a negligible energy over the fit, or a small one that is within twice its error.

    A gain within the fit's `allowance` counts as none.

    At one current, a wrong gain of current or of force differ by how the simulation depends on the current only. These
    recordings do not verify that, so a somewhat larger gain does not decide between the two.
    """
    paired = compute_paired_gain(result.evidence, fit.left_out, best.left_out)
    share = (paired.energy - allowance) / result.gap_energy
    if set(best.names) ^ set(fit.names) == ALIKE_AT_CONSTANT_CURRENT and is_current_constant(result.evidence.traces):
        return share < MAX_ALIKE_SHARE
    return share < NEGLIGIBLE_SHARE or (share < MIN_GAIN_SHARE and paired.z < MIN_GAIN_Z)
