"""Every two models compared: the difference of their costs with its error, and what it says.

All pairs that can be tested are tested together, with Holm's correction (Scandinavian Journal of Statistics 6, 1979).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ces_data.arrays import F
from ces_identify.comparison.compared_models import TRAINED, AlignedRecording
from ces_identify.limits import ComparisonLimits, ErrorLimits
from ces_identify.numerics.correlation import SumError, add_errors, estimate_sum_error, sum_bins

BETTER, SAME, SHORT = "better", "cannot be told apart", "too short to know"
NO_TEST, DIVERGED = "not a test", "diverged"


def adjusted_p_values(p_values: Sequence[float]) -> list[float]:
    """Return Holm's adjusted p-values, in the same order: a test is significant at a level if its value is below it."""
    adjusted, largest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(np.argsort(p_values, kind="stable")):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[int(i)] = largest
    return adjusted


def step_levels(p_values: Sequence[float], alpha: float) -> list[float]:
    """Return for each test the significance level of Holm's step that decided it.

    An interval of 1 - that level excludes zero exactly if Holm's procedure at `alpha` calls the test significant: after
    the first test that is not, all further ones share its level.
    """
    levels, level, going = [alpha] * len(p_values), alpha, True
    for rank, i in enumerate(np.argsort(p_values, kind="stable")):
        if going:
            level = alpha / (len(p_values) - rank)
            going = p_values[i] < level
        levels[int(i)] = level
    return levels


Pair = tuple[int, int]


@dataclass(frozen=True)
class DifferenceErrors:
    """A difference of J [%], first minus second model, over `seconds`; `error` is None with a recording too short.

    A difference up to `rounding` [%] is none.
    """

    value: float
    error: SumError | None
    seconds: float
    rounding: float

    @property
    def is_rounding(self) -> bool:
        """Whether the difference is no more than rounding, as that of a model and its own FMU."""
        return abs(self.value) <= self.rounding

    def p_value(self) -> float:
        """Return the p-value that the true difference is zero; 1 without an error, or for rounding."""
        return 1.0 if self.error is None or self.is_rounding else self.error.p_value(self.value)

    def interval(self, level: float) -> tuple[float, float]:
        """Return the interval [%] that holds the true value by `level` (0 to 1); endless without an error."""
        half = np.inf if self.error is None else self.error.half_width(level)
        half = max(half, abs(self.value)) if self.is_rounding else half
        return float(self.value - half), float(self.value + half)

    def is_too_short(self, alpha: float) -> bool:
        """Return whether a longer recording may find a difference at the level `alpha` that this one cannot show.

        So it is if there are fewer than MIN_SECONDS, or if the difference would count, were nothing slow possible.
        """
        if self.error is None:
            return True
        if self.is_rounding or self.p_value() < alpha:
            return False
        return self.seconds < ComparisonLimits.MIN_SECONDS or self.error.fast_p_value(self.value) < alpha


def pooled_costs(recordings: Sequence[AlignedRecording]) -> F:
    """Return J [%] of each model (models,) over all recordings, each force relative to its recording's mean."""
    squares = sum((r.errors**2).sum(axis=1) for r in recordings)
    return np.asarray(100.0 * np.sqrt(squares / sum(map(_spread, recordings))))


def find_differences(recordings: Sequence[AlignedRecording], pairs: Sequence[Pair]) -> list[DifferenceErrors]:
    """Return the difference of pooled J, with its error, for each pair of models; none of them may have diverged."""
    costs, seconds = pooled_costs(recordings), sum(r.seconds for r in recordings)
    influences = [influence_of_bins(r, costs, sum(map(_spread, recordings))) for r in recordings]
    enough = all(one.shape[1] >= ErrorLimits.MIN_BINS for one in influences)
    found = []
    for first, second in pairs:
        sums = (
            estimate_sum_error(x[first] - x[second], r.seconds) for x, r in zip(influences, recordings, strict=True)
        )
        error = add_errors(list(sums)) if enough else None
        rounding = ErrorLimits.ROUNDING * float(max(costs[first], costs[second]))
        found.append(DifferenceErrors(float(costs[first] - costs[second]), error, seconds, rounding))
    return found


def _spread(recording: AlignedRecording) -> float:
    force = recording.measured[recording.scored]
    return float(((force - force.mean()) ** 2).sum())


def influence_of_bins(recording: AlignedRecording, costs: F, spread: float) -> F:
    """Return the influence [%] of each bin of BIN_S on the pooled cost of each model (models, bins).

    J = 100 sqrt(S / Y) with the sums S of squared errors and Y = `spread`: dJ = J / 2 (dS / S - dY / Y).
    """
    force = recording.measured[recording.scored]
    squares = sum_bins(recording.errors**2, recording.rate_Hz)
    of_force = sum_bins((force - force.mean()) ** 2, recording.rate_Hz)
    per_square = 0.5 * 100.0**2 / np.maximum(costs, 1e-300) / spread  # J / (2 S)
    return np.asarray(per_square[:, None] * squares - 0.5 * costs[:, None] * of_force / spread)


@dataclass(frozen=True)
class Difference:
    """J of the first model minus J of the second [%], on `recordings`.

    The value is NaN if a model diverged; `low` and `high` are None where the recordings are too short to know.
    """

    recordings: tuple[str, ...]
    value: float
    low: float | None
    high: float | None


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
        low, high = (None if end is None else -end for end in (self.pooled.high, self.pooled.low))
        return Difference(self.pooled.recordings, -self.pooled.value, low, high)


def compare_pairs(
    names: Sequence[str], recordings: Sequence[AlignedRecording], uses: Sequence[Sequence[str]]
) -> list[PairResult]:
    """Return every pair of the models `names`; `uses` says what each model did with each recording.

    The pairs that can be tested are tested together, by Holm's procedure.
    """
    pairs, alpha = list(combinations(range(len(names)), 2)), 1.0 - ErrorLimits.LEVEL
    common = _find_tests(uses, range(len(names)))
    tests = {pair: common or _find_tests(uses, pair) for pair in pairs}
    used = {pair: [recordings[i] for i in tests[pair] or range(len(recordings))] for pair in pairs}
    errors = _find_errors(used)
    tested = [pair for pair, one in errors.items() if tests[pair] and one.error is not None]
    p_values = [errors[pair].p_value() for pair in tested]
    levels = dict(zip(tested, step_levels(p_values, alpha), strict=True))
    adjusted = dict(zip(tested, adjusted_p_values(p_values), strict=True))
    single = [_find_errors({pair: [recording] for pair in pairs}) for recording in recordings]
    return [
        _pair_result(
            pair,
            names,
            _difference(used[pair], errors.get(pair), levels.get(pair, alpha)),
            tuple(
                _difference([r], errors_there.get(pair), alpha)
                for r, errors_there in zip(recordings, single, strict=True)
            ),
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
    first, second = (names[model] for model in pair)
    better, worse = pair[::-1] if pooled.value > 0.0 else pair
    if np.isnan(pooled.value):
        verdict, text = DIVERGED, "no difference: a free run diverged"
    elif not is_test:
        verdict, text = NO_TEST, "not a test: one of them was identified on each recording"
    elif pooled.low is None or pooled.high is None:
        verdict, text = SHORT, f"too short to know whether {first} and {second} differ"
    elif pooled.low > 0.0 or pooled.high < 0.0:
        verdict, text = BETTER, f"{names[better]} is better than {names[worse]}"
    else:
        verdict, text = SAME, f"{first} and {second} cannot be told apart"
    return PairResult(*pair, pooled, each, p_value, verdict, better if verdict == BETTER else None, text)
