"""`ces diagnose`: locates the gap between a simulation and reality, finds its cause and says how far it shrinks."""

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
from ces_cli.terminal.json_output import add_json, print_document, without_text
from ces_cli.terminal.many_jobs import ONE_PLACE, add_jobs
from ces_cli.terminal.option_rules import never_with, only_with
from ces_cli.terminal.outputs import add_overwrite, add_report, name_report, require_outputs
from ces_cli.terminal.simulations import HELP, open_simulation
from ces_observer.json_checks import write_all_atomically

STRUCTURES = ("auto", "polynomial", "sigmoid", "anfis", "relaxation", "chambers")
OPTIONAL_FILES = ("next_experiment.yaml", "next_experiment.csv")  # not every diagnosis writes these


RULES = (
    only_with("structure", "identify", "applies to --identify; a simulation given by --sim has its own"),
    never_with(
        "sim",
        "identify",
        "does not apply with --identify, which takes a model of the references as simulation; remove one",
    ),
    only_with("jobs dask", "each", "applies to fleets; add --each recording or --each vehicle"),
    never_with("held_out", "each", "has no effect with --each: a part of each recording or vehicle is held out"),
    never_with("report", "each", "has no effect with --each: each diagnosis has its report.html in --out"),
    never_with("overwrite", "each", "has no effect with --each: the same command continues the fleet in --out"),
    ONE_PLACE,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
    if options.each is not None:
        from ces_cli.diagnose.fleet import run_fleet

        return run_fleet(options)
    real = [path.stem for path in find_bags(options.real)]
    options.report = name_report(options.report, [Path(options.sim or "identified").stem], real)
    require_outputs(options.overwrite, {"--report": options.report}, folders={"--out": options.out})
    _diagnose(options, shlex.join(["ces", "diagnose", *(sys.argv[2:] if argv is None else argv)]))
    return 0


def _diagnose(options: argparse.Namespace, command: str) -> None:
    from ces_cli.diagnose.diagnosis_tables import print_diagnosis
    from ces_cli.diagnose.inputs import (
        build_diagnose_options,
        read_with_predictions,
        require_one_source,
        take_simulation,
    )
    from ces_cli.terminal.progress import DiagnoseProgress
    from ces_gap.augmented.augmented_file import name_simulation
    from ces_gap.intake.checks import check_recordings
    from ces_gap.pipeline import diagnose
    from ces_gap.report.gap_json import gap_content
    from ces_gap.report.result_files import REPORT, result_files

    require_one_source(options)
    how, signals = build_diagnose_options(options, os.cpu_count() or 1), terminal.load_described_signals(options)
    given = None if options.identify else open_simulation(options.sim)
    roles = {"real": options.real, "held_out": options.held_out, "reference": options.reference}
    recordings = {
        role: [read_with_predictions(given, p, signals) for p in find_bags(words)] for role, words in roles.items()
    }
    real, held_out, reference = recordings.values()
    doubts = check_recordings(real, held_out, reference)
    for text in doubts:
        terminal.print_warning(text)
    with DiagnoseProgress() as progress:
        simulation, spec = take_simulation(given, reference, options, how.threads, progress.listen)
        diagnosis = diagnose(simulation, spec, real, held_out, reference, how, progress.listen)
        diagnosis = replace(diagnosis, notes=(*doubts, *diagnosis.notes))
        progress.listen("writing the report", 1.0)
        name = name_simulation(spec, options.out)
        files = result_files(diagnosis, name, list(recordings.items()), {"Command": command})
    options.out.mkdir(parents=True, exist_ok=True)
    for optional in OPTIONAL_FILES:
        (options.out / optional).unlink(missing_ok=True)  # from an earlier diagnosis
    copies = {options.report: files[REPORT]} if options.report is not None and REPORT in files else {}
    write_all_atomically({**{options.out / name: text for name, text in files.items()}, **copies})
    with without_text(options.json):
        print_diagnosis(diagnosis, options.out, tuple(files), printed_notes=len(doubts))
        for path in copies:
            print(f"report: {path}")
    if options.json:
        print_document("diagnose", {"folder": options.out, "files": list(files), "diagnosis": gap_content(diagnosis)})


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "diagnose",
        "Find where a simulation differs from recordings of the real damper, which missing effect is the cause, and "
        "how far the gap shrinks with that effect added. Writes gap.json, augmented.json (the simulation with the "
        "effects, itself a SIM), report.html and, where it would help, the next experiment.",
        "ces diagnose --sim model.json --real bags/road bags/sweep --reference bags/new_damper --out gap\n"
        "  ces diagnose --identify --reference bags/new_damper --real bags/road bags/sweep --out gap\n"
        "  ces diagnose --sim damper.fmu --real 'fleet/*' --each vehicle --reference bags/new_damper --out fleet_gap",
    )
    whole = terminal.integer_between
    p.add_argument("--sim", metavar="SIM", help=HELP)
    text = "without --sim: identify a model of the --reference recordings and diagnose with it; DIR/model.json"
    p.add_argument("--identify", action="store_true", help=text)
    text = "of the model that --identify fits; auto (default): the lowest cost on held-out parts of the references"
    p.add_argument("--structure", choices=STRUCTURES, metavar="NAME", help=f"{text}; or {', '.join(STRUCTURES[1:])}")
    text = "recordings of the real damper: bags, folders, globs"
    p.add_argument("--real", nargs="+", required=True, metavar="BAG", help=text)
    text = "recordings for evaluation only (default: a part of --real is held out)"
    p.add_argument("--held-out", nargs="+", default=[], metavar="BAG", help=text)
    text = "recordings known to be free of the effect; the simulation's own error is learned from them first"
    p.add_argument("--reference", nargs="+", default=[], metavar="BAG", help=text)
    terminal.add_signals(p)
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write, created if necessary")
    add_report(p, "copy report.html to FILE")
    text = "your own effects in addition to the library's (subclasses of ces_gap.Effect)"
    p.add_argument("--effects", nargs="+", default=[], metavar="module:Class", help=text)
    text = "default: all processors; with --each, one for each diagnosis"
    p.add_argument("--threads", type=whole(1, 256), metavar="N", help=text)
    text = "share of the RMS force [%%] below which a gap counts as none (default 1, but at most twice the noise)"
    p.add_argument("--tolerance", type=terminal.number_between(0.0, 100.0), metavar="PERCENT", help=text)
    p.add_argument("--seed", type=whole(0, 2**31), default=1, metavar="N", help="random seed (default 1)")
    text = (
        "one diagnosis for each recording of --real, or for each folder of recordings; the same command continues an "
        "interrupted run"
    )
    p.add_argument("--each", choices=(RECORDING, VEHICLE), help=text)
    add_jobs(p, "fleet")
    add_json(p)
    add_overwrite(p)
    p.rules = RULES
    return p
