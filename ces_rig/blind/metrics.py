"""Rates, quantiles, means and the calibration of probabilities, with 95 % intervals that hold for few cases, too.

Cases are drawn independently of each other, so that nothing of the errors of recordings (`numerics/sum_error.py`)
applies here. An end of an interval that so few cases do not bound is infinite.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf, isfinite, nan, sqrt

import numpy as np
from scipy.stats import binom, norm, t

from ces_data.arrays import F
from ces_rig.blind.outcome import CLASSES, IDENTIFIED, NONE, UNKNOWN, CaseOutcome

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


def rate(hits: Sequence[bool], cases: int | None = None) -> Statistic:
    """Return the share of hits with Wilson's interval (J. Am. Stat. Assoc. 22, 1927).

    Several hits of one case are not independent: with the number of `cases`, the interval is that of so many.
    """
    if not hits:
        return Statistic()
    share = sum(hits) / len(hits)
    return Statistic(share, len(hits), wilson_interval(share, len(hits) if cases is None else cases))


def wilson_interval(share: float, count: int) -> Interval:
    """Return Wilson's interval of a share of `count` independent trials."""
    z2 = float(norm.isf(TAIL)) ** 2
    middle = (share + 0.5 * z2 / count) / (1.0 + z2 / count)
    half = sqrt(z2 * (share * (1.0 - share) / count + 0.25 * z2 / count**2)) / (1.0 + z2 / count)
    return max(middle - half, 0.0), min(middle + half, 1.0)


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


def mean(values: Sequence[float]) -> Statistic:
    """Return the mean with Student's interval, which one case does not bound."""
    cases = np.asarray(values, np.float64)
    n = len(cases)
    if not n:
        return Statistic()
    middle, half = float(cases.mean()), float(t.isf(TAIL, n - 1) * cases.std(ddof=1) / sqrt(n)) if n > 1 else inf
    return Statistic(middle, n, (middle - half, middle + half))


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


def brier(probability: F, right: F) -> Statistic:
    """Return the mean over cases of the squared distance of probabilities from the truth, each (cases, candidates)."""
    return mean(np.sum((probability - right) ** 2, axis=1).tolist())


Cases = Sequence[CaseOutcome]
Count = Callable[[Cases], Statistic]

LIBRARY = ("effect", "pair")
KINDS_WITH_GAP = ("effect", "pair", "outside")
TARGET_GAP = 3.0  # the targets apply from this gap-to-noise ratio on


@dataclass(frozen=True)
class Metric:
    """A figure of a set of cases, `percent` if it is a share; `targets` are by class of mode, in the order of CLASSES.

    One target holds for all classes. `short` is its heading in the tables IN_SUMMARY and IN_SLICES.
    """

    name: str
    count: Count
    targets: tuple[float | None, ...] = ()
    target_is_minimum: bool = True
    percent: bool = True
    shown: tuple[str, ...] = ()
    short: str = ""

    def target(self, class_name: str) -> float | None:
        """Return the target of a class of modes, if it has one."""
        targets = self.targets if len(self.targets) > 1 else self.targets * len(CLASSES)
        return dict(zip(CLASSES, targets, strict=False)).get(class_name)

    def format(self, value: float) -> str:
        """Return a value of the figure as text, a dash if it is not finite."""
        return "–" if not isfinite(value) else f"{100 * value:.1f} %" if self.percent else f"{value:.3f}"

    def describe(self, figure: Statistic, class_name: str = "") -> tuple[str, str, str, str]:
        """Return value, interval, cases, a class's target and whether it is met (undecided inside the interval)."""
        (low, high), target, goal = figure.interval, self.target(class_name), ""
        if target is not None:
            at_least = self.target_is_minimum
            met, missed = (low >= target, high < target) if at_least else (high <= target, low > target)
            decided = "met" if met else "**not met**" if missed else "undecided"
            goal = f"{'≥' if at_least else '≤'} {self.format(target)} {decided}"
        return self.format(figure.value), f"{self.format(low)} to {self.format(high)}", str(figure.count), goal


def cases_with_targets(cases: Cases) -> list[CaseOutcome]:
    """Return the cases that the targets apply to: a gap of at least 3 x noise, and with an identified model a gap of
    at least its own error on the held-out recording."""
    return [
        case
        for case in cases
        if case.gap_to_noise >= TARGET_GAP
        and not (case.mode.simulation == IDENTIFIED and case.gap_N < case.figures.get("error_N", 0.0) and case.truth)
    ]


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
    claimed = [[sum(c.probability.get(one, 0.0) for one in _claims(c, name)) for name in names] for c in single]
    right = [[float(case.answer == name) for name in names] for case in single]
    return np.array(claimed).reshape(len(single), len(names)), np.array(right).reshape(len(single), len(names))


def _claims(case: CaseOutcome, name: str) -> Collection[str]:
    """Return the candidates whose probabilities are claimed for one: all that are right for the answer."""
    if name == case.answer:
        return case.accepted
    return () if name in case.accepted else (name,)


def _count_covered(cases: Cases) -> Statistic:
    comparable = [case.covered for case in cases_of_kind(cases, *LIBRARY) if case.covered]
    return rate([hit for covered in comparable for hit in covered], cases=len(comparable))


def _top_calibration(cases: Cases) -> Statistic:
    claimed, right = candidates(cases)
    if not len(claimed):
        return Statistic()
    rows, first = np.arange(len(claimed)), np.argmax(claimed, axis=1)
    return calibration_error(claimed[rows, first][:, None], right[rows, first][:, None])


IN_SUMMARY, IN_SLICES = "summary", "slices"
BOTH = (IN_SUMMARY, IN_SLICES)
_median, _tenth, _ninetieth = (partial(quantile, share=share) for share in (0.5, 0.1, 0.9))
METRICS: tuple[Metric, ...] = (
    Metric("top-1", _count_hits(("effect",), lambda c: c.is_in_top(1)), (0.95, 0.90, 0.85, 0.90), shown=BOTH),
    Metric("top-1 without `calibration`", _count_hits(("effect",), CaseOutcome.is_first_effect)),
    Metric("top-1 by class", _count_hits(("effect",), CaseOutcome.is_first_by_class), (0.97, 0.95, 0.92, 0.95),
           shown=BOTH, short="class"),
    Metric("top-3", _count_hits(("effect",), lambda c: c.is_in_top(3)), (0.99, 0.97, 0.96, 0.97), shown=BOTH),
    Metric("verdict names exactly the effect", _count_hits(("effect",), CaseOutcome.names_exactly), (0.85,),
           shown=(IN_SUMMARY,), short="named exactly"),
    Metric("named, and not the cause", _count_hits(KINDS_WITH_GAP, CaseOutcome.is_named_wrongly),
           (0.02, 0.03, 0.05, 0.03), False, shown=BOTH, short="named, not the cause"),
    Metric("verdict `no_gap` although there is a gap", _count_hits(KINDS_WITH_GAP, lambda c: c.verdict == "no_gap"),
           target_is_minimum=False),
    Metric("confidently wrong", _count_hits((*KINDS_WITH_GAP, NONE), CaseOutcome.is_confidently_wrong),
           target_is_minimum=False),
    Metric("false alarms", _count_hits((NONE,), CaseOutcome.is_false_alarm), (0.02, 0.03, 0.05, 0.03), False,
           shown=BOTH),
    Metric("outside called `unknown`", _count_hits(("outside",), lambda c: c.verdict == UNKNOWN),
           (0.85, 0.75, 0.65, 0.75), shown=BOTH, short="outside unknown"),
    Metric("library called `unknown`", _count_hits(LIBRARY, lambda c: c.verdict == UNKNOWN), (0.05, None, None, None),
           False, shown=(IN_SLICES,), short="library unknown"),
    Metric("both of a pair", _count_hits(("pair",), CaseOutcome.finds_exactly), (0.85, 0.75, 0.60, 0.75), shown=BOTH,
           short="pairs"),
    Metric("both of a pair by class", _count_hits(("pair",), CaseOutcome.finds_by_class)),
    Metric("one of a pair first", _count_hits(("pair",), lambda c: c.is_in_top(1))),
    Metric("closure, median", _summarize_figure("closure", LIBRARY, _median)),
    Metric("closure / oracle, median", _summarize_figure("relative", LIBRARY, _median), (0.95, 0.90, 0.85, 0.85),
           percent=False, shown=BOTH, short="closure / oracle"),
    Metric("closure / oracle, 10th percentile", _summarize_figure("relative", LIBRARY, _tenth),
           (0.75, 0.60, 0.50, 0.50), percent=False, shown=(IN_SUMMARY,), short="10th percentile"),
    Metric("closure of the oracle, median", _summarize_figure("oracle", LIBRARY, _median)),
    Metric("closure of the oracle without correction, median", _summarize_figure("plain_oracle", LIBRARY, _median)),
    Metric("abs(claimed − true shrink), median", _summarize_figure("shrink_error", LIBRARY, _median), (0.05,), False,
           False, BOTH, "shrink error"),
    Metric("abs(claimed − true shrink), 90th percentile", _summarize_figure("shrink_error", LIBRARY, _ninetieth),
           (0.15,), False, False, (IN_SUMMARY,), "90th percentile"),
    Metric("parameters within their 95 % interval", _count_covered, (0.90,), shown=(IN_SUMMARY,),
           short="parameters covered"),
    Metric("`where`: misplaced energy over direction, mean",
           _summarize_figure("where_direction", KINDS_WITH_GAP, mean), target_is_minimum=False),
    Metric("`where`: misplaced energy over speed, mean", _summarize_figure("where_speed_m_s", KINDS_WITH_GAP, mean),
           target_is_minimum=False),
    Metric("ECE of the first candidate", _top_calibration, (0.05,), False, False, BOTH, "ECE"),
    Metric("ECE of all candidates", lambda cases: calibration_error(*candidates(cases)), (), False, False),
    Metric("Brier score", lambda cases: brier(*candidates(cases)), (), False, False),
)  # fmt: skip
BY_NAME: Mapping[str, Metric] = {metric.name: metric for metric in METRICS}


def baselines(cases: Cases) -> dict[str, Statistic]:
    """Return the top-1 rates of the simpler methods in the results, and of drawing a cause at random."""
    effects = cases_of_kind(cases, "effect")
    names = sorted({name for case in effects for name in case.baselines})
    rates = {name: rate([c.baselines[name] in c.truth for c in effects if name in c.baselines]) for name in names}
    rng = np.random.default_rng(0)
    hits = [bool(case.ranked) and case.ranked[int(rng.integers(len(case.ranked)))] in case.truth for case in effects]
    return {**rates, "one drawn at random": rate(hits)}
