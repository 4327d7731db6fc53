"""The spread of the thesis' procedure: single runs of its selection on the noise, each with another random order.

Usage: python -m bench.thesis.single_runs [--runs N] [--processes N]. Prints a Markdown table: J on the noise (another
run) and on the 4 Hz sine. The tables have the best of 24 by the cost on the selection ticks.
"""

from __future__ import annotations

import argparse

import numpy as np
from joblib import Parallel, delayed, parallel_config

from bench.markdown import markdown
from bench.thesis.costs import FOLDER, evaluate_outcome, make_job
from bench.thesis.models import THESIS, TrainingOutcome, load_named_experiment, processors
from bench.thesis.rows import POLYNOMIAL, TABLES
from ces_identify.identification import identify
from ces_identify.polynomial.search_limits import THESIS as TO_THE_LETTER
from ces_identify.polynomial.search_limits import Limits
from ces_identify.structures.kit import IdentifyOptions
from ces_observer.errors import CesError
from ces_rig.experiment import run

ROWS = [row for row in TABLES[POLYNOMIAL].rows if row.source == "noise"]
SECONDS = 300.0  # limit of a run, which ends before, when its list is empty


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=12, help="number of runs")
    parser.add_argument("--processes", type=int, default=processors(), help="runs in parallel")
    options = parser.parse_args()
    with parallel_config("loky", n_jobs=options.processes, inner_max_num_threads=1):
        costs = np.array(Parallel()(delayed(single_run)(seed) for seed in range(1, options.runs + 1)))
    rows = [["row", "smallest J %", "median J %", "largest J %"]]
    for row, column in zip(ROWS, costs.T, strict=True):
        rows.append([row.title, *(f"{cost:.2f}" for cost in (column.min(), np.median(column), column.max()))])
    print(markdown(rows))


def single_run(seed: int) -> list[float]:
    """Return J [%] of each row for the model of one run; infinite if it has none or is unstable."""
    job = make_job(POLYNOMIAL, THESIS, ROWS[0])
    limits = Limits(job.size[0], SECONDS, starts=1, seed=seed, threads=1, method=TO_THE_LETTER)
    recordings = [run(load_named_experiment(name, fresh=False)) for name in job.sources]
    try:
        model = identify(recordings, (), IdentifyOptions(split=1.0, limits=limits, certify=False)).model
    except CesError:
        return [float("inf")] * len(ROWS)
    fresh = [run(load_named_experiment(f"{FOLDER}/{row.target}", fresh=True)) for row in ROWS]
    found = [evaluate_outcome(TrainingOutcome(model, "", 0.0), recording, clamped=False) for recording in fresh]
    return [evaluation.cost for evaluation in found if evaluation]


if __name__ == "__main__":
    main()
