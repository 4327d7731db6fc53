"""What a comparison says in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from ces_identify.comparison.comparison import Comparison, join
from ces_identify.comparison.pair_results import BETTER, DIVERGED, NO_TEST, SAME, SHORT
from ces_identify.typesetting import minus

MAX_NAMES = 3  # of other models in a sentence


def best_model(comparison: Comparison) -> int:
    """Return the index of the model with the lowest pooled cost."""
    return min(range(len(comparison.models)), key=lambda i: comparison.models[i].pooled)


def headline(comparison: Comparison) -> str:
    """Return what the pooled costs say about the model with the lowest one, against every other."""
    best = best_model(comparison)
    groups: dict[str, list[str]] = {}
    for i, model in enumerate(comparison.models):
        if i != best:
            groups.setdefault(comparison.pair(best, i).verdict, []).append(model.name)
    name = comparison.models[best].name
    sentence = "; ".join(
        _describe(verdict, name, _shorten(groups[verdict], len(comparison.models) - 1))
        for verdict in (BETTER, SAME, SHORT, NO_TEST, DIVERGED)
        if verdict in groups
    )
    return f"{sentence}."


def _describe(verdict: str, best: str, others: str) -> str:
    """Return a verdict on the model with the lowest cost and others."""
    return {
        BETTER: f"{best} is better than {others}",
        SAME: f"{best} cannot be told apart from {others}",
        SHORT: f"too short to know: whether {best} differs from {others}",
        NO_TEST: f"no test: {best} or {others} was identified on each recording",
        DIVERGED: f"no difference between {best} and {others}: a free run diverged",
    }[verdict]


def _shorten(names: Sequence[str], others: int) -> str:
    if len(names) <= MAX_NAMES:
        return join(names)
    return f"all {others} others" if len(names) == others else f"{len(names)} of the others"


def format_signed(value: float) -> str:
    """Return a difference [%] with its sign."""
    return minus(f"{round(value, 2) + 0.0:+.2f}")  # no negative zero


def p_text(p_value: float | None) -> str:
    """Return a p-value as text, a dash without one."""
    if p_value is None:
        return "-"
    return "< 0.001" if p_value < 0.001 else f"{p_value:.3f}"
