"""Rates, quantiles and calibration of probabilities, with 95 % intervals that hold for few cases; tables of them.

Cases are drawn independently of each other, so that nothing of the errors of recordings (`numerics/sum_error.py`)
applies here. An end of an interval that so few cases do not bound is infinite.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf, isfinite, nan, sqrt
from typing import Any

import numpy as np
from scipy.stats import binom, norm

from ces_data.arrays import F
from ces_report.table import Column, Table
from ces_rig.blind.scoring import CLASSES, NONE, UNKNOWN, CaseOutcome

LEVEL = 0.95
TAIL = 0.5 * (1.0 - LEVEL)
BINS = 10
Interval = tuple[float, float]


@dataclass(frozen=True)
class Statistic:
    """A figure, its number of cases and its 95 % interval, all NaN if there are no cases."""

    value: float = nan
    count: int = 0
    interval: Interval = (nan, nan)


def rate(hits: Sequence[bool]) -> Statistic:
    """Return the share of hits with Wilson's interval (J. Am. Stat. Assoc. 22, 1927)."""
    if not hits:
        return Statistic()
    count, z2 = len(hits), float(norm.isf(TAIL)) ** 2
    share = sum(hits) / count
    middle = (share + 0.5 * z2 / count) / (1.0 + z2 / count)
    half = sqrt(z2 * (share * (1.0 - share) / count + 0.25 * z2 / count**2)) / (1.0 + z2 / count)
    return Statistic(share, count, (max(middle - half, 0.0), min(middle + half, 1.0)))


def quantile(values: Sequence[float], share: float) -> Statistic:
    """Return a quantile with the interval between two of the ordered values, whatever their distribution.

    The number of values below the true quantile is binomial (Conover, Practical Nonparametric Statistics, section 3.2).
    """
    ordered, n = np.sort(np.asarray(values, np.float64)), len(values)
    if not n:
        return Statistic()
    below = int(binom.ppf(TAIL, n, share))  # fewer than these are too few
    above = int(binom.isf(TAIL, n, share))  # more than these are too many
    interval = (float(ordered[below - 1]) if below > 0 else -inf, float(ordered[above]) if above < n else inf)
    return Statistic(float(np.quantile(ordered, share)), n, interval)


def calibration_error(probability: F, right: F) -> Statistic:
    """Return the expected calibration error in ten equal bins of probabilities (cases, candidates) against the truth.

    It is the sum of the bins' absolute differences between claimed and true shares. Of few cases it is above zero even
    if the probabilities are right. By the triangle inequality it misses the true one by no more than the sum of the
    bins' absolute errors; these are taken as normal and independent.
    """
    n = len(probability)
    if not n:
        return Statistic()
    parts = _sum_in_bins(probability, probability - right) / probability.size  # (cases, bins)
    value = float(np.abs(parts.sum(axis=0)).sum())
    of_sums = np.sqrt(n) * parts.std(axis=0, ddof=1) if n > 1 else np.abs(parts[0])  # standard errors (bins,)
    # those of the true shares, by Laplace's rule: few equal cases vary, too
    count, hits = (_sum_in_bins(probability, v).sum(axis=0) for v in (np.ones_like(right), right))
    share = (hits + 1.0) / (count + 2.0)
    errors = np.maximum(of_sums, np.sqrt(count * share * (1.0 - share)) / probability.size)
    half = sqrt(2.0 / np.pi) * errors.sum() + norm.isf(TAIL) * sqrt(1.0 - 2.0 / np.pi) * np.hypot.reduce(errors)
    return Statistic(value, n, (max(value - float(half), 0.0), value + float(half)))


def _sum_in_bins(probability: F, values: F) -> F:
    """Return the sums (cases, bins) of the values of each case by the bin of their probabilities."""
    bins = np.minimum((probability * BINS).astype(int), BINS - 1)
    return np.stack([np.where(bins == b, values, 0.0).sum(axis=1) for b in range(BINS)], axis=1)


Cases = Sequence[CaseOutcome]
Count = Callable[[Cases], Statistic]

LIBRARY = ("effect", "pair")
KINDS_WITH_GAP = ("effect", "pair", "outside")


@dataclass(frozen=True)
class Metric:
    """A figure of a set of cases, `percent` if it is a share; `targets` are by class of mode, in the order of CLASSES.

    One target holds for all classes.
    """

    name: str
    count: Count
    targets: tuple[float | None, ...] = ()
    target_is_minimum: bool = True
    percent: bool = True

    def target(self, class_name: str) -> float | None:
        """Return the target of a class of modes, if it has one."""
        targets = self.targets if len(self.targets) > 1 else self.targets * len(CLASSES)
        return dict(zip(CLASSES, targets, strict=False)).get(class_name)

    def format(self, value: float) -> str:
        """Return a value of the figure as text, a dash if it is not finite."""
        return "–" if not isfinite(value) else f"{100 * value:.1f} %" if self.percent else f"{value:.3f}"

    def describe(self, figure: Statistic, class_name: str = "") -> str:
        """Return value, interval, cases, a class's target and whether it is met (undecided inside the interval)."""
        if not figure.count:
            return "–"
        (low, high), target = figure.interval, self.target(class_name)
        text = f"{self.format(figure.value)} ({self.format(low)} to {self.format(high)}; {figure.count})"
        if target is None:
            return text
        at_least = self.target_is_minimum
        met, missed = (low >= target, high < target) if at_least else (high <= target, low > target)
        decided = "met" if met else "**not met**" if missed else "undecided"
        return f"{text}; {'≥' if at_least else '≤'} {self.format(target)} {decided}"


def cases_of_kind(cases: Cases, *kinds: str) -> list[CaseOutcome]:
    """Return the cases of these kinds."""
    return [case for case in cases if case.kind in kinds]


def _count_hits(kinds: tuple[str, ...], hit: Callable[[CaseOutcome], bool]) -> Count:
    return lambda cases: rate([hit(case) for case in cases_of_kind(cases, *kinds)])


def _summarize_figure(name: str, kinds: tuple[str, ...], summary: Callable[[Sequence[float]], Statistic]) -> Count:
    def count(cases: Cases) -> Statistic:
        return summary([case.figures[name] for case in cases_of_kind(cases, *kinds) if name in case.figures])

    return count


def candidates(cases: Cases) -> tuple[F, F]:
    """Return probabilities and truth, each (cases, candidates), for all candidate effects, none and unknown.

    Pairs are left out: neither of two effects is the only cause. Where several candidates are right, their
    probabilities are added.
    """
    single = [case for case in cases if case.kind != "pair"]
    names = sorted({name for case in single for name in (*case.probability, case.answer)})
    claimed = [[sum(c.probability.get(claim, 0.0) for claim in _claims(c, name)) for name in names] for c in single]
    right = [[float(case.answer == name) for name in names] for case in single]
    return np.array(claimed).reshape(len(single), len(names)), np.array(right).reshape(len(single), len(names))


def _claims(case: CaseOutcome, name: str) -> Collection[str]:
    """Return the candidates whose probabilities are claimed for one: all that are right for the answer."""
    if name == case.answer:
        return case.accepted
    return () if name in case.accepted else (name,)


def _top_calibration(cases: Cases) -> Statistic:
    claimed, right = candidates(cases)
    if not len(claimed):
        return Statistic()
    rows, first = np.arange(len(claimed)), np.argmax(claimed, axis=1)
    return calibration_error(claimed[rows, first][:, None], right[rows, first][:, None])


_median, _tenth = (partial(quantile, share=share) for share in (0.5, 0.1))
METRICS: tuple[Metric, ...] = (
    Metric("first", _count_hits(("effect",), lambda c: c.is_in_top(1)), (0.94, 0.85, 0.90, 0.80)),
    Metric("first, or indistinguishable from the first", _count_hits(("effect",), CaseOutcome.is_first_by_class)),
    Metric("among the first three", _count_hits(("effect",), lambda c: c.is_in_top(3))),
    Metric("named wrong", _count_hits(KINDS_WITH_GAP, CaseOutcome.is_named_wrongly), (0.02, 0.03, 0.02, 0.03), False),
    Metric("false alarms", _count_hits((NONE,), CaseOutcome.is_false_alarm), (0.0, 0.05, 0.0, 0.05), False),
    Metric("outside unknown", _count_hits(("outside",), lambda c: c.verdict == UNKNOWN), (0.85, 0.85, 0.85, 0.75)),
    Metric("pairs (both found)", _count_hits(("pair",), CaseOutcome.finds_exactly), (0.75, 0.60, 0.70, 0.50)),
    Metric("true shrink, median", _summarize_figure("closure", LIBRARY, _median), (0.88, 0.82, 0.85, 0.75)),
    Metric("true shrink, 10th percentile", _summarize_figure("closure", LIBRARY, _tenth), (0.65, 0.50, 0.60, 0.45)),
    Metric("abs(claimed − true shrink), median", _summarize_figure("shrink_error", LIBRARY, _median), (0.05,), False,
           False),
    Metric("calibration error", _top_calibration, (0.06, 0.06, 0.06, 0.08), False, False),
)  # fmt: skip


Group = tuple[str, Cases]  # cases and what they have in common


def metric_table(title: str, groups: Mapping[str, Cases]) -> Table[Group]:
    """Return one row per group of cases: each metric with its interval, the number of cases, and the target."""

    def column_of(metric: Metric) -> Column[Group]:
        return Column(metric.name, lambda group: metric.describe(metric.count(group[1]), group[1][0].mode.class_name))

    names = (Column[Group](title, lambda group: group[0]), Column[Group]("cases", lambda group: str(len(group[1]))))
    return Table([*names, *map(column_of, METRICS)], list(groups.items()))


def group_cases(cases: Cases, key: Callable[[CaseOutcome], object]) -> dict[str, list[CaseOutcome]]:
    """Return the cases by the text of a property, in its order."""
    groups: dict[str, list[CaseOutcome]] = {}
    for case in sorted(cases, key=lambda case: str(key(case))):
        groups.setdefault(str(key(case)), []).append(case)
    return groups


def withheld_table(cases: Cases) -> Table[Group]:
    """Return for everything that was withheld the verdicts, and what was most probable."""
    groups = group_cases(cases, lambda case: f"{case.kind}: {' + '.join(case.truth)}".removesuffix(": "))
    columns: tuple[Column[Group], ...] = (
        Column("withheld", lambda group: group[0]),
        Column("verdicts", lambda group: _format_counts([case.verdict for case in group[1]])),
        Column("first", lambda group: _format_counts([*case.ranked, "nothing"][0] for case in group[1])),
    )
    return Table(columns, list(groups.items()))


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
