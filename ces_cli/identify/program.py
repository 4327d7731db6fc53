"""`ces identify`: identifies a model from recordings; `model.json` and a report go out."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from ces_cli.campaign.program import add_campaign, run_campaign
from ces_cli.identify.distillation import print_teacher
from ces_cli.identify.folds import add_folds, with_folds
from ces_cli.identify.identification import AUTO, prepare_identification, write_report_page
from ces_cli.identify.json_facts import identification_facts
from ces_cli.identify.structures import add_candidates, add_structure
from ces_cli.terminal import terminal
from ces_cli.terminal.cost_picture import save_cost_picture
from ces_cli.terminal.coverage_picture import require_picture_name
from ces_cli.terminal.json_output import add_json, print_document, without_text
from ces_cli.terminal.progress import SearchProgress
from ces_cli.terminal.tables import cost_table, print_band, print_missing, print_outside
from ces_identify.folds import split_folds
from ces_identify.identification import IdentificationResult
from ces_identify.polynomial.regressors import built_in_rules
from ces_identify.preparation.weighting import parse_weighting
from ces_identify.structures import KITS
from ces_identify.structures.auto import advise
from ces_identify.validation.usage import RULE
from ces_observer.model import DIFFERENTIATORS, Model
from ces_observer.proof.certificate import summarize


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    arguments = make_parser()
    options = arguments.parse_args(argv)
    if options.show_candidates:
        print(built_in_rules(options.method), end="")
        return 0
    if options.campaign is not None or options.dask is not None or options.jobs is not None:
        return run_campaign(options, arguments)
    if options.picture is not None:
        require_picture_name(options.picture)
    work = prepare_identification(options)
    if options.folds:
        split_folds(work.bags, options.folds)  # raises before the long search if the recordings do not suffice
    result, folds = work.run(SearchProgress), None
    with without_text(options.json):
        if options.folds:
            result, folds = with_folds(result, options, work.bags, work.how)
            result.model.save(options.out)
        _print_result(result, options, argv)
    if options.json:
        print_document("identify", identification_facts(result, folds, work, options))
    return 0


def _print_result(result: IdentificationResult, options: argparse.Namespace, argv: Sequence[str] | None) -> None:
    best = result.search_results[0]
    weighting = parse_weighting(options.weight).with_common_stroke([e.series for e in result.evaluations])
    terminal.out.print(cost_table(result.evaluations, result.model.size, weighting))
    print_missing(result.evaluations)
    print_outside(result.evaluations)
    print_teacher(result)
    print(RULE)
    print(f"best of {len(result.search_results)} starts: seed {best.seed}; stopped: {best.ended}")
    if not any(e.role == "validation" for e in result.evaluations):
        terminal.print_warning(
            "no validation data: these costs show the fit, not how well the model predicts other recordings"
        )
    _print_certificate(result.model)
    _print_structures(result)
    print_band(result.model, result.evaluations)
    print(f"model:  {options.out}")
    if options.picture is not None:
        save_cost_picture(result.evaluations, options.picture)
    if options.report is None:
        return
    command = shlex.join(["ces", "identify", *(sys.argv[2:] if argv is None else argv)])
    write_report_page(result, options, command)
    print(f"report: {options.report}")


def _print_structures(result: IdentificationResult) -> None:
    """Print the costs of short fits of other structures, and which of them is clearly better."""
    selection = result.model.provenance["selection"]
    costs = selection.get("structures", {})
    if not costs:
        return
    others = ", ".join(f"{name} {cost:.2f} %" for name, cost in costs.items() if name != selection["structure"])
    print(
        f"J on the selection data: {selection['structure']} {costs[selection['structure']]:.2f} %; short fits: {others}"
    )
    advice = advise(costs, selection["structure"])
    if advice:
        terminal.print_warning(advice)


def _print_certificate(model: Model) -> None:
    """Print the certificate, or why there is none and what that means."""
    if model.certificate is not None:
        print(f"stable: {summarize(model.certificate)} (proved)")
        return
    doubt = model.provenance["selection"].get("not_proved")
    refusal = "the observer will refuse this model unless allow_uncertified is true"
    terminal.print_warning(
        f"not proved stable: {doubt}; {refusal}"
        if doubt
        else f"--no-certificate: no proof of this model's stability was tried; if the observer's fails, {refusal}"
    )


def make_parser() -> terminal.Parser:
    """Return the argument parser."""
    p = terminal.parser(
        "identify",
        "Identify a model of the damping force from one or more recordings. The free-run cost selects the model, and "
        f"its stability is proved. Structures: {', '.join(kit.about for kit in KITS.values())}.",
        "ces identify bags/noise bags/sweep --validate bags/sine_4hz bags/road --out model.json --report report.html",
    )
    number, whole = terminal.number_between, terminal.integer_between
    p.add_argument("bags", nargs="*", type=Path, metavar="BAG", help="recordings with a measured force")
    text = "recordings for validation only"
    p.add_argument("--validate", nargs="+", type=Path, default=[], metavar="BAG", help=text)
    terminal.add_signals(p)
    add_structure(p)
    p.add_argument("--out", type=Path, default=Path("model.json"), metavar="FILE", help="default: model.json")
    terminal.add_report_and_picture(p)
    text = "first share of each BAG to identify on; the rest is for validation (default 0.75; 1 with --validate)"
    p.add_argument("--split", type=number(0.05, 1.0), metavar="SHARE", help=text)
    p.add_argument("--teacher", metavar="SIM", help="learn this simulation's force instead of the measured force")
    add_candidates(p)
    terminal.add_weight(p, "give ticks in this region W times the weight in fit and selection")
    text = "maximum number of terms (default 25; no limit with --method thesis)"
    p.add_argument("--terms", type=whole(1, 200), metavar="N", help=text)
    text = "maximum search time in seconds, without the compilation in the first run (default 60)"
    p.add_argument("--time", type=number(0.1, 1e6), default=60.0, metavar="S", help=text)
    p.add_argument("--target", type=number(0.0, 100.0), default=0.0, metavar="J", help="stop at this cost in percent")
    p.add_argument("--starts", type=whole(1, 10000), default=8, metavar="N", help="random starts (default 8)")
    p.add_argument("--seed", type=whole(0, 2**31), default=1, metavar="N", help="seed of the first start (default 1)")
    threads = os.cpu_count() or 1
    p.add_argument("--threads", type=whole(1, 256), default=threads, metavar="N", help="default: all processors")
    text = "also accept models whose stability is not proved (unsafe)"
    p.add_argument("--no-certificate", action="store_true", help=text)
    text = "fit no band: how far the measured force may lie from the estimate (takes less than a second)"
    p.add_argument("--no-band", action="store_true", help=text)
    p.add_argument("--rate", type=number(1.0, 1e5), metavar="HZ", help="rate of the model (default: from the data)")
    text = "bandwidth of the differentiator (default: from the data)"
    p.add_argument("--bandwidth", type=number(0.01, 5e4), metavar="HZ", help=text)
    text = (
        "source of the speed: the position through a Kalman filter or through three of them (adaptive), the position "
        "fused with the signal acceleration, or the signal speed (measured). auto (default): measured or fused if all "
        "BAGs have the signal, else kalman"
    )
    p.add_argument("--differentiator", choices=(AUTO, *DIFFERENTIATORS), default=AUTO, help=text)
    text = "identify in spite of findings that make a wrong model; model.json lists them"
    p.add_argument("--force", action="store_true", help=text)
    add_folds(p)
    add_campaign(p)
    add_json(p)
    return p
