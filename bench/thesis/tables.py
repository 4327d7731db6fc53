"""Tables 5.1 to 5.3 of the thesis on the virtual rig (synthetic data), and its figure 5.3.

    python -m bench.thesis.tables [--seconds S] [--processes N]

Each experiment is run twice with different seeds: models are identified on the first run and evaluated on the second,
once by the thesis' procedure, once by ours (proved stable). Prints tables; the figure goes to docs/img. Trained models
are stored in out/tables: a rerun is cheap, an interrupted run continues.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

from bench.markdown import markdown
from bench.thesis.costs import (
    FOLDER,
    Evaluations,
    Outcomes,
    cells,
    evaluate_all,
    make_job,
    noise_floor,
    percent,
)
from bench.thesis.models import (
    NAMES,
    OURS,
    POLYNOMIAL,
    PUBLISHED,
    ROOT,
    TABLES,
    THESIS,
    ThesisRow,
    TrainingJob,
    format_size,
    load_named_experiment,
    processors,
    train_all,
)
from bench.thesis.plots import draw
from ces_rig.experiments.virtual import run

STORE = ROOT / "out" / "tables"
FIGURE = ROOT / "docs/img/thesis_5_3.png"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="time limit of the search for a model [s]")
    parser.add_argument("--processes", type=int, default=processors(), help="models trained in parallel")
    options = parser.parse_args()
    outcomes = train_all(jobs(), options.seconds, options.processes, STORE)
    names = {row.target for table in TABLES.values() for row in table.rows}
    recordings = {name: run(load_named_experiment(f"{FOLDER}/{name}", fresh=True)) for name in sorted(names)}
    evaluations = evaluate_all(outcomes, recordings)
    print("\n\n".join([facts(outcomes, options.seconds), *sections(evaluations)]))
    draw(evaluations, FIGURE)


def jobs() -> list[TrainingJob]:
    """Return all models of the tables, each once, the largest first."""
    return sorted({make_job(*cell) for cell in cells()}, key=lambda job: (-sum(job.size), str(job)))


def sections(evaluations: Evaluations) -> Iterator[str]:
    """Yield each table under its heading."""
    for structure, table in TABLES.items():
        yield f"### Table {table.number}: {table.title}"
        yield format_table(structure, evaluations)


def format_table(structure: str, evaluations: Evaluations) -> str:
    """Return one of the thesis' tables as Markdown."""
    table = TABLES[structure]
    procedures = (PUBLISHED, THESIS, OURS) if structure == POLYNOMIAL else (THESIS, OURS)
    heads = [f"{NAMES[procedure]} J %" for procedure in procedures]
    rows = [["row", table.size, "thesis J %", *heads, "noise floor J %"]]
    for row in table.rows:
        costs = [format_cell(evaluations, (structure, procedure, row)) for procedure in procedures]
        published = "unstable" if row.cost is None else f"{row.cost:g}"
        floor = f"{noise_floor(f'{FOLDER}/{row.target}'):.2f}"
        rows.append([row.title, format_size(row), published, *costs, floor])
    return markdown(rows)


def format_cell(evaluations: Evaluations, cell: tuple[str, str, ThesisRow]) -> str:
    """Return the cost of a cell; "-" where the thesis publishes no regressors."""
    return percent(evaluations[cell]) if cell in evaluations else "-"


def facts(outcomes: Outcomes, seconds: float) -> str:
    """Return the number of searches that reached the time limit, and the largest gain of the proved models."""
    cut = sum(outcome.seconds >= job.limit_s(seconds) for job, outcome in outcomes.items())
    ours = [o.model for job, o in outcomes.items() if job.procedure == OURS and o.model]
    gains = [model.certificate["gain"] for model in ours if model.certificate]
    return (
        f"A search may take {seconds:g} s of one core. {cut} of {len(outcomes)} "
        f"took all of it: for these a faster machine may find better ones. The gain of our models is at most "
        f"{max(gains):.3f} (proved)."
    )


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("\ninterrupted: finished models are stored; run it again to continue")
