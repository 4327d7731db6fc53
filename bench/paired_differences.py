"""How often `ces compare` calls a difference significant, and other tests on the same errors: size and power.

    python -m bench.paired_differences [--runs 200] [--fresh] [--seconds 5 10 30 60 300] [--recordings 1] [--models 2]

Errors come from `bench.error_families`; --fresh takes those that no choice was made on. With equal true costs every
significant difference is a false one; with several models, a run is false if any of the pairs is (Holm's procedure).
The powers are those of finding the first model's own part of the error to be 1.5 and 3 times as large. Other tests:

    Diebold-Mariano   with the correction of Harvey, Leybourne & Newbold (1997), lags up to the errors' memory
    cosines           equal-weighted cosines, 0.4 T^(2/3) of them (Lazarus, Lewis, Stock & Watson 2018), T in 0.1 s
    8 cosines         the same with 8 of them
    fast              those of `ces compare`, without its bound on slow changes
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.fft import dct
from scipy.special import stdtr

from bench.error_families import CHOOSING, FRESH, ErrorFamily, make_recording
from ces_identify.comparison.aligned_recording import AlignedRecording
from ces_identify.comparison.difference_errors import find_differences, influence_of_bins, pooled_costs
from ces_identify.comparison.pair_results import BETTER, SHORT, compare_pairs
from ces_identify.numerics.arrays import F
from ces_identify.numerics.correlation import INSIGNIFICANT_IN_A_ROW, autocorrelation, longest_memory, memory

ALPHA = 0.05
RATIOS = (1.5, 3.0)
MIN_RUNS_OF_LONG = 100
Recordings = Sequence[AlignedRecording]


def compare_made(recordings: Recordings) -> tuple[float, bool]:
    """Return whether `ces compare` finds any difference, and the share of pairs that are too short to know."""
    models = len(recordings[0].forces)
    verdicts = [
        one.verdict
        for one in compare_pairs([str(i) for i in range(models)], recordings, [["test"] * len(recordings)] * models)
    ]
    return BETTER in verdicts, verdicts.count(SHORT) / len(verdicts)


def diebold_mariano(x: F, value: float) -> float:
    """Return the p-value of a sum x (n,) of influences, `value`."""
    n, runs = len(x), np.array([[0, len(x)]], dtype=np.int64)
    longest = longest_memory(n, runs)
    rho = autocorrelation(x, runs, longest + INSIGNIFICANT_IN_A_ROW)
    lags = max(memory(rho, n, longest), 1)
    weights = 1.0 - np.arange(1, lags + 1) / (lags + 1.0)
    variance = n * float(x.var()) * (1.0 + 2.0 * float(weights @ rho[1 : lags + 1]))
    small = (n + 1.0 - 2.0 * lags + lags * (lags - 1.0) / n) / n
    return float(2.0 * stdtr(n - 1, -abs(value) * np.sqrt(small / variance)))


def cosines(count: int | None) -> Callable[[F, float], float]:
    """Return the test with `count` cosines, or the number that is recommended."""

    def test(x: F, value: float) -> float:
        q = count or int(0.4 * (len(x) / 10) ** (2.0 / 3.0))
        squares = 0.5 * dct(x, type=2)[1 : q + 1] ** 2
        return float(2.0 * stdtr(q, -abs(value) / np.sqrt(squares.mean())))

    return test


OTHERS: Mapping[str, Callable[[F, float], float]] = {
    "Diebold-Mariano": diebold_mariano,
    "cosines": cosines(None),
    "8 cosines": cosines(8),
}


def p_values_of_others(recording: AlignedRecording) -> list[float]:
    """Return the p-value of each of the other tests for the first two models on one recording."""
    costs = pooled_costs([recording])
    force = recording.measured
    influence = influence_of_bins(recording, costs, float(((force - force.mean()) ** 2).sum()))
    (found,) = find_differences([recording], [(0, 1)])
    assert found.error is not None
    x = influence[0] - influence[1]
    return [*(test(x - x.mean(), found.value) for test in OTHERS.values()), found.error.fast_p_value(found.value)]


def count_outcomes(
    family: ErrorFamily, seconds: float, runs: int, options: argparse.Namespace, ratio: float
) -> tuple[F, float]:
    """Return the shares of runs with a difference found, by `ces compare` and the others, and of too short pairs."""
    random = np.random.default_rng([options.seed, round(seconds)])
    found, short = [], 0.0
    for _ in range(runs):
        recordings = [make_recording(family, seconds, options.models, random, ratio) for _ in range(options.recordings)]
        significant, share = compare_made(recordings)
        others = p_values_of_others(recordings[0]) if options.recordings == 1 and options.models == 2 else []
        found.append([significant, *(p < ALPHA for p in others)])
        short += share / runs
    return np.mean(found, axis=0), short


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, nargs="+", default=(5.0, 10.0, 30.0, 60.0, 300.0))
    parser.add_argument("--recordings", type=int, default=1)
    parser.add_argument("--models", type=int, default=2)
    parser.add_argument("--fresh", action="store_true")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of families")
    options = parser.parse_args()
    families = FRESH if options.fresh else CHOOSING
    single = options.recordings == 1 and options.models == 2
    names = ["compare", *((*OTHERS, "fast") if single else ())]
    heads = ["modulation", "tau s", "slow s", "s", *(f"{name} %" for name in names), "too short %"]
    print("| " + " | ".join([*heads, *(f"power at {ratio:g}: compare, 8 cosines %" for ratio in RATIOS)]) + " |")
    print("|---|" + "---:|" * (len(heads) - 1 + len(RATIOS)))
    for family in (families[i] for i in options.only or range(len(families))):
        for seconds in options.seconds:
            runs = options.runs if seconds < 100.0 else min(options.runs, MIN_RUNS_OF_LONG)
            false, short = count_outcomes(family, seconds, runs, options, 1.0)
            powers = [count_outcomes(family, seconds, runs, options, ratio)[0] for ratio in RATIOS]
            cells = [f"{100 * share:.1f}" for share in (*false, short)]
            cells += [", ".join(f"{100 * power[i]:.0f}" for i in ((0, 3) if single else (0,))) for power in powers]
            print(f"| {family} | {seconds:g} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
