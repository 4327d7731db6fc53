"""What a comparison says in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from ces_identify.comparison.comparison import Comparison
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
    texts = {BETTER: f"{name} is better than {{}}", SAME: f"{name} cannot be told apart from {{}}",
             SHORT: f"the recordings are too short to know whether {name} differs from {{}}",
             NO_TEST: f"no test: {name} or {{}} was identified on each recording",
             DIVERGED: f"{name} has no difference to {{}}: a free run diverged"}  # fmt: skip
    parts = [texts[verdict].format(_shorten(groups[verdict])) for verdict in texts if verdict in groups]
    sentence = "; ".join(parts)
    return f"{sentence[0].upper() if not sentence.startswith(name) else sentence[0]}{sentence[1:]}."


def join(names: Sequence[str]) -> str:
    """Return names as text: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


def _shorten(names: Sequence[str]) -> str:
    return join(names) if len(names) <= MAX_NAMES else f"{len(names)} of the others"


def signed(value: float) -> str:
    """Return a difference [%] with its sign."""
    return minus(f"{value:+.2f}")


def p_text(p_value: float | None) -> str:
    """Return a p-value as text, a dash without one."""
    if p_value is None:
        return "-"
    return "< 0.001" if p_value < 0.001 else f"{p_value:.3f}"
