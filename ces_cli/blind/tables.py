"""The figures of a blind test as Markdown, and its cases as CSV."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from math import isnan

from ces_cli.blind.figures import BY_NAME, METRICS, Cases, Metric, baselines, cases_of_kind
from ces_cli.blind.outcome import NONE, UNKNOWN, CaseOutcome
from ces_cli.blind.statistics import Statistic

SLICE_METRICS = (
    "top-1", "top-1 by class", "top-3", "confidently wrong", "false alarms", "outside called `unknown`",
    "library called `unknown`", "both of a pair", "closure / oracle, median", "abs(claimed − true shrink), median",
    "ECE of the first candidate",
)  # fmt: skip
SHORT = {
    "outside called `unknown`": "outside unknown",
    "library called `unknown`": "library unknown",
    "closure / oracle, median": "closure / oracle",
    "abs(claimed − true shrink), median": "shrink error",
    "ECE of the first candidate": "ECE",
}
WORDS = {0.0: "0", 1.0 / 3.0: "1/3"}


def headline_table(cases: Cases, predictions: bool) -> str:
    """Return every figure with its interval beside its target."""
    counted = [(metric, metric.count(cases)) for metric in METRICS]
    rows = [_row(metric, figure, predictions) for metric, figure in counted if figure.count > 0]
    return _table(["figure", "value", "95 % interval", "cases", "target"], rows)


def _row(metric: Metric, figure: Statistic, predictions: bool) -> list[str]:
    target = metric.target_predictions if predictions else metric.target
    numbers = [_text(metric, figure), _interval(metric, figure), str(figure.count)]
    return [metric.name, *numbers, "" if target is None else _goal(metric, target, figure)]


def slice_table(cases: Cases, title: str, key: Callable[[CaseOutcome], object]) -> str:
    """Return the most important figures by one property of the cases, with the number of effect cases."""
    levels = sorted({key(case) for case in cases}, key=lambda level: (isinstance(level, str), level))
    rows = []
    for level in levels:
        mine = [case for case in cases if key(case) == level]
        figures = [_text(BY_NAME[name], BY_NAME[name].count(mine)) for name in SLICE_METRICS]
        rows.append([_level(level), str(len(mine)), *figures])
    return _table([title, "cases", *(SHORT.get(name, name) for name in SLICE_METRICS)], rows)


def confusion_table(cases: Cases) -> str:
    """Return for each withheld effect how often it came first, by class and among three, and what it was taken for."""
    rows = []
    for effect in sorted({name for case in cases_of_kind(cases, "effect") for name in case.truth}):
        mine = [case for case in cases_of_kind(cases, "effect") if effect in case.truth]
        shares = [_text(BY_NAME[name], BY_NAME[name].count(mine)) for name in ("top-1", "top-1 by class", "top-3")]
        taken = Counter(case.ranked[0] if case.ranked else "nothing" for case in mine if not case.is_in_top(1))
        rows.append(
            [f"`{effect}`", str(len(mine)), *shares, _format_counts(c.verdict for c in mine), _format_counter(taken)]
        )
    return _table(["withheld", "cases", "top-1", "by class", "top-3", "verdicts", "taken for"], rows)


def no_effect_table(cases: Cases) -> str:
    """Return the verdicts on cases without a library effect, and what was named there."""
    rows = []
    for name in sorted({_describe_withheld_effect(case) for case in cases_of_kind(cases, "none", "outside")}):
        mine = [case for case in cases_of_kind(cases, "none", "outside") if _describe_withheld_effect(case) == name]
        named = Counter(" + ".join(case.composition) for case in mine if case.verdict in ("named", "ambiguous"))
        rows.append([name, str(len(mine)), _format_counts(case.verdict for case in mine), _format_counter(named)])
    return _table(["withheld", "cases", "verdicts", "named"], rows)


def baseline_table(cases: Cases) -> str:
    """Return the top-1 rate of the diagnosis beside that of simpler ways."""
    metric = BY_NAME["top-1"]
    ways = {"the diagnosis": metric.count(cases), **baselines(cases)}
    rows = [[name, _text(metric, f), _interval(metric, f), str(f.count)] for name, f in ways.items()]
    return _table(["way to name the cause", "top-1", "95 % interval", "cases"], rows)


def case_rows(cases: Cases) -> str:
    """Return one line of CSV for each case: what was withheld, what was said, how far the gap truly shrank."""
    head = ("case", "kind", "plant", "excitation", "gap_to_noise", "baseline_ratio", "withheld", "verdict", "found")
    names = sorted({name for case in cases for name in case.figures})
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    out.writerow([*head, "causes", "probability_none", "probability_unknown", "claimed_shrink", *names, "seconds"])
    for c in cases:
        levels = [c.case, c.kind, c.plant, c.excitation, f"{c.gap_to_noise:g}", f"{c.baseline_ratio:.3g}"]
        first = [f"{name} {c.probability.get(name, 0.0):.3f}" for name in c.ranked[:3]]
        rest = [f"{c.probability.get(name, 0.0):.3f}" for name in (NONE, UNKNOWN)]
        figures = [f"{c.figures[name]:.4g}" if name in c.figures else "" for name in names]
        found = ["+".join(c.truth), c.verdict, "+".join(c.composition), "; ".join(first)]
        claimed = "" if c.claimed_shrink is None else f"{c.claimed_shrink:.4g}"
        out.writerow([*levels, *found, *rest, claimed, *figures, f"{c.seconds:.1f}"])
    return text.getvalue()


def _describe_withheld_effect(case: CaseOutcome) -> str:
    if case.kind == "outside":
        return f"outside: `{case.truth[0]}`"
    return "nothing, simulation right" if case.baseline_ratio == 0.0 else "nothing, simulation wrong"


def _format_counts(words: Iterable[str]) -> str:
    return _format_counter(Counter(words))


def _format_counter(counter: Counter[str]) -> str:
    return ", ".join(f"{word} {count}" for word, count in counter.most_common())


def _level(level: object) -> str:
    if isinstance(level, float):
        return WORDS.get(level, f"{level:g}")
    return str(level)


def _text(metric: Metric, figure: Statistic) -> str:
    return _number(figure.value, metric.percent)


def _interval(metric: Metric, figure: Statistic) -> str:
    low, high = figure.interval()
    return f"{_number(low, metric.percent)} to {_number(high, metric.percent)}"


def _goal(metric: Metric, target: float, figure: Statistic) -> str:
    sign, met = ("≥", figure.value >= target) if metric.target_is_minimum else ("≤", figure.value <= target)
    return f"{sign} {_number(target, metric.percent)} {'met' if met else '**not met**'}"


def _number(value: float, percent: bool) -> str:
    if isnan(value):
        return "–"
    return f"{100 * value:.1f} %" if percent else f"{value:.3f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)
