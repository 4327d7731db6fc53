"""The metrics of a blind test as Markdown tables, and its cases as CSV."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import isfinite
from typing import Any

from ces_cli.blind.figures import BY_NAME, METRICS, Cases, Metric, baselines, cases_of_kind, cases_with_targets
from ces_cli.blind.outcome import NONE, UNKNOWN, CaseOutcome
from ces_cli.blind.statistics import Statistic
from ces_cli.terminal.terminal import as_csv

SLICE_METRICS = (
    "top-1", "top-1 by class", "top-3", "named, and not the cause", "false alarms", "outside called `unknown`",
    "library called `unknown`", "both of a pair", "closure / oracle, median", "abs(claimed − true shrink), median",
    "ECE of the first candidate",
)  # fmt: skip
SUMMARY_METRICS = (
    "top-1", "top-1 by class", "top-3", "verdict names exactly the effect", "named, and not the cause", "false alarms",
    "outside called `unknown`", "both of a pair", "closure / oracle, median", "closure / oracle, 10th percentile",
    "abs(claimed − true shrink), median", "abs(claimed − true shrink), 90th percentile",
    "parameters within their 95 % interval", "ECE of the first candidate",
)  # fmt: skip
SHORT = {
    "top-1 by class": "class",
    "verdict names exactly the effect": "named exactly",
    "named, and not the cause": "named, not the cause",
    "both of a pair": "pairs",
    "closure / oracle, 10th percentile": "10th percentile",
    "abs(claimed − true shrink), 90th percentile": "90th percentile",
    "parameters within their 95 % interval": "parameters covered",
    "outside called `unknown`": "outside unknown",
    "library called `unknown`": "library unknown",
    "closure / oracle, median": "closure / oracle",
    "abs(claimed − true shrink), median": "shrink error",
    "ECE of the first candidate": "ECE",
}
WORDS = {0.0: "0", 1.0 / 3.0: "1/3"}


def summary_table(by_mode: Mapping[str, Cases]) -> str:
    """Return one row per mode: each main metric with its interval, the number of cases, and the target."""
    rows = []
    for name, cases in by_mode.items():
        target_class = cases[0].mode.class_name
        cells = [_summary_cell(BY_NAME[metric], cases, target_class) for metric in SUMMARY_METRICS]
        rows.append([f"`{name}`", str(len(cases)), *cells])
    return _table(["mode", "cases", *(SHORT.get(name, name) for name in SUMMARY_METRICS)], rows)


def _summary_cell(metric: Metric, cases: Cases, target_class: str) -> str:
    figure = metric.count(cases)
    if figure.count == 0:
        return "–"
    text = f"{_text(metric, figure)} ({_interval(metric, figure)}; {figure.count})"
    target = metric.targets.get(target_class)
    return text if target is None else f"{text}; {_goal(metric, target, figure)}"


def headline_table(cases: Cases) -> str:
    """Return every metric with its interval and the target of the cases' mode."""
    counted = [(metric, metric.count(cases)) for metric in METRICS]
    rows = [_row(metric, figure, cases[0].mode.class_name) for metric, figure in counted if figure.count > 0]
    return _table(["figure", "value", "95 % interval", "cases", "target"], rows)


def _row(metric: Metric, figure: Statistic, target_class: str) -> list[str]:
    target = metric.targets.get(target_class)
    numbers = [_text(metric, figure), _interval(metric, figure), str(figure.count)]
    return [metric.name, *numbers, "" if target is None else _goal(metric, target, figure)]


def mode_facts(cases: Cases) -> dict[str, Any]:
    """Return for --json every metric over the cases that the targets apply to, and over all."""
    return {"cases": len(cases), "with_targets": _metric_facts(cases_with_targets(cases)), "all": _metric_facts(cases)}


def _metric_facts(cases: Cases) -> list[dict[str, Any]]:
    counted = [(metric, metric.count(cases)) for metric in METRICS] if cases else []
    return [
        {
            "figure": metric.name,
            "value": figure.value,
            "ci95": figure.interval(),
            "cases": figure.count,
            "target": metric.targets.get(cases[0].mode.class_name),
            "target_is_minimum": metric.target_is_minimum,
        }
        for metric, figure in counted
        if figure.count > 0
    ]


def slice_table(cases: Cases, title: str, key: Callable[[CaseOutcome], object]) -> str:
    """Return the main metrics by one property of the cases."""
    levels = sorted({key(case) for case in cases}, key=lambda level: (isinstance(level, str), level))
    rows = []
    for level in levels:
        part = [case for case in cases if key(case) == level]
        text = WORDS.get(level, f"{level:g}") if isinstance(level, float) else str(level)
        rows.append([text, str(len(part)), *_values(SLICE_METRICS, part)])
    return _table([title, "cases", *(SHORT.get(name, name) for name in SLICE_METRICS)], rows)


def confusion_table(cases: Cases) -> str:
    """Return for each withheld effect its top-1 and top-3 rates, the verdicts and the effects mistaken for it."""
    rows = []
    effect_cases = cases_of_kind(cases, "effect")
    for effect in sorted({name for case in effect_cases for name in case.truth}):
        part = [case for case in effect_cases if effect in case.truth]
        shares = _values(("top-1", "top-1 by class", "top-3"), part)
        mistaken = (case.ranked[0] if case.ranked else "nothing" for case in part if not case.is_in_top(1))
        counts = [_format_counts(case.verdict for case in part), _format_counts(mistaken)]
        rows.append([f"`{effect}`", str(len(part)), *shares, *counts])
    return _table(["withheld", "cases", "top-1", "by class", "top-3", "verdicts", "mistaken for"], rows)


def no_effect_table(cases: Cases) -> str:
    """Return the verdicts on cases without a library effect, and the effects named in them."""
    rows = []
    other_cases = cases_of_kind(cases, "none", "outside")
    for name in sorted(set(map(_describe_withheld_effect, other_cases))):
        part = [case for case in other_cases if _describe_withheld_effect(case) == name]
        named = (" + ".join(case.composition) for case in part if case.verdict in ("named", "ambiguous"))
        rows.append([name, str(len(part)), _format_counts(case.verdict for case in part), _format_counts(named)])
    return _table(["withheld", "cases", "verdicts", "named"], rows)


def baseline_table(cases: Cases) -> str:
    """Return the top-1 rates of the diagnosis and of simpler methods."""
    metric = BY_NAME["top-1"]
    methods = {"the diagnosis": metric.count(cases), **baselines(cases)}
    rows = [[name, _text(metric, f), _interval(metric, f), str(f.count)] for name, f in methods.items()]
    return _table(["method", "top-1", "95 % interval", "cases"], rows)


def case_rows(cases: Cases) -> str:
    """Return one line of CSV for each case: withheld effects, diagnosis, and the true figures."""
    head = (
        "mode",
        "case",
        "kind",
        "plant",
        "excitation",
        "gap_to_noise",
        "baseline_ratio",
        "withheld",
        "verdict",
        "found",
    )
    names = sorted({name for case in cases for name in case.figures})
    tail = ("causes", "probability_none", "probability_unknown", "claimed_shrink", *names, "seconds")
    rows: list[Sequence[str]] = [(*head, *tail)]
    for c in cases:
        levels = [c.mode.name, c.case, c.kind, c.plant, c.excitation, f"{c.gap_to_noise:g}", f"{c.baseline_ratio:.3g}"]
        first = [f"{name} {c.probability.get(name, 0.0):.3f}" for name in c.ranked[:3]]
        rest = [f"{c.probability.get(name, 0.0):.3f}" for name in (NONE, UNKNOWN)]
        figures = [f"{c.figures[name]:.4g}" if name in c.figures else "" for name in names]
        result = ["+".join(c.truth), c.verdict, "+".join(c.composition), "; ".join(first)]
        claimed = "" if c.claimed_shrink is None else f"{c.claimed_shrink:.4g}"
        rows.append([*levels, *result, *rest, claimed, *figures, f"{c.seconds:.1f}"])
    return as_csv(rows)


def _describe_withheld_effect(case: CaseOutcome) -> str:
    if case.kind == "outside":
        return f"outside: `{case.truth[0]}`"
    return "nothing, simulation correct" if case.baseline_ratio == 0.0 else "nothing, simulation wrong"


def _format_counts(words: Iterable[str]) -> str:
    return ", ".join(f"{word} {count}" for word, count in Counter(words).most_common())


def _values(names: Sequence[str], cases: Cases) -> list[str]:
    return [_text(BY_NAME[name], BY_NAME[name].count(cases)) for name in names]


def _text(metric: Metric, figure: Statistic) -> str:
    return _number(figure.value, metric.percent)


def _interval(metric: Metric, figure: Statistic) -> str:
    low, high = figure.interval()
    return f"{_number(low, metric.percent)} to {_number(high, metric.percent)}"


def _goal(metric: Metric, target: float, figure: Statistic) -> str:
    """Return the target, and whether it is met: undecided where the interval of the figure contains it."""
    low, high = figure.interval()
    at_least = metric.target_is_minimum
    met, missed = (low >= target, high < target) if at_least else (high <= target, low > target)
    decided = "met" if met else "**not met**" if missed else "undecided"
    return f"{'≥' if at_least else '≤'} {_number(target, metric.percent)} {decided}"


def _number(value: float, percent: bool) -> str:
    if not isfinite(value):
        return "–"
    return f"{100 * value:.1f} %" if percent else f"{value:.3f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)
