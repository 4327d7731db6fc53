"""What is counted over a set of cases: each figure by name, with its target where the project has set one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_cli.blind.outcome import NONE, UNKNOWN, Outcome
from ces_cli.blind.statistics import Figure, brier, calibration_error, mean, quantile, rate, resampled

F = NDArray[np.float64]
Cases = Sequence[Outcome]
Count = Callable[[Cases], Figure]


@dataclass(frozen=True)
class Metric:
    """A figure of a set of cases: `percent` if it is a share; `target` with references, and from predictions only."""

    name: str
    count: Count
    percent: bool = True
    least: bool = True
    target: float | None = None
    target_predictions: float | None = None


def of(cases: Cases, *kinds: str) -> list[Outcome]:
    """Return the cases of these kinds."""
    return [case for case in cases if case.kind in kinds]


def _on(kinds: tuple[str, ...], hit: Callable[[Outcome], bool]) -> Count:
    return lambda cases: rate([hit(case) for case in of(cases, *kinds)])


def _figures(name: str, kinds: tuple[str, ...], summary: Callable[[Sequence[float]], Figure]) -> Count:
    def count(cases: Cases) -> Figure:
        return summary([case.figures[name] for case in of(cases, *kinds) if name in case.figures])

    return count


def _median(values: Sequence[float]) -> Figure:
    return quantile(values, 0.5)


def _tenth(values: Sequence[float]) -> Figure:
    return quantile(values, 0.1)


def _ninetieth(values: Sequence[float]) -> Figure:
    return quantile(values, 0.9)


def candidates(cases: Cases) -> tuple[F, F]:
    """Return probabilities and truth, each (cases, candidates): every effect that was a candidate, none and unknown.

    Pairs are left out: neither of two effects is the cause.
    """
    judged = [case for case in cases if case.kind != "pair"]
    names = sorted({name for case in judged for name in (*case.probability, case.answer)})
    said = [[case.probability.get(name, 0.0) for name in names] for case in judged]
    right = [[float(case.answer == name) for name in names] for case in judged]
    return np.array(said).reshape(len(judged), len(names)), np.array(right).reshape(len(judged), len(names))


def _over_candidates(figure: Callable[[F, F], float]) -> Count:
    def count(cases: Cases) -> Figure:
        said, right = candidates(cases)
        return resampled(np.stack([said, right], axis=1), lambda part: figure(part[:, 0], part[:, 1]))

    return count


def _top_calibration(said: F, right: F) -> float:
    first = np.argmax(said, axis=1)
    rows = np.arange(len(said))
    return calibration_error(said[rows, first], right[rows, first])


def _every_calibration(said: F, right: F) -> float:
    return calibration_error(said.ravel(), right.ravel())


LIBRARY = ("effect", "pair")
GAPPED = ("effect", "pair", "outside")
METRICS: tuple[Metric, ...] = (
    Metric("top-1", _on(("effect",), lambda c: c.in_top(1)), target=0.90, target_predictions=0.80),
    Metric("top-1 by class", _on(("effect",), Outcome.first_by_class), target=0.97, target_predictions=0.90),
    Metric("top-3", _on(("effect",), lambda c: c.in_top(3)), target=0.99, target_predictions=0.95),
    Metric("verdict names exactly the effect", _on(("effect",), Outcome.named)),
    Metric("verdict `no_gap` although there is one", _on(GAPPED, lambda c: c.verdict == "no_gap"), least=False),
    Metric("confidently wrong", _on((*GAPPED, NONE), Outcome.confidently_wrong), least=False),
    Metric("false alarms", _on((NONE,), lambda c: c.verdict != "no_gap"), least=False, target=0.02),
    Metric("outside called `unknown`", _on(("outside",), lambda c: c.verdict == UNKNOWN), target=0.85),
    Metric("library called `unknown`", _on(LIBRARY, lambda c: c.verdict == UNKNOWN), least=False, target=0.05),
    Metric("both of a pair", _on(("pair",), Outcome.both), target=0.85),
    Metric("both of a pair by class", _on(("pair",), Outcome.both_by_class)),
    Metric("one of a pair first", _on(("pair",), lambda c: c.in_top(1))),
    Metric("closure, median", _figures("closure", LIBRARY, _median)),
    Metric("closure / oracle, median", _figures("relative", LIBRARY, _median), False, True, 0.95, 0.80),
    Metric("closure / oracle, 10th percentile", _figures("relative", LIBRARY, _tenth), False, True, 0.75, 0.50),
    Metric("closure of the oracle, median", _figures("oracle", LIBRARY, _median)),
    Metric("closure of the oracle without correction, median", _figures("plain_oracle", LIBRARY, _median)),
    Metric("abs(claimed − true shrink), median", _figures("shrink_error", LIBRARY, _median), False, False, 0.05),
    Metric("abs(claimed − true shrink), 90th percentile", _figures("shrink_error", LIBRARY, _ninetieth), False, False),
    Metric("`where`: misplaced energy over direction, mean", _figures("where_direction", GAPPED, mean), least=False),
    Metric("`where`: misplaced energy over speed, mean", _figures("where_speed_m_s", GAPPED, mean), least=False),
    Metric("ECE of the first candidate", _over_candidates(_top_calibration), False, False, 0.05),
    Metric("ECE of all candidates", _over_candidates(_every_calibration), False, False),
    Metric("Brier score", _over_candidates(brier), False, False),
)  # fmt: skip
BY_NAME: Mapping[str, Metric] = {metric.name: metric for metric in METRICS}


def baselines(cases: Cases) -> dict[str, Figure]:
    """Return the top-1 rate of simpler ways to name a cause: those the results carry, and drawing one at random."""
    effects = of(cases, "effect")
    names = sorted({name for case in effects for name in case.baselines})
    rates = {
        name: rate([case.baselines[name] in case.truth for case in effects if name in case.baselines]) for name in names
    }
    rng = np.random.default_rng(0)
    drawn = [bool(case.ranked) and case.ranked[int(rng.integers(len(case.ranked)))] in case.truth for case in effects]
    return {**rates, "one drawn at random": rate(drawn)}
