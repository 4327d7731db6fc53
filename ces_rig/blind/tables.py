"""The tables of a scored blind test as records; the program prints them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ces_rig.blind.metrics import METRICS, Cases
from ces_rig.blind.outcome import CaseOutcome


@dataclass(frozen=True)
class ScoreTable:
    """A table of texts: `head` names the columns, every row has as many cells."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def metric_table(title: str, groups: Mapping[str, Cases]) -> ScoreTable:
    """Return one row per group of cases: each metric with its interval, the number of cases, and the target."""
    rows = []
    for name, cases in groups.items():
        row = [name, str(len(cases))]
        for metric in METRICS:
            value, interval, count, goal = metric.describe(metric.count(cases), cases[0].mode.class_name)
            row.append(f"{value} ({interval}; {count})" + (f"; {goal}" if goal else "") if count != "0" else "–")
        rows.append(row)
    return ScoreTable((title, "cases", *(metric.name for metric in METRICS)), rows)


def group_cases(cases: Cases, key: Callable[[CaseOutcome], object]) -> dict[str, list[CaseOutcome]]:
    """Return the cases by the text of a property, in its order."""
    groups: dict[str, list[CaseOutcome]] = {}
    for case in sorted(cases, key=lambda case: str(key(case))):
        groups.setdefault(str(key(case)), []).append(case)
    return groups


def withheld_table(cases: Cases) -> ScoreTable:
    """Return for everything that was withheld the verdicts, and what was most probable."""
    groups = group_cases(cases, lambda case: f"{case.kind}: {' + '.join(case.truth)}".removesuffix(": "))
    rows = [
        [
            name,
            *map(_format_counts, ([c.verdict for c in part], [c.ranked[0] if c.ranked else "nothing" for c in part])),
        ]
        for name, part in groups.items()
    ]
    return ScoreTable(("withheld", "verdicts", "first"), rows)


def mode_facts(cases: Cases) -> dict[str, Any]:
    """Return every metric for --json."""
    figures = [
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
    return {"cases": len(cases), "figures": figures}


def _format_counts(words: Iterable[str]) -> str:
    return ", ".join(f"{word} {count}" for word, count in Counter(words).most_common())
