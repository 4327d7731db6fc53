"""One certified model from noise and sweep, evaluated on recordings that it never saw, beside the damper itself.

Usage: python -m bench.thesis.one_model [--seconds S] [--processes N] [--dry]. The table goes between the markers in
docs/results.md. Trained models are stored in out/tables.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping

from bench.markdown import between, markdown, replace_between
from bench.thesis.costs import Outcomes, evaluate_outcome, noise_floor, percent
from bench.thesis.models import OURS, TrainingJob, load_named_experiment, processors, train_all
from bench.thesis.plant import plant_cost
from bench.thesis.rows import POLYNOMIAL
from bench.thesis.tables import RESULTS, STORE
from ces_identify.preparation.series import prepare
from ces_identify.recordings.recording import Recording
from ces_rig.experiment import run

NAME = "one model"
SOURCES, TERMS = ("noise", "sweep"), (25, 40)
TARGETS = ("sine_4hz", "sine_12hz", "road", "noise", "sweep")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="a quarter of the time limit of a search [s]")
    parser.add_argument("--processes", type=int, default=processors(), help="models trained in parallel")
    parser.add_argument("--dry", action="store_true", help="print the table without changing docs/")
    options = parser.parse_args()
    between(RESULTS, NAME)  # fails before the long work
    outcomes = train_all(jobs(), options.seconds, options.processes, STORE)
    table = format_table(outcomes, {name: run(load_named_experiment(name, fresh=True)) for name in TARGETS})
    print(f"\n{table}")
    if not options.dry:
        replace_between(RESULTS, NAME, table)


def jobs() -> list[TrainingJob]:
    """Return the two models, the larger first."""
    return [TrainingJob(POLYNOMIAL, OURS, SOURCES, (terms,)) for terms in reversed(TERMS)]


def format_table(outcomes: Outcomes, recordings: Mapping[str, Recording]) -> str:
    """Return the costs of both models on every recording, beside the damper on the same estimates."""
    models = [outcomes[job] for job in reversed(jobs())]
    sampling = next((o.model.sampling for o in models if o.model), None)
    if sampling is None:
        return f"No model was found: {models[0].why_none}."
    rows = [["recording", *(f"{n} terms J %" for n in TERMS), "the damper itself J %", "ratio", "noise floor J %"]]
    for name, recording in recordings.items():
        judged = [evaluate_outcome(o, recording) for o in models]
        plant = plant_cost(load_named_experiment(name, fresh=True), prepare(recording, sampling))
        ratio = f"{judged[-1].cost / plant:.2f}" if judged[-1] else "-"
        unseen = " (another run)" if name in SOURCES else ""
        rows.append([name + unseen, *map(percent, judged), f"{plant:.2f}", ratio, f"{noise_floor(name):.2f}"])
    speed = f"differentiator of order {sampling.order} at {sampling.bandwidth_Hz:g} Hz"
    sizes = " and ".join(o.model.size if o.model else o.why_none for o in models)
    return f'{markdown(rows)}\n\n{sizes}, {speed}; "ratio" is the last model over the damper itself.'


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("\ninterrupted: finished models are stored; run it again to continue")
