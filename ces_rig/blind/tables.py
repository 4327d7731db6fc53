"""The tables of a scored blind test as records; the program prints them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ces_rig.blind.metrics import BY_NAME, IN_SLICES, IN_SUMMARY, METRICS, Cases, Metric, baselines, cases_of_kind
from ces_rig.blind.metrics import cases_with_targets as with_targets
from ces_rig.blind.outcome import CaseOutcome

WORDS = {0.0: "0", 1.0 / 3.0: "1/3"}


@dataclass(frozen=True)
class ScoreTable:
    """A table of texts: `head` names the columns, every row has as many cells."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def summary_table(by_mode: Mapping[str, Cases]) -> ScoreTable:
    """Return one row per mode: each main metric with its interval, the number of cases, and the target."""
    rows, metrics = [], [metric for metric in METRICS if IN_SUMMARY in metric.shown]
    for name, cases in by_mode.items():
        row = [f"`{name}`", str(len(cases))]
        for metric in metrics:
            value, interval, count, goal = metric.describe(metric.count(cases), cases[0].mode.class_name)
            row.append(f"{value} ({interval}; {count})" + (f"; {goal}" if goal else "") if count != "0" else "–")
        rows.append(row)
    return ScoreTable(("mode", "cases", *(metric.short or metric.name for metric in metrics)), rows)


def headline_table(cases: Cases) -> ScoreTable:
    """Return every metric with its interval and the target of the cases' mode."""
    described = [(m.name, *m.describe(m.count(cases), cases[0].mode.class_name)) for m in METRICS]
    shown = [row for row in described if row[3] != "0"]
    return ScoreTable(("figure", "value", "95 % interval", "cases", "target"), shown)


def mode_facts(cases: Cases) -> dict[str, Any]:
    """Return for --json every metric over the cases that the targets apply to, and over all."""
    return {"cases": len(cases), "with_targets": _metric_facts(with_targets(cases)), "all": _metric_facts(cases)}


def _metric_facts(cases: Cases) -> list[dict[str, Any]]:
    return [
        {
            "figure": metric.name,
            "value": figure.value,
            "ci95": figure.interval,
            "cases": figure.count,
            "target": metric.target(cases[0].mode.class_name),
            "target_is_minimum": metric.target_is_minimum,
        }
        for metric in METRICS
        if (figure := metric.count(cases)).count > 0
    ]


def slice_table(cases: Cases, title: str, key: Callable[[CaseOutcome], object]) -> ScoreTable:
    """Return the main metrics by one property of the cases."""
    rows, metrics = [], [metric for metric in METRICS if IN_SLICES in metric.shown]
    for level in sorted({key(case) for case in cases}, key=lambda level: (isinstance(level, str), level)):
        part = [case for case in cases if key(case) == level]
        text = WORDS.get(level, f"{level:g}") if isinstance(level, float) else str(level)
        rows.append([text, str(len(part)), *_values(metrics, part)])
    return ScoreTable((title, "cases", *(metric.short or metric.name for metric in metrics)), rows)


def confusion_table(cases: Cases) -> ScoreTable:
    """Return for each withheld effect its top-1 and top-3 rates, the verdicts and the effects mistaken for it."""
    rows, metrics = [], [BY_NAME[name] for name in ("top-1", "top-1 by class", "top-3")]
    effect_cases = cases_of_kind(cases, "effect")
    for effect in sorted({name for case in effect_cases for name in case.truth}):
        part = [case for case in effect_cases if effect in case.truth]
        mistaken = (case.ranked[0] if case.ranked else "nothing" for case in part if not case.is_in_top(1))
        counts = [_format_counts(case.verdict for case in part), _format_counts(mistaken)]
        rows.append([f"`{effect}`", str(len(part)), *_values(metrics, part), *counts])
    return ScoreTable(("withheld", "cases", "top-1", "by class", "top-3", "verdicts", "mistaken for"), rows)


def no_effect_table(cases: Cases) -> ScoreTable:
    """Return the verdicts on cases without a library effect, and the effects named in them."""
    parts: dict[str, list[CaseOutcome]] = {}
    for case in cases_of_kind(cases, "none", "outside"):
        nothing = "nothing, simulation correct" if case.baseline_ratio == 0.0 else "nothing, simulation wrong"
        parts.setdefault(f"outside: `{case.truth[0]}`" if case.kind == "outside" else nothing, []).append(case)
    rows = []
    for name, part in sorted(parts.items()):
        named = (" + ".join(case.composition) for case in part if case.verdict in ("named", "ambiguous"))
        rows.append([name, str(len(part)), _format_counts(case.verdict for case in part), _format_counts(named)])
    return ScoreTable(("withheld", "cases", "verdicts", "named"), rows)


def baseline_table(cases: Cases) -> ScoreTable:
    """Return the top-1 rates of the diagnosis and of simpler methods."""
    metric = BY_NAME["top-1"]
    methods = {"the diagnosis": metric.count(cases), **baselines(cases)}
    rows = [[name, *metric.describe(figure)[:3]] for name, figure in methods.items()]
    return ScoreTable(("method", "top-1", "95 % interval", "cases"), rows)


def _format_counts(words: Iterable[str]) -> str:
    return ", ".join(f"{word} {count}" for word, count in Counter(words).most_common())


def _values(metrics: Sequence[Metric], cases: Cases) -> list[str]:
    return [metric.format(metric.count(cases).value) for metric in metrics]
