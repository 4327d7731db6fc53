"""What a comparison says: its headline, differences as texts, and the table of the models."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from ces_identify.comparison.compared_models import BETTER, DIVERGED, NO_TEST, SAME, SHORT, Difference, PairResult
from ces_identify.comparison.comparison import Comparison, Pairs
from ces_identify.validation.cost_table import NONE, interval_text, percent
from ces_report.plot import series_css
from ces_report.table import Column, Table, summarize_result
from ces_report.typesetting import join_with, minus

MAX_NAMES = 3  # of other models in a sentence
LOWEST, TOO_SHORT = "lowest", "too short"
HEADLINES = {
    BETTER: "{best} is better than {others}",
    SAME: "{best} cannot be told apart from {others}",
    SHORT: "too short to know: whether {best} differs from {others}",
    NO_TEST: "no test: {best} or {others} was identified on each recording",
    DIVERGED: "no difference between {best} and {others}: a free run diverged",
}


def headline(comparison: Comparison) -> str:
    """Return what the pooled costs say about the model with the lowest one, against every other."""
    best, count = comparison.best, len(comparison.models) - 1
    parts = []
    for verdict, text in HEADLINES.items():
        others = [i for i in range(count + 1) if i != best and comparison.pair(best, i).verdict == verdict]
        if others:
            shown = join_with([comparison.models[i].name for i in others[:MAX_NAMES]])
            if len(others) > MAX_NAMES:
                shown = f"all {count} others" if len(others) == count else f"{len(others)} of the others"
            parts.append(text.format(best=comparison.models[best].name, others=shown))
    return f"{'; '.join(parts)}."


def format_signed(value: float) -> str:
    """Return a difference [%] with its sign."""
    return minus(f"{round(value, 2) + 0.0:+.2f}")  # no negative zero


def describe_difference(difference: Difference) -> str:
    """Return a difference with its interval, or why there is none."""
    interval = describe_interval(difference)
    return f"{format_signed(difference.value)} ({interval})" if math.isfinite(difference.value) else interval


def describe_interval(difference: Difference) -> str:
    """Return the interval of a difference as text; "diverged" or "too short" without one."""
    low, high = difference.low, difference.high
    if low is None or high is None:
        return TOO_SHORT if math.isfinite(difference.value) else DIVERGED
    return f"{format_signed(low)} to {format_signed(high)}"


def model_table(comparison: Comparison) -> Table[int]:
    """Return a row for each model, lowest cost first: its cost, how much that is above the lowest, and what it is."""
    models, tests = comparison.models, comparison.test_names

    def above(i: int) -> str:
        difference = comparison.above_lowest(i)
        return format_signed(difference.value) if difference else LOWEST if i == comparison.best else NONE

    def above_interval(i: int) -> str:
        difference = comparison.above_lowest(i)
        return describe_interval(difference) if difference else ""

    columns: list[Column[int]] = [
        Column(
            "Model",
            lambda i: models[i].name,
            html=lambda i: Markup("{}<b>{}</b>").format(swatch(comparison, i), models[i].name),
            css="model",
            short="model",
            small=lambda i: models[i].facts[0],
        ),
        Column("Rate [Hz]", lambda i: models[i].facts[1], figure=True, page_only=True),
        Column("Delay [ms]", lambda i: models[i].facts[2], figure=True, short="delay ms"),
        Column(
            "J over all tests [%]" if tests else "J over all, no test [%]",
            lambda i: percent(models[i].pooled, models[i].pooled_interval),
            figure=True,
            short="J %",
            small=lambda i: interval_text(models[i].pooled_interval),
        ),
        Column("Above the lowest [%]", above, figure=True, short="above the lowest", small=above_interval),
        Column("Bound of the force [kN]", lambda i: models[i].bound_kN, figure=True, short="bound kN"),
        Column("Outside envelope [%]", comparison.outside_percent, figure=True, short="out %"),
    ]
    title = f"cost J over {join_with(tests)}" if tests else "cost J over all (not a test)"
    return Table(columns, comparison.by_cost, title)


@summarize_result.register
def _(comparison: Comparison) -> tuple[Sequence[str], Table[int]]:
    return [headline(comparison), *(f"Note: {note}." for note in comparison.notes())], model_table(comparison)


def pair_table(pairs: Sequence[PairResult]) -> Table[PairResult]:
    """Return a row for each pair of models with the difference of their costs."""

    def sort_value(value: float | None) -> object:
        return "" if value is None or math.isnan(value) else value

    def probability(pair: PairResult) -> str:
        return NONE if pair.p_value is None else "< 0.001" if pair.p_value < 0.001 else f"{pair.p_value:.3f}"

    def verdict(pair: PairResult) -> str:
        return pair.verdict if pair.better is None else f"{pair.names[pair.better == pair.second]} is better"

    columns: list[Column[PairResult]] = [
        Column("First", lambda p: p.names[0], short="first"),
        Column("Second", lambda p: p.names[1], short="second"),
        Column("On", lambda p: join_with(p.pooled.recordings), page_only=True),
        Column(
            "First − second, J [%]",
            lambda p: format_signed(p.pooled.value),
            figure=True,
            short="J %",
            value=lambda p: sort_value(p.pooled.value),
            small=lambda p: describe_interval(p.pooled),
        ),
        Column("p", probability, figure=True, value=lambda p: sort_value(p.p_value)),
        Column("Verdict", verdict, short="verdict"),
    ]
    if len({pair.pooled.recordings for pair in pairs}) == 1:
        del columns[2]
    return Table(columns, pairs, "differences of J, first minus second")


@summarize_result.register
def _(pairs: Pairs) -> tuple[Sequence[str], Table[PairResult]]:
    return [], pair_table(pairs)


def swatch(comparison: Comparison, i: int) -> Markup:
    """Return a line in the colour that a model has in the charts; nothing if they do not show it."""
    if i not in comparison.drawn:
        return Markup("")
    return Markup(
        '<svg class="plot-swatch" viewBox="0 0 22 10" aria-hidden="true"><path class="{}" d="M1,5h20"/></svg>'
    ).format(series_css(comparison.drawn.index(i)))
