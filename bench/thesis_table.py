"""Table 5.1 of the thesis on the virtual rig (synthetic data): its figures beside ours, by its procedure.

Usage: python bench/thesis_table.py [--seconds S]. Each experiment is run twice with different seeds; a model of at
most 11 terms is identified on the first run alone and judged on the second: once by the thesis' procedure (random
forward selection, least squares, no certificate), once by this project's defaults (certified).
"""

from __future__ import annotations

import argparse
import os

from ces_identify.cost import series_cost
from ces_identify.identify import Options, identify
from ces_identify.limits import BOTH, RANDOM, Limits
from ces_identify.recording import Recording
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
    sources = ("sine_4hz", "sweep", "noise")
    first = {name: run(described(name, fresh=False)) for name in sources}
    fresh = {name: described(name, fresh=True) for name in sources}
    thesis = {name: identified(first[name], RANDOM, False, seconds) for name in sources}
    ours = {name: identified(first[name], BOTH, True, seconds) for name in sources}
    print(
        "| row | thesis J % | its procedure here J % | our defaults J % | noise floor J % |\n|---|---:|---:|---:|---:|"
    )
    for title, source, target, figure in ROWS:
        recording, floor = run(fresh[target]), floors(fresh[target])[0]
        costs = (judged(models[source], recording) for models in (thesis, ours))
        print(f"| {title} | {figure} | {' | '.join(f'{j:.1f}' for j in costs)} | {floor:.2f} |")


def identified(recording: Recording, method: str, certify: bool, seconds: float) -> Model:
    """Return the model of at most TERMS terms identified on one recording."""
    limits = Limits(TERMS, seconds, starts=24, threads=os.cpu_count() or 1, method=method)
    return identify([recording], (), Options(split=1.0, limits=limits, certify=certify)).model


if __name__ == "__main__":
    main()
