"""How often the 95 % interval of a cost J (`ces validate`, `identify`, campaigns) holds the true cost: coverage.

    python -m bench.cost_intervals [--runs 200] [--seconds 5 10 30 60] [--recordings 1] [--only 0 8]

Errors and forces come from `bench.error_families`. The true cost is that of a recording of 28 hours of the same family.
*Holds* is the share of the intervals that hold it, *above* and *below* the shares where it lies outside, *none* the
share of the runs in which no interval is given because it would reach beyond three times the cost. *Upper end* is the
median of the interval's upper end, relative to the cost. With --recordings, the cost is pooled over several.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from bench.error_families import CHOOSING, FRESH, ErrorFamily, make_recording
from ces_identify.comparison.aligned_recording import AlignedRecording
from ces_identify.comparison.difference_errors import pooled_costs
from ces_identify.validation.cost_interval import CostInterval, ScoredTicks, interval_of_ticks

TRUTH_S = 100_000.0


def find_interval(recordings: Sequence[AlignedRecording]) -> CostInterval | None:
    """Return the interval of the first model's cost."""
    return interval_of_ticks([ScoredTicks(r.errors[0] ** 2, r.measured, r.rate_Hz) for r in recordings])


def count_outcomes(family: ErrorFamily, truth: float, seconds: float, options: argparse.Namespace) -> list[str]:
    """Return the cells of a row: holds, above, below, none [%] and the median upper end."""
    random = np.random.default_rng([options.seed, round(seconds)])
    found, ends = [], []
    for _ in range(options.runs):
        recordings = [make_recording(family, seconds, 1, random) for _ in range(options.recordings)]
        interval = find_interval(recordings)
        if interval is not None:
            found.append((interval.low <= truth <= interval.high, truth > interval.high, truth < interval.low))
            ends.append(interval.high / float(pooled_costs(recordings)[0]))
    none = f"{100.0 * (1.0 - len(found) / options.runs):.0f}"
    if not found:
        return ["–", "–", "–", none, "–"]
    return [*(f"{100.0 * share:.1f}" for share in np.mean(found, axis=0)), none, f"{np.median(ends):.2f}"]


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, nargs="+", default=(5.0, 10.0, 30.0, 60.0))
    parser.add_argument("--recordings", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of families")
    options = parser.parse_args()
    families = CHOOSING + FRESH
    print("| modulation | tau s | slow s | s | holds % | above % | below % | none % | upper end |")
    print("|---|" + "---:|" * 8)
    for family in (families[i] for i in options.only or range(len(families))):
        truth = float(pooled_costs([make_recording(family, TRUTH_S, 1, np.random.default_rng(options.seed))])[0])
        for seconds in options.seconds:
            print(
                f"| {family} | {seconds:g} | {' | '.join(count_outcomes(family, truth, seconds, options))} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
