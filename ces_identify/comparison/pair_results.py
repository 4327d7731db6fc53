"""Every two models of a comparison: the difference of their costs, and what may be said about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_identify.comparison.aligned_recording import AlignedRecording
from ces_identify.comparison.compared_model import TRAINED
from ces_identify.comparison.difference_errors import DifferenceErrors, Pair, all_pairs, find_differences
from ces_identify.comparison.holm import adjusted_p_values, step_levels

LEVEL = 0.95
BETTER, SAME, SHORT = "better", "cannot be told apart", "too short to know"
NO_TEST, DIVERGED = "not a test", "diverged"


@dataclass(frozen=True)
class Difference:
    """J of the first model minus J of the second [%], on `recordings`.

    The value is NaN if a model diverged; `low` and `high` are None where the recordings are too short to know.
    """

    recordings: tuple[str, ...]
    value: float
    low: float | None
    high: float | None

    def turned(self) -> Difference:
        """Return the same difference, second minus first."""
        low, high = (None if end is None else -end for end in (self.high, self.low))
        return replace(self, value=-self.value, low=low, high=high)


@dataclass(frozen=True)
class PairResult:
    """Two models compared: `first` and `second` are their indices.

    `pooled` is over the recordings on which no model of the comparison was identified; without any, over those on which
    neither of the two was, else over all. Its interval is at the level of its step in Holm's procedure. `each` holds
    the difference on each recording, with plain 95 % intervals. `verdict` is one of BETTER, SAME, SHORT, NO_TEST and
    DIVERGED; `better` is the index of the better model, None if neither is. `p_value` is Holm's adjusted one, None
    without a test. `text` says it in a sentence.
    """

    first: int
    second: int
    pooled: Difference
    each: tuple[Difference, ...]
    p_value: float | None
    verdict: str
    better: int | None
    text: str

    def minus(self, model: int) -> Difference:
        """Return the pooled difference as J of the other model minus J of `model`, one of the two."""
        if model == self.second:
            return self.pooled
        return self.pooled.turned()


def compare_pairs(
    names: Sequence[str], recordings: Sequence[AlignedRecording], uses: Sequence[Sequence[str]]
) -> list[PairResult]:
    """Return every pair of the models `names`; `uses` says what each model did with each recording.

    The pairs that can be tested are tested together, by Holm's procedure.
    """
    pairs = all_pairs(range(len(names)))
    common = _find_tests(uses, range(len(names)))
    tests = {pair: common or _find_tests(uses, pair) for pair in pairs}
    used = {pair: [recordings[i] for i in tests[pair] or range(len(recordings))] for pair in pairs}
    errors = _find_errors(used)
    tested = [pair for pair, one in errors.items() if tests[pair] and one.error is not None]
    p_values = [errors[pair].p_value() for pair in tested]
    levels = dict(zip(tested, step_levels(p_values, 1.0 - LEVEL), strict=True))
    adjusted = dict(zip(tested, adjusted_p_values(p_values), strict=True))
    single = [_find_errors({pair: [recording] for pair in pairs}) for recording in recordings]
    return [
        _pair_result(
            pair,
            names,
            _difference(used[pair], errors.get(pair), levels.get(pair, 1.0 - LEVEL)),
            tuple(_difference([r], one.get(pair), 1.0 - LEVEL) for r, one in zip(recordings, single, strict=True)),
            adjusted.get(pair),
            bool(tests[pair]),
        )
        for pair in pairs
    ]


def _find_tests(uses: Sequence[Sequence[str]], models: Sequence[int]) -> list[int]:
    """Return the recordings on which none of these models was identified."""
    return [i for i in range(len(uses[0])) if all(uses[model][i] != TRAINED for model in models)]


def _find_errors(used: dict[Pair, list[AlignedRecording]]) -> dict[Pair, DifferenceErrors]:
    """Return the errors of every pair that has not diverged on its recordings."""
    groups: dict[tuple[int, ...], list[Pair]] = {}
    for pair, recordings in used.items():
        if not any(r.diverged[model] for r in recordings for model in pair):
            groups.setdefault(tuple(map(id, recordings)), []).append(pair)
    return {
        pair: one
        for pairs in groups.values()
        for pair, one in zip(pairs, find_differences(used[pairs[0]], pairs), strict=True)
    }


def _difference(recordings: Sequence[AlignedRecording], errors: DifferenceErrors | None, level: float) -> Difference:
    names = tuple(r.name for r in recordings)
    if errors is None:
        return Difference(names, float("nan"), None, None)
    low, high = (None, None) if errors.is_too_short(level) else errors.interval(1.0 - level)
    return Difference(names, errors.value, low, high)


def _pair_result(
    pair: Pair,
    names: Sequence[str],
    pooled: Difference,
    each: tuple[Difference, ...],
    p_value: float | None,
    is_test: bool,
) -> PairResult:
    verdict = _find_verdict(pooled, is_test)
    better = (pair[1] if pooled.value > 0.0 else pair[0]) if verdict == BETTER else None
    text = _describe(pooled, verdict, [names[model] for model in pair])
    return PairResult(*pair, pooled, each, p_value, verdict, better, text)


def _find_verdict(pooled: Difference, is_test: bool) -> str:
    if np.isnan(pooled.value):
        return DIVERGED
    if not is_test:
        return NO_TEST
    if pooled.low is None or pooled.high is None:
        return SHORT
    return BETTER if pooled.low > 0.0 or pooled.high < 0.0 else SAME


def _describe(pooled: Difference, verdict: str, names: Sequence[str]) -> str:
    first, second = names
    better, worse = (second, first) if pooled.value > 0.0 else (first, second)
    texts = {
        BETTER: f"{better} is better than {worse}",
        SAME: f"{first} and {second} cannot be told apart",
        SHORT: f"too short to know whether {first} and {second} differ",
        NO_TEST: "not a test: one of them was identified on each recording",
        DIVERGED: "no difference: a free run diverged",
    }
    return texts[verdict]
