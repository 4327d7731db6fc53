"""Tables 5.1 to 5.3 of the thesis on the virtual rig (synthetic data), and figures 5.1 to 5.8.

Usage: python -m bench.thesis.tables [--seconds S] [--processes N] [--dry]. Each experiment is run twice with different
seeds: models are identified on the first run and evaluated on the second, once by the thesis' procedure, once by
ours (proved stable). Tables go between the markers in docs/results.md, figures to docs/img. Trained models are stored
in out/tables: a rerun is cheap, an interrupted run continues.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

from bench.markdown import between, markdown, replace_between
from bench.thesis.costs import FOLDER, Evaluations, Outcomes, cells, evaluate_all, make_job, noise_floor, percent
from bench.thesis.models import (
    NAMES,
    OURS,
    PUBLISHED,
    ROOT,
    THESIS,
    TrainingJob,
    load_named_experiment,
    processors,
    train_all,
)
from bench.thesis.plots import caption, draw_all
from bench.thesis.rows import POLYNOMIAL, TABLES, ThesisRow, format_size, panels
from ces_rig.experiment import run

STORE = ROOT / "out" / "tables"
RESULTS, IMAGES, NAME = ROOT / "docs/results.md", ROOT / "docs/img", "thesis tables"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="time limit of the search for a model [s]")
    parser.add_argument("--processes", type=int, default=processors(), help="models trained in parallel")
    parser.add_argument("--dry", action="store_true", help="print the tables without changing docs/")
    options = parser.parse_args()
    between(RESULTS, NAME)  # fails before the long work
    outcomes = train_all(jobs(), options.seconds, options.processes, STORE)
    targets = {row.target for table in TABLES.values() for row in table.rows}
    recordings = {name: run(load_named_experiment(f"{FOLDER}/{name}", fresh=True)) for name in sorted(targets)}
    evaluations = evaluate_all(outcomes, recordings)
    text = "\n\n".join([facts(outcomes, options.seconds), *sections(evaluations)])
    print(f"\n{text}")
    if not options.dry:
        draw_all(evaluations, IMAGES)
        replace_between(RESULTS, NAME, text)
        print(f"\nwritten: {RESULTS}, {IMAGES}/thesis_5_*.png")


def jobs() -> list[TrainingJob]:
    """Return all models of the tables, each once, the largest first."""
    return sorted({make_job(*cell) for cell in cells()}, key=lambda job: (-sum(job.size), str(job)))


def sections(evaluations: Evaluations) -> Iterator[str]:
    """Yield each table under its heading, with its figures."""
    for structure, table in TABLES.items():
        yield f"### Table {table.number}: {table.title}"
        yield format_table(structure, evaluations)
        for number, pair in panels().items():
            if pair[0].structure == structure:
                yield f"![Figure {number}: {table.title}, {caption(pair)}](img/thesis_{number.replace('.', '_')}.png)"


def format_table(structure: str, evaluations: Evaluations) -> str:
    """Return one of the thesis' tables as Markdown."""
    table = TABLES[structure]
    procedures = (PUBLISHED, THESIS, OURS) if structure == POLYNOMIAL else (THESIS, OURS)
    heads = [f"{NAMES[procedure]} J %" for procedure in procedures]
    rows = [["row", table.size, "thesis J %", *heads, "noise floor J %", "figure"]]
    for row in table.rows:
        costs = [format_cell(evaluations, (structure, procedure, row)) for procedure in procedures]
        published = "unstable" if row.cost is None else f"{row.cost:g}"
        floor = f"{noise_floor(f'{FOLDER}/{row.target}'):.2f}"
        rows.append([row.title, format_size(row), published, *costs, floor, row.figure or "-"])
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
        f"`make tables SECONDS={seconds:g}`: a search may take {seconds:g} s of one core. {cut} of {len(outcomes)} "
        f"took all of it: for these a faster machine may find better ones. In our models past forces count for at most "
        f"{max(gains):.3f} (proved)."
    )


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("\ninterrupted: finished models are stored; run it again to continue")
