"""The figures of a blind test as Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from math import isfinite, isnan

from ces_cli.blind_figures import BY_NAME, METRICS, Cases, Metric, baselines, of
from ces_cli.blind_outcome import Outcome
from ces_cli.blind_statistics import Figure

SLICED = (
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


def headline(cases: Cases, predictions: bool) -> str:
    """Return every figure with its interval beside its target."""
    rows = []
    for metric in METRICS:
        figure = metric.count(cases)
        if figure.count == 0:
            continue
        target = metric.target_predictions if predictions else metric.target
        rows.append(
            [
                metric.name,
                _text(metric, figure),
                _interval(metric, figure),
                str(figure.count),
                _goal(metric, target, figure),
            ]
        )
    return _table(["figure", "value", "95 % interval", "cases", "target"], rows)


def sliced(cases: Cases, title: str, key: Callable[[Outcome], object]) -> str:
    """Return the most important figures by one property of the cases, with the number of effect cases."""
    levels = sorted({key(case) for case in cases}, key=lambda level: (isinstance(level, str), level))
    rows = []
    for level in levels:
        mine = [case for case in cases if key(case) == level]
        figures = [_text(BY_NAME[name], BY_NAME[name].count(mine)) for name in SLICED]
        rows.append([_level(level), str(len(mine)), *figures])
    return _table([title, "cases", *(SHORT.get(name, name) for name in SLICED)], rows)


def confusions(cases: Cases) -> str:
    """Return for each withheld effect how often it came first, by class and among three, and what it was taken for."""
    rows = []
    for effect in sorted({name for case in of(cases, "effect") for name in case.truth}):
        mine = [case for case in of(cases, "effect") if effect in case.truth]
        shares = [_text(BY_NAME[name], BY_NAME[name].count(mine)) for name in ("top-1", "top-1 by class", "top-3")]
        taken = Counter(case.ranked[0] if case.ranked else "nothing" for case in mine if not case.in_top(1))
        rows.append([f"`{effect}`", str(len(mine)), *shares, _counted(c.verdict for c in mine), _listed(taken)])
    return _table(["withheld", "cases", "top-1", "by class", "top-3", "verdicts", "taken for"], rows)


def others(cases: Cases) -> str:
    """Return the verdicts on cases without a library effect, and what was named there."""
    rows = []
    for name in sorted({_withheld(case) for case in of(cases, "none", "outside")}):
        mine = [case for case in of(cases, "none", "outside") if _withheld(case) == name]
        named = Counter(" + ".join(case.found) for case in mine if case.verdict in ("named", "ambiguous"))
        rows.append([name, str(len(mine)), _counted(case.verdict for case in mine), _listed(named)])
    return _table(["withheld", "cases", "verdicts", "named"], rows)


def compared(cases: Cases) -> str:
    """Return the top-1 rate of the diagnosis beside that of simpler ways."""
    metric = BY_NAME["top-1"]
    ways = {"the diagnosis": metric.count(cases), **baselines(cases)}
    rows = [[name, _text(metric, f), _interval(metric, f), str(f.count)] for name, f in ways.items()]
    return _table(["way to name the cause", "top-1", "95 % interval", "cases"], rows)


def _withheld(case: Outcome) -> str:
    if case.kind == "outside":
        return f"outside: `{case.truth[0]}`"
    return "nothing, simulation right" if case.baseline_ratio == 0.0 else "nothing, simulation wrong"


def _counted(words: Iterable[str]) -> str:
    return _listed(Counter(words))


def _listed(counter: Counter[str]) -> str:
    return ", ".join(f"{word} {count}" for word, count in counter.most_common())


def _level(level: object) -> str:
    if isinstance(level, float):
        return WORDS.get(level, f"{level:g}")
    return str(level)


def _text(metric: Metric, figure: Figure) -> str:
    return _number(figure.value, metric.percent)


def _interval(metric: Metric, figure: Figure) -> str:
    if not isfinite(figure.low):
        return ""
    return f"{_number(figure.low, metric.percent)} to {_number(figure.high, metric.percent)}"


def _goal(metric: Metric, target: float | None, figure: Figure) -> str:
    if target is None:
        return ""
    sign = "≥" if metric.least else "≤"
    met = (figure.value >= target) if metric.least else (figure.value <= target)
    return f"{sign} {_number(target, metric.percent)} {'met' if met else '**not met**'}"


def _number(value: float, percent: bool) -> str:
    if isnan(value):
        return "–"
    return f"{100 * value:.1f} %" if percent else f"{value:.3f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)
