"""`ces characterise`: the charts and tables of a damper dyno from recordings, with simulations beside them."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from ces_cli.terminal import terminal
from ces_cli.terminal.bag_paths import find_bags
from ces_cli.terminal.findings import print_findings
from ces_cli.terminal.json_output import add_json, print_document
from ces_cli.terminal.outputs import add_overwrite, require_new_folder
from ces_cli.terminal.simulations import HELP, open_simulation, with_predictions
from ces_identify.characteristics.characterise import characterise
from ces_identify.characteristics.folder import PAGE, write_characteristics
from ces_identify.characteristics.page import number, peak_cells, response_cells, with_spread, work_cells
from ces_identify.characteristics.results import Characteristics
from ces_identify.numerics.arrays import F
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError
from ces_observer.signals import Signals

MAX_ROWS = 24  # of a table in the terminal
TITLE_REST = ", equivalent damping, hysteresis at zero speed, rebound over compression"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
    require_new_folder(options.out, options.overwrite)
    signals = terminal.load_described_signals(options)
    simulations = _open_simulations(options.model)
    paths = find_bags(options.bags)
    recordings = [terminal.read_one(path, signals, terminal.FORCE) for path in paths]
    found = print_findings(recordings)
    simulated = _simulate(simulations, paths, recordings, signals)
    with terminal.err.status("characterising"):
        results = characterise(recordings, simulations=simulated)
    if options.out is not None:
        _write(options.out, results, sys.argv[2:] if argv is None else argv)
    if options.json:
        print_document("characterise", {**asdict(results), "findings": found})
    else:
        _print_results(results)
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "characterise",
        "Show what a damper dyno shows: force over speed for each current (at the peak speed and continuous), loops, "
        "work per cycle, hysteresis, knees, and how the valve responds to steps of the current; with simulations over "
        "the same recordings beside them. Sines, triangles and slow sweeps at constant currents give all of it, any "
        "other motion gives quantiles of the force over speed.",
        "ces characterise bags/noise bags/sweep --model config/models/sample.json --out characteristics",
    )
    p.add_argument("bags", nargs="+", metavar="BAG", help="recordings with a measured force: bags, folders, globs")
    p.add_argument("--model", action="append", default=[], metavar="SIM", help=f"may be repeated: {HELP}")
    terminal.add_signals(p)
    text = f"folder for the page ({PAGE}) and a CSV file for each table"
    p.add_argument("--out", type=Path, metavar="DIR", help=text)
    add_overwrite(p)
    add_json(p)
    return p


def _open_simulations(specs: Sequence[str]) -> dict[str, Simulation]:
    """Return the simulations by short names; raises CesError for one that cannot be opened or is given twice."""
    repeated = {spec for spec in specs if specs.count(spec) > 1}
    if repeated:
        raise CesError(f"--model {min(repeated)}: given twice; expected each simulation once")
    return {name: open_simulation(spec) for name, spec in zip(_name_simulations(specs), specs, strict=True)}


def _simulate(
    simulations: Mapping[str, Simulation], paths: Sequence[Path], recordings: Sequence[Recording], signals: Signals
) -> dict[str, list[F]]:
    """Return the forces [N] of each simulation at the position samples of each recording."""
    forces: dict[str, list[F]] = {}
    for name, simulation in simulations.items():
        with terminal.err.status(f"simulating {name}"):
            forces[name] = [
                simulation.force(with_predictions(simulation, path, recording, signals))
                for path, recording in zip(paths, recordings, strict=True)
            ]
    return forces


def _name_simulations(specs: Sequence[str]) -> list[str]:
    """Return the file names of the simulations, or all of what was typed where two would be the same."""
    short = [Path(spec).stem if Path(spec).suffix in (".json", ".yaml", ".yml", ".fmu") else spec for spec in specs]
    return [name if short.count(name) == 1 else spec for name, spec in zip(short, specs, strict=True)]


def _write(folder: Path, results: Characteristics, words: Sequence[str]) -> None:
    page, *tables = write_characteristics(folder, results, command=shlex.join(["ces", "characterise", *words]))
    terminal.err.print(f"{page} and {len(tables)} CSV files", highlight=False, soft_wrap=True)


def _print_results(results: Characteristics) -> None:
    tables = (_peak_table(results), _work_table(results), _response_table(results))
    for table in tables:
        if table.row_count:
            terminal.print_table(table)
    for one in results.omissions:
        count = f"{one.count} of {one.of} {one.subject}" if one.of else one.subject
        where = "" if one.recording == "all" else f"{one.recording}: "
        terminal.out.print(f"{where}{count}: {one.reason}", highlight=False, markup=False, soft_wrap=True)


def _peak_table(results: Characteristics) -> Table:
    headings = ("A", "mm", "Hz", "cycles", "m/s", "force\nN", *_simulated_headings(results, "N"))
    table = terminal.make_table("force at the peak speed (± standard deviation between cycles)", (), headings)
    rows = list(peak_cells(results))
    for cells in rows[:MAX_ROWS]:
        speed = number(cells["row"].speed_m_s)
        table.add_row(*_condition(cells["row"]), speed, cells["force"], *_simulated_cells(cells["others"]))
    _count_rest(table, len(rows))
    return table


def _work_table(results: Characteristics) -> Table:
    simulated = _simulated_headings(results, "J")
    headings = ("A", "mm", "Hz", "cycles", "work\nJ", *(simulated or ["damping\nNs/m", "zero-speed\nwidth N", "ratio"]))
    table = terminal.make_table(f"work per cycle{'' if simulated else TITLE_REST}", (), headings)
    rows = list(work_cells(results))
    for cells in rows[:MAX_ROWS]:
        row = cells["row"]
        width = with_spread(row.zero_width_N, row.zero_width_sd_N)
        measured = (number(row.damping_Ns_m), width, number(row.rebound_ratio))
        table.add_row(*_condition(row), cells["work"], *(_simulated_cells(cells["others"]) if simulated else measured))
    _count_rest(table, len(rows))
    return table


def _simulated_headings(results: Characteristics, unit: str) -> list[str]:
    """Return value and difference of one simulation, only the differences of several: they must fit in 80 columns."""
    names = results.sources[1:]
    if len(names) == 1:
        return [f"{names[0]}\n{unit}", f"difference\n{unit}"]
    return [f"{name}\ndifference {unit}" for name in names]


def _simulated_cells(others: Sequence[tuple[str, str]]) -> list[str]:
    return list(others[0]) if len(others) == 1 else [difference for _, difference in others]


def _response_table(results: Characteristics) -> Table:
    headings = ("from-to\nA", "force", "steps", "m/s", "dead time\nms", "63 % after\nstep, ms", "10-90 %\nms")
    table = terminal.make_table("response of the valve (± half the 95 % interval)", (), headings)
    for cells in response_cells(results):
        row = cells["row"]
        dead, _, after_step, rise = cells["times"]
        levels = f"{number(row.from_A, 2)}-{number(row.to_A, 2)}"
        table.add_row(levels, row.source, str(row.steps), number(row.speed_m_s, 2), dead, after_step, rise)
    return table


def _condition(row: object) -> tuple[str, ...]:
    values = argparse.Namespace(**asdict(row))  # type: ignore[call-overload]
    return number(values.current_A), number(1e3 * values.amplitude_m), number(values.frequency_Hz), str(values.cycles)


def _count_rest(table: Table, rows: int) -> None:
    if rows > MAX_ROWS:
        table.caption = f"and {rows - MAX_ROWS} more rows: --out DIR writes all"
