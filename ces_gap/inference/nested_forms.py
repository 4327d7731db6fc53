"""Forms that tend to another effect at a bound of their parameters: significance decides between the two.

A gas spring whose chamber is large is a force offset. The two share all but the difference, so the error of forms, for
which a small share of the gap is otherwise not trusted, cancels between them.
"""

from __future__ import annotations

from collections.abc import Sequence

from ces_gap.effects.effect import Effect
from ces_gap.inference.comparison import MIN_GAIN_Z, compute_paired_gain
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.explanations import count_stuck_parameters
from ces_gap.inference.fit import EffectFit


def loses_to_nested_form(evidence: Evidence, fit: EffectFit, other: EffectFit) -> bool:
    """True if two fits differ in an effect and its limit only, and the data decide for the `other`.

    The form must gain more than twice the error of its gain over the limit. The limit wins if the form's best
    parameters are on a bound, where the form is no longer plausible, or if it leaves less by more than twice the error.
    """
    mine, theirs = _differing_effects(fit, other), _differing_effects(other, fit)
    if len(mine) != 1 or len(theirs) != 1:
        return False
    better = compute_paired_gain(evidence, fit.left_out, other.left_out).z > MIN_GAIN_Z
    if theirs[0].limit == mine[0].name:
        return better
    return mine[0].limit == theirs[0].name and (better or count_stuck_parameters(fit) > 0)


def order_nested_forms(evidence: Evidence, ranked: Sequence[EffectFit]) -> tuple[EffectFit, ...]:
    """Return the fits of single effects, best first, each before those that lose to it as a nested form."""
    ordered: list[EffectFit] = []
    for fit in ranked:
        place = [k for k, earlier in enumerate(ordered) if loses_to_nested_form(evidence, earlier, fit)]
        ordered.insert(place[0] if place else len(ordered), fit)
    return tuple(ordered)


def _differing_effects(fit: EffectFit, other: EffectFit) -> list[Effect]:
    return [effect for effect in fit.effects if effect.name not in other.names]
