"""Tables 5.1 to 5.3 of the thesis on the virtual rig (synthetic data), and plots 5.1 to 5.8.

Usage: python -m bench.thesis.tables [--seconds S] [--processes N] [--dry]. Each experiment is run twice with different
seeds: models are identified on the first run and evaluated on the second, once by the thesis' procedure, once by
ours (the defaults, proved stable). A fourth table evaluates one model of noise and sweep on unseen recordings, beside
the damper itself driven with the same estimates. Tables go between the markers in docs/results.md and docs/rig.md,
plots to docs/img. Trained models are stored in out/tables: a rerun is cheap, an interrupted run continues.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Mapping
from functools import cache

from bench.markdown import between, markdown, replace_between
from bench.thesis.models import (
    ANFIS,
    BY_THESIS,
    NETWORK,
    OURS,
    POLYNOMIAL,
    ROOT,
    ROWS,
    SEVERAL,
    THESIS,
    Evaluations,
    TrainingJob,
    TrainingOutcome,
    load_named_experiment,
    processors,
    train_jobs,
)
from bench.thesis.noise_floor import noise_floors
from bench.thesis.plant import plant_cost
from bench.thesis.plots import draw_all, figures
from ces_identify.preparation.series import prepare
from ces_identify.recordings.recording import Recording
from ces_identify.validation.evaluate import VALIDATION, Evaluation, evaluate
from ces_rig.experiment import run

STORE = ROOT / "out" / "tables"
RESULTS, RIG, IMAGES = ROOT / "docs/results.md", ROOT / "docs/rig.md", ROOT / "docs/img"
PLACES = ((RESULTS, "thesis tables"), (RESULTS, "one model"), (RIG, "identification table"))
UNKNOWN = "not available to us"

SOURCES = ("sine_4hz", "sweep", "noise")
TABLES = {POLYNOMIAL: "5.1", NETWORK: "5.2", ANFIS: "5.3"}
TITLES = {POLYNOMIAL: "polynomial NARX", NETWORK: "sigmoid network NARX", ANFIS: "neuro-fuzzy (ANFIS)"}
KNOWN = {POLYNOMIAL: ("2.34", "6.92", "14.79", "63.8", "136")}  # J [%] of the thesis' table 5.1, row by row

WIDE_SOURCES, WIDE_TERMS = ("noise", "sweep"), (25, 40)
WIDE_TARGETS = ("sine_4hz", "sine_12hz", "road", "noise", "sweep")

Outcomes = Mapping[TrainingJob, TrainingOutcome]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="time limit of the search for a model [s]")
    parser.add_argument("--processes", type=int, default=processors(), help="models trained in parallel")
    parser.add_argument("--dry", action="store_true", help="print the tables without changing docs/")
    options = parser.parse_args()
    for path, name in PLACES:
        between(path, name)  # fails before the long work
    outcomes = train_all(options.seconds, options.processes)
    recordings = {name: run(load_named_experiment(name, fresh=True)) for name in WIDE_TARGETS}
    judged = evaluate_all(outcomes, recordings)
    tables = "\n\n".join([facts(outcomes, options.seconds), *sections(judged)])
    one_model = one_model_table(outcomes, recordings)
    print(f"\n{tables}\n\n{one_model}")
    if not options.dry:
        draw_all(judged, IMAGES)
        for (path, name), text in zip(PLACES, (tables, one_model, table(POLYNOMIAL, judged)), strict=True):
            replace_between(path, name, text)
        print(f"\nwritten: {RESULTS}, {RIG}, {IMAGES}/thesis_5_*.png")


def jobs() -> list[TrainingJob]:
    """Return all models of the tables, the longest searches first."""
    wide = [TrainingJob(POLYNOMIAL, OURS, WIDE_SOURCES, terms) for terms in reversed(WIDE_TERMS)]
    narrow = [TrainingJob(s, p, (source,)) for s in TABLES for p in (OURS, THESIS) for source in SOURCES]
    return wide + narrow


def train_all(seconds: float, processes: int) -> dict[TrainingJob, TrainingOutcome]:
    """Return the outcome of every job and print each; stored ones come first."""
    requested, outcomes = jobs(), {}
    print(f"{len(requested)} models, {processes} in parallel, at most {seconds:g} s of search each", flush=True)
    for job, outcome in train_jobs(requested, seconds, processes, STORE):
        outcomes[job] = outcome
        size = outcome.model.size if outcome.model else outcome.why_none
        print(f"[{len(outcomes):2}/{len(requested)}] {outcome.seconds:4.0f} s  {job}: {size}", flush=True)
    return outcomes


def evaluate_all(outcomes: Outcomes, recordings: Mapping[str, Recording]) -> Evaluations:
    """Return the evaluation of every cell on the fresh run of its row."""
    return {
        (structure, procedure, row): evaluate_outcome(
            outcomes[TrainingJob(structure, procedure, (row.source,))], recordings[row.target]
        )
        for structure in TABLES
        for procedure in (THESIS, OURS)
        for row in ROWS
    }


def evaluate_outcome(outcome: TrainingOutcome, recording: Recording) -> Evaluation | None:
    if outcome.model is None:
        return None
    return evaluate(outcome.model, [prepare(recording, outcome.model.sampling)], VALIDATION)[0]


def table(structure: str, evaluations: Evaluations) -> str:
    """Return one of the thesis' tables as Markdown."""
    known = KNOWN.get(structure, (UNKNOWN,) * len(ROWS))
    rows = [["row", "thesis J %", f"{BY_THESIS[structure]} here J %", "ours J %", "noise floor J %"]]
    for row, figure in zip(ROWS, known, strict=True):
        cells = [percent(evaluations[structure, procedure, row]) for procedure in (THESIS, OURS)]
        rows.append([row.title, figure, *cells, f"{noise_floor(row.target):.2f}"])
    return markdown(rows)


def sections(evaluations: Evaluations) -> Iterator[str]:
    """Yield each table under its heading, with its plots."""
    for structure, number in TABLES.items():
        yield f"### Table {number}: {TITLES[structure]}"
        yield table(structure, evaluations)
        for plot, rows in figures(ROWS).items():
            if rows[0] == structure:
                shown = ", ".join(row.title for row in rows[1])
                yield f"![Plot 5.{plot}: {TITLES[structure]}, {shown}](img/thesis_5_{plot}.png)"


def one_model_table(outcomes: Outcomes, recordings: Mapping[str, Recording]) -> str:
    """Return the table of one certified model for every experiment, beside the damper on the same estimates."""
    models = [outcomes[TrainingJob(POLYNOMIAL, OURS, WIDE_SOURCES, terms)] for terms in WIDE_TERMS]
    sampling = next((o.model.sampling for o in models if o.model), None)
    if sampling is None:
        return f"No model was found: {models[0].why_none}."
    rows = [["recording", *(f"{n} terms J %" for n in WIDE_TERMS), "the damper itself J %", "ratio", "noise floor J %"]]
    for name, recording in recordings.items():
        judged = [evaluate_outcome(o, recording) for o in models]
        plant = plant_cost(load_named_experiment(name, fresh=True), prepare(recording, sampling))
        ratio = f"{judged[-1].cost / plant:.2f}" if judged[-1] else "-"
        unseen = " (another run)" if name in WIDE_SOURCES else ""
        rows.append([name + unseen, *map(percent, judged), f"{plant:.2f}", ratio, f"{noise_floor(name):.2f}"])
    speed = f"differentiator of order {sampling.order} at {sampling.bandwidth_Hz:g} Hz"
    sizes = " and ".join(o.model.size if o.model else o.why_none for o in models)
    return f'{markdown(rows)}\n\n{sizes}, {speed}; "ratio" is the last model over the damper itself.'


def facts(outcomes: Outcomes, seconds: float) -> str:
    """Return the number of searches that reached the time limit, and the largest gain of the proved models."""
    cut = sum(outcome.seconds >= job.limit_s(seconds) for job, outcome in outcomes.items())
    gains = [o.model.certificate["gain"] for o in outcomes.values() if o.model and o.model.certificate]
    return (
        f"`make tables SECONDS={seconds:g}`: a search may take {seconds:g} s of one core, {SEVERAL} times that for the "
        f"models from two experiments. {cut} of {len(outcomes)} took all of it: for these a faster machine may find "
        f"better ones. In our models past forces count for at most {max(gains):.3f} (proved)."
    )


@cache
def noise_floor(name: str) -> float:
    """Return J [%] of the noise-free force against the measured one, on the fresh run."""
    return noise_floors(load_named_experiment(name, fresh=True))[0]


def percent(evaluation: Evaluation | None) -> str:
    if evaluation is None:
        return "none stable"
    return f"{evaluation.cost:.2f}" if math.isfinite(evaluation.cost) else "diverged"


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("\ninterrupted: finished models are stored; run it again to continue")
