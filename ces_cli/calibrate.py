"""`ces calibrate`: fits the named parameters of a simulation to recordings, and says what is missing beside them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape

from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import HELP, find_bags, open_simulation
from ces_cli.terminal.options import FIT, HELD_OUT, JSON, OVERWRITE, REAL, SIGNALS
from ces_cli.terminal.outputs import print_document, require_outputs
from ces_cli.terminal.progress import DiagnoseProgress
from ces_gap.augmented import name_simulation
from ces_gap.calibrate.calibration import Calibration, calibrate
from ces_gap.inputs.checks import check_recordings
from ces_gap.report.calibration import FILE, calibration_content, calibration_files, describe, parameter_table
from ces_observer.json_text import write_all_atomically
from ces_observer.options import Option


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
    require_outputs(options.overwrite, folders={"--out": options.out})
    signals = terminal.load_described_signals(options)
    simulation = open_simulation(options.sim)
    real, held_out = (
        [terminal.read_one(path, signals, terminal.FORCE) for path in find_bags(words)]
        for words in (options.real, options.held_out)
    )
    for text in check_recordings(real, held_out, []):
        terminal.print_warning(text)
    with DiagnoseProgress("calibrating") as progress:
        result = calibrate(simulation, options.sim, real, held_out, options.fit, progress.listen)
    facts = {"Command": terminal.command_line("calibrate", argv)}
    sources = {"real": real, "held_out": held_out}
    files = calibration_files(result, name_simulation(options.sim, options.out), sources, facts)
    options.out.mkdir(parents=True, exist_ok=True)
    write_all_atomically({options.out / name: text for name, text in files.items()})
    if options.json:
        print_document("calibrate", {"folder": options.out, "files": list(files), **calibration_content(result)})
    else:
        _print_result(result, options.out, list(files))
    return 0


def _print_result(result: Calibration, folder: Path, files: Sequence[str]) -> None:
    for note in result.notes:
        terminal.print_warning(note)
    terminal.out.print(escape(describe(result)), highlight=False, soft_wrap=True)
    terminal.print_table(terminal.lay_out(parameter_table(result), lambda p: "bold" * p.matters))
    for group in result.moves_with:
        terminal.print_line(f"look alike on these recordings: {', '.join(group)}")
    terminal.print_line(
        f"next: ces diagnose --sim {folder / FILE} --real BAG... --out DIR   (what is missing beside them)"
    )
    print(f"written: {folder}/{', '.join(files)}")


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    return terminal.parser(
        "calibrate",
        "Fit the named parameters of a simulation to recordings of the real damper: numbers among the keyword-only "
        "arguments of a Python function (*, seal_N=25.0), the parameters of an FMU, or valves, oil, gas and friction "
        "of a hydraulic model. Says each with its interval, which are not determined or move together, how far the "
        f"gap shrinks on data left out, and which effect is missing beside them. Writes {FILE}, itself a SIM, and "
        "report.html.",
        "ces calibrate --sim simulator:force --real worn/* --out fitted\n"
        "  ces calibrate --sim simulator:force --real worn/* --fit seal_N knee_m_s=0.05..0.3 --out fitted",
        Option("sim", meaning=HELP, metavar="SIM"),
        REAL,
        HELD_OUT,
        FIT,
        SIGNALS,
        Option("out", meaning="folder to write, created if necessary", kind=Path, metavar="DIR"),
        *(OVERWRITE, JSON),
    )
