"""`ces characterise`: the charts and tables of a damper dyno from recordings, with simulations beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import HELP, open_simulation, print_findings, with_predictions
from ces_cli.terminal.options import BAGS, PageRequest, only_with, option
from ces_cli.terminal.outputs import print_document
from ces_data.arrays import F
from ces_data.bags.find import find_bags
from ces_data.outputs import OUT, require_outputs
from ces_data.recording import describe_days
from ces_data.signals_file import load_signals
from ces_identify.characteristics.characterise import characterise
from ces_identify.characteristics.page import (
    PAGE,
    judged_table,
    missing_packages,
    peak_table,
    range_table,
    response_table,
    work_table,
    write_characteristics,
)
from ces_identify.characteristics.rows import Characteristics
from ces_identify.characteristics.rules import load_rules
from ces_identify.comparison.comparison import name_sources
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError, OptionName
from ces_observer.records import declare
from ces_report.shell import PageHead
from ces_report.table import Table

FOLDER = f"folder for the page ({PAGE}), CSV files, a workbook and figures"
MAX_ROWS = 24  # of a table in the terminal


@dataclass(frozen=True, kw_only=True)
class CharacteriseRequest(PageRequest):
    """Show what a damper dyno shows: force over speed for each current (at the peak speed and continuous), loops, work
    per cycle, hysteresis, and how the valve responds to steps of the current; with simulations over the same recordings
    beside them. Sines, triangles and slow sweeps at constant currents give all of it, any other motion gives quantiles
    of the force over speed.
    """

    program = "characterise"
    example = "ces characterise bags/noise bags/sweep --model config/models/sample.json --out characteristics"
    option_rules = (only_with("title note", "out", "is for the page; add --out DIR"),)

    bags: tuple[str, ...] = declare(replace(BAGS, meaning="recordings with a measured force: bags, folders, globs"))
    model: tuple[str, ...] = option((), HELP, metavar="SIM")
    rules: Path | None = option(
        None, "rules of a bench: which cycles, where in the stroke, limits", metavar="FILE.yaml"
    )
    out: Path | None = option(None, FOLDER, metavar="DIR")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    request = terminal.read(CharacteriseRequest, argv)
    require_outputs(request.overwrite, folders={OUT: request.out})
    rules = load_rules(request.rules)
    signals = load_signals(request.signals)
    simulations = _open_simulations(request.model)
    recordings = {
        path: terminal.read_one(path, signals, terminal.FORCE, request.part) for path in find_bags(request.bags)
    }
    findings = print_findings(list(recordings.values()))
    forces: dict[str, list[F]] = {}
    for name, simulation in simulations.items():
        with terminal.step(f"simulating {name} ({len(forces) + 1} of {len(simulations)})"):
            forces[name] = [
                simulation.force(with_predictions(simulation, p, r, signals)) for p, r in recordings.items()
            ]
    with terminal.step("characterising"):
        results = characterise(list(recordings.values()), simulations=forces, rules=rules)
    if request.out is not None:
        command, recorded = terminal.command_line("characterise", argv), describe_days(recordings.values())
        head = PageHead(request.title, request.note, command, recorded)
        with terminal.step(f"writing {request.out}"):
            page, *others = write_characteristics(request.out, results, head)
        for line in filter(None, (f"{page} and {len(others)} files beside it", missing_packages())):
            terminal.err.print(line, highlight=False, soft_wrap=True)
    if request.json:
        print_document("characterise", {**asdict(results), "findings": findings})
    else:
        _print_results(results)
    return 0


def _open_simulations(specs: Sequence[str]) -> dict[str, Simulation]:
    """Return the simulations by short names; raises CesError for one that cannot be opened or is given twice."""
    repeated = {spec for spec in specs if specs.count(spec) > 1}
    if repeated:
        raise CesError(OptionName("model", min(repeated)), ": given twice; expected each simulation once")
    return {name: open_simulation(spec) for name, spec in zip(name_sources(specs), specs, strict=True)}


def _print_results(results: Characteristics) -> None:
    makers = (peak_table, range_table, work_table, response_table, judged_table)
    tables: list[Table[Any]] = [make(results) for make in makers]
    for table in tables:
        if table.rows:
            rest = len(table.rows) - MAX_ROWS if table.rows is not results.responses else 0
            shown = terminal.lay_out(replace(table, rows=table.rows[:MAX_ROWS]) if rest > 0 else table)
            shown.caption = f"and {rest} more rows: --out DIR writes all" if rest > 0 else None
            terminal.print_table(shown)
    for omission in results.omissions:
        count = f"{omission.count} of {omission.of} {omission.subject}" if omission.of else omission.subject
        where = "" if omission.recording == "all" else f"{omission.recording}: "
        terminal.print_line(f"{where}{count}: {omission.reason}")
