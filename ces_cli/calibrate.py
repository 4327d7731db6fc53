"""`ces calibrate`: fits the named parameters of a simulation to recordings, and says what is missing beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.markup import escape

from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import HELP, open_simulation
from ces_cli.terminal.options import FIT, HELD_OUT, REAL, PageRequest, option
from ces_cli.terminal.outputs import print_document
from ces_cli.terminal.progress import DiagnoseProgress
from ces_data.bags.find import find_bags
from ces_data.outputs import OUT, require_outputs
from ces_data.recording import describe_days
from ces_data.signals_file import load_signals
from ces_gap.augmented import name_simulation
from ces_gap.calibrate.calibration import Calibration, calibrate
from ces_gap.inputs.checks import check_recordings
from ces_gap.report.calibration import FILE, calibration_content, calibration_files, describe, parameter_table
from ces_observer.json_text import write_all_atomically
from ces_observer.records import declare
from ces_report.shell import PageHead


@dataclass(frozen=True, kw_only=True)
class CalibrateRequest(PageRequest):
    """What `ces calibrate` is asked for."""

    program = "calibrate"
    about = (
        "Fit the named parameters of a simulation to recordings of the real damper: numbers among the keyword-only "
        "arguments of a Python function (*, seal_N=25.0), the parameters of an FMU, or valves, oil, gas and friction "
        "of a hydraulic model. Says each with its interval, which are not determined or move together, how far the "
        f"gap shrinks on data left out, and which effect is missing beside them. Writes {FILE}, itself a SIM, and "
        "report.html."
    )
    example = (
        "ces calibrate --sim simulator:force --real worn/* --out fitted\n"
        "  ces calibrate --sim simulator:force --real worn/* --fit seal_N knee_m_s=0.05..0.3 --out fitted"
    )

    sim: str = option(meaning=HELP, metavar="SIM")
    real: tuple[str, ...] = declare(REAL)
    held_out: tuple[str, ...] = declare(HELD_OUT)
    fit: tuple[str, ...] = declare(FIT)
    out: Path = option(meaning="folder to write, created if necessary", metavar="DIR")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    request = terminal.read(CalibrateRequest, argv)
    require_outputs(request.overwrite, folders={OUT: request.out})
    signals = load_signals(request.signals)
    simulation = open_simulation(request.sim)
    real, held_out = (
        [terminal.read_one(path, signals, terminal.FORCE, request.part) for path in find_bags(words)]
        for words in (request.real, request.held_out)
    )
    for text in check_recordings(real, held_out, []):
        terminal.print_warning(text)
    with DiagnoseProgress("calibrating") as progress:
        result = calibrate(simulation, request.sim, real, held_out, request.fit, progress.listen)
    command, recorded = terminal.command_line("calibrate", argv), describe_days([*real, *held_out])
    head = PageHead(request.title, request.note, command, recorded)
    sources = {"real": real, "held_out": held_out}
    with terminal.step("writing the report"):
        files = calibration_files(result, name_simulation(request.sim, request.out), sources, head)
    request.out.mkdir(parents=True, exist_ok=True)
    write_all_atomically({request.out / name: text for name, text in files.items()})
    if request.json:
        print_document("calibrate", {"folder": request.out, "files": list(files), **calibration_content(result)})
    else:
        _print_result(result, request.out, list(files))
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
