"""The metrics of a set of cases, by name, with the project's targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ces_cli.blind.mode import CLASSES, IDENTIFIED
from ces_cli.blind.outcome import NONE, UNKNOWN, CaseOutcome
from ces_cli.blind.statistics import Statistic, brier, calibration_error, mean, quantile, rate

F = NDArray[np.float64]
Cases = Sequence[CaseOutcome]
Count = Callable[[Cases], Statistic]

LIBRARY = ("effect", "pair")
KINDS_WITH_GAP = ("effect", "pair", "outside")
TARGET_GAP = 3.0  # the targets apply from this gap-to-noise ratio on


@dataclass(frozen=True)
class Metric:
    """A figure of a set of cases, `percent` if it is a share; `targets` are by class of mode (`mode.CLASSES`)."""

    name: str
    count: Count
    percent: bool = True
    target_is_minimum: bool = True
    targets: Mapping[str, float] = field(default_factory=dict)


def _targets(*values: float) -> Mapping[str, float]:
    """Return the targets of all classes, in their order; one value holds for all."""
    return dict(zip(CLASSES, values * len(CLASSES) if len(values) == 1 else values, strict=True))


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


def _count_covered(cases: Cases) -> Statistic:
    comparable = [case.covered for case in cases_of_kind(cases, *LIBRARY) if case.covered]
    return rate([hit for covered in comparable for hit in covered], cases=len(comparable))


def candidates(cases: Cases) -> tuple[F, F]:
    """Return probabilities and truth, each (cases, candidates), for all candidate effects, none and unknown.

    Pairs are left out: neither of two effects is the only cause. Where several candidates are right, their
    probabilities are added.
    """
    single = [case for case in cases if case.kind != "pair"]
    names = sorted({name for case in single for name in (*case.probability, case.answer)})
    claimed = [[_claim(case, name) for name in names] for case in single]
    right = [[float(case.answer == name) for name in names] for case in single]
    return np.array(claimed).reshape(len(single), len(names)), np.array(right).reshape(len(single), len(names))


def _claim(case: CaseOutcome, name: str) -> float:
    if name == case.answer:
        return sum(case.probability.get(accepted, 0.0) for accepted in case.accepted)
    return 0.0 if name in case.accepted else case.probability.get(name, 0.0)


def _over_candidates(figure: Callable[[F, F], Statistic]) -> Count:
    return lambda cases: figure(*candidates(cases))


def _top_calibration(claimed: F, right: F) -> Statistic:
    if not len(claimed):
        return calibration_error(claimed, right)
    rows, first = np.arange(len(claimed)), np.argmax(claimed, axis=1)
    return calibration_error(claimed[rows, first][:, None], right[rows, first][:, None])


_median, _tenth, _ninetieth = (partial(quantile, share=share) for share in (0.5, 0.1, 0.9))
METRICS: tuple[Metric, ...] = (
    Metric("top-1", _count_hits(("effect",), lambda c: c.is_in_top(1)), targets=_targets(0.95, 0.90, 0.85, 0.90)),
    Metric("top-1 without `calibration`", _count_hits(("effect",), CaseOutcome.is_first_effect)),
    Metric("top-1 by class", _count_hits(("effect",), CaseOutcome.is_first_by_class),
    targets=_targets(0.97, 0.95, 0.92, 0.95)),
    Metric("top-3", _count_hits(("effect",), lambda c: c.is_in_top(3)), targets=_targets(0.99, 0.97, 0.96, 0.97)),
    Metric("verdict names exactly the effect", _count_hits(("effect",), CaseOutcome.names_exactly),
    targets=_targets(0.85)),
    Metric("named, and not the cause", _count_hits(KINDS_WITH_GAP, CaseOutcome.is_named_wrongly),
    target_is_minimum=False, targets=_targets(0.02, 0.03, 0.05, 0.03)),
    Metric("verdict `no_gap` although there is a gap", _count_hits(KINDS_WITH_GAP, lambda c: c.verdict == "no_gap"),
    target_is_minimum=False),
    Metric("confidently wrong", _count_hits((*KINDS_WITH_GAP, NONE), CaseOutcome.is_confidently_wrong),
    target_is_minimum=False),
    Metric("false alarms", _count_hits((NONE,), CaseOutcome.is_false_alarm), target_is_minimum=False,
    targets=_targets(0.02, 0.03, 0.05, 0.03)),
    Metric("outside called `unknown`", _count_hits(("outside",), lambda c: c.verdict == UNKNOWN),
    targets=_targets(0.85, 0.75, 0.65, 0.75)),
    Metric("library called `unknown`", _count_hits(LIBRARY, lambda c: c.verdict == UNKNOWN), target_is_minimum=False,
    targets={"references": 0.05}),
    Metric("both of a pair", _count_hits(("pair",), CaseOutcome.finds_exactly),
    targets=_targets(0.85, 0.75, 0.60, 0.75)),
    Metric("both of a pair by class", _count_hits(("pair",), CaseOutcome.finds_by_class)),
    Metric("one of a pair first", _count_hits(("pair",), lambda c: c.is_in_top(1))),
    Metric("closure, median", _summarize_figure("closure", LIBRARY, _median)),
    Metric("closure / oracle, median", _summarize_figure("relative", LIBRARY, _median), False,
    targets=_targets(0.95, 0.90, 0.85, 0.85)),
    Metric("closure / oracle, 10th percentile", _summarize_figure("relative", LIBRARY, _tenth), False,
    targets=_targets(0.75, 0.60, 0.50, 0.50)),
    Metric("closure of the oracle, median", _summarize_figure("oracle", LIBRARY, _median)),
    Metric("closure of the oracle without correction, median", _summarize_figure("plain_oracle", LIBRARY, _median)),
    Metric("abs(claimed − true shrink), median", _summarize_figure("shrink_error", LIBRARY, _median), False, False,
    _targets(0.05)),
    Metric("abs(claimed − true shrink), 90th percentile", _summarize_figure("shrink_error", LIBRARY, _ninetieth),
    False, False, _targets(0.15)),
    Metric("parameters within their 95 % interval", _count_covered, targets=_targets(0.90)),
    Metric("`where`: misplaced energy over direction, mean", _summarize_figure("where_direction", KINDS_WITH_GAP,
    mean), target_is_minimum=False),
    Metric("`where`: misplaced energy over speed, mean", _summarize_figure("where_speed_m_s", KINDS_WITH_GAP, mean),
    target_is_minimum=False),
    Metric("ECE of the first candidate", _over_candidates(_top_calibration), False, False, _targets(0.05)),
    Metric("ECE of all candidates", _over_candidates(calibration_error), False, False),
    Metric("Brier score", _over_candidates(brier), False, False),
)  # fmt: skip
BY_NAME: Mapping[str, Metric] = {metric.name: metric for metric in METRICS}


def baselines(cases: Cases) -> dict[str, Statistic]:
    """Return the top-1 rates of the simpler methods in the results, and of drawing a cause at random."""
    effects = cases_of_kind(cases, "effect")
    names = sorted({name for case in effects for name in case.baselines})
    rates = {
        name: rate([case.baselines[name] in case.truth for case in effects if name in case.baselines]) for name in names
    }
    rng = np.random.default_rng(0)
    hits = [bool(case.ranked) and case.ranked[int(rng.integers(len(case.ranked)))] in case.truth for case in effects]
    return {**rates, "one drawn at random": rate(hits)}
