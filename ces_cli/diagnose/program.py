"""`ces diagnose`: where the gap of a simulation to reality lies, what causes it, how far it shrinks, what next."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.bag_paths import RECORDING, VEHICLE, find_bags
from ces_cli.terminal.simulations import HELP, open_simulation
from ces_observer.errors import CesError
from ces_observer.json_checks import write_all_atomically

OPTIONAL_FILES = ("next_experiment.yaml", "next_experiment.csv")  # files that only some diagnoses write
MAX_THREADS = 256


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = _parser().parse_args(argv)
    if options.each is not None:
        from ces_cli.diagnose.fleet import run_fleet

        return run_fleet(options)
    if options.jobs is not None or options.dask is not None:
        raise CesError("--jobs and --dask are of fleets; give --each recording or --each vehicle, too")
    _diagnose(options, shlex.join(["ces", "diagnose", *(sys.argv[2:] if argv is None else argv)]))
    return 0


def _diagnose(options: argparse.Namespace, command: str) -> None:
    from ces_cli.diagnose.diagnosis_tables import print_diagnosis
    from ces_cli.diagnose.inputs import build_diagnose_options, read_with_predictions
    from ces_cli.diagnose.progress import DiagnoseProgress
    from ces_gap.augmented.augmented_file import name_simulation
    from ces_gap.intake.checks import check_recordings
    from ces_gap.pipeline import diagnose
    from ces_gap.report.result_files import result_files

    _make_folder(options.out)
    how, signals = build_diagnose_options(options, os.cpu_count() or 1), terminal.load_described_signals(options)
    simulation = open_simulation(options.sim)
    roles = {"real": options.real, "held_out": options.held_out, "reference": options.reference}
    given = {
        role: [read_with_predictions(simulation, p, signals) for p in find_bags(words)] for role, words in roles.items()
    }
    recordings = (given["real"], given["held_out"], given["reference"])
    doubts = check_recordings(*recordings)
    for text in doubts:
        terminal.print_warning(text)
    with DiagnoseProgress() as progress:
        found = diagnose(simulation, options.sim, *recordings, how, progress.listen)
        found = replace(found, notes=(*doubts, *found.notes))
        progress.listen("writing the report", 1.0)
        files = result_files(
            found, name_simulation(options.sim, options.out), list(given.items()), {"Command": command}
        )
    for name in OPTIONAL_FILES:
        (options.out / name).unlink(missing_ok=True)  # of an earlier diagnosis
    write_all_atomically({options.out / name: text for name, text in files.items()})
    print_diagnosis(found, options.out, tuple(files), printed_notes=len(doubts))


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CesError(f"{folder}: cannot be made: {error.strerror}; choose another folder") from None
    if not os.access(folder, os.W_OK):
        raise CesError(f"{folder}: cannot be written; choose another folder")


def _parser() -> terminal.Parser:
    p = terminal.parser(
        "diagnose",
        "Find where a simulation and recordings of the real damper disagree, which effect that the simulation lacks "
        "causes it, and how far the gap shrinks once it is added. Writes gap.json, augmented.json (the simulation with "
        "the effects, a SIM again), report.html and, where it would tell more, the next experiment.",
        "ces diagnose --sim model.json --real bags/road bags/sweep --reference bags/new_damper --out gap\n"
        "  ces diagnose --sim damper.fmu --real 'fleet/*' --each vehicle --reference bags/new_damper --out fleet_gap",
    )
    whole = terminal.integer_between
    p.add_argument("--sim", required=True, metavar="SIM", help=HELP)
    p.add_argument(
        "--real", nargs="+", required=True, metavar="BAG", help="recordings of the real damper: bags, folders, globs"
    )
    p.add_argument(
        "--held-out",
        nargs="+",
        default=[],
        metavar="BAG",
        help="recordings only to judge on (default: a part of --real is set aside)",
    )
    p.add_argument(
        "--reference",
        nargs="+",
        default=[],
        metavar="BAG",
        help="recordings known to be free of the effect: they teach the simulation's own error first",
    )
    terminal.add_signals(p)
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write, made if need be")
    p.add_argument(
        "--effects",
        nargs="+",
        default=[],
        metavar="module:Class",
        help="effects of your own beside the library's (subclasses of ces_gap.effects.effect.Effect)",
    )
    p.add_argument(
        "--threads",
        type=whole(1, MAX_THREADS),
        metavar="N",
        help="default: all processors; with --each, one for each diagnosis",
    )
    p.add_argument("--seed", type=whole(0, 2**31), default=1, metavar="N", help="of everything random (default 1)")
    p.add_argument(
        "--each",
        choices=(RECORDING, VEHICLE),
        help="one diagnosis for each recording of --real, or for each folder of recordings; the same command goes on "
        "where a run was stopped",
    )
    p.add_argument("--jobs", type=whole(1, 256), metavar="N", help="fleet: processes (default: all processors)")
    p.add_argument("--dask", metavar="ADDRESS", help="fleet: compute on this Dask scheduler's workers (host:port)")
    return p
