"""Table 5.1 of the thesis on the virtual rig (synthetic data): its figures beside ours, by its procedure.

Usage: python bench/thesis_table.py [--seconds S]. Each experiment is run twice with different seeds; a model of at
most 11 terms is identified on the first run alone, by random forward selection, and judged on the second.
"""

from __future__ import annotations

import argparse
import os

from ces_identify.cost import series_cost
from ces_identify.identify import Options, identify
from ces_identify.recording import Recording
from ces_identify.selection import Limits
from ces_identify.series import prepare
from ces_identify.simulate import simulate_series
from ces_observer.model import Model
from ces_rig.experiment import Experiment, find_experiment, load_experiment, reseeded, run
from ces_rig.floor import floors

TERMS = 11
ROWS = (
    ("4 Hz sine", "sine_4hz", "sine_4hz", "2.3"),
    ("sweep 2-16 Hz", "sweep", "sweep", "6.9"),
    ("low-pass noise", "noise", "noise", "14.8"),
    ("4 Hz sine on the sweep model", "sweep", "sine_4hz", "64"),
    ("4 Hz sine on the noise model", "noise", "sine_4hz", "136"),
)


def described(name: str, fresh: bool) -> Experiment:
    """Return a packaged experiment, with another seed if `fresh`."""
    experiment = load_experiment(find_experiment(name))
    return reseeded(experiment, experiment.settings.seed + 1000) if fresh else experiment


def judged(model: Model, recording: Recording) -> float:
    """Return J [%] of the model's free run on the recording."""
    series = prepare(recording, model.sampling)
    return series_cost(series, simulate_series(model, series).force)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="most seconds of search for each model")
    seconds = parser.parse_args().seconds
    limits = Limits(TERMS, seconds, starts=16, threads=os.cpu_count() or 1)
    first = {name: run(described(name, fresh=False)) for name in ("sine_4hz", "sweep", "noise")}
    fresh = {name: described(name, fresh=True) for name in first}
    models = {n: identify([r], (), Options(split=1.0, limits=limits)).model for n, r in first.items()}
    print("| row | thesis J % | ours J % | noise floor J % | terms |\n|---|---|---|---|---|")
    for title, source, target, thesis in ROWS:
        j, floor = judged(models[source], run(fresh[target])), floors(fresh[target])[0]
        print(f"| {title} | {thesis} | {j:.1f} | {floor:.2f} | {len(models[source].terms)} |")


if __name__ == "__main__":
    main()
