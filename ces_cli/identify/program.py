"""`ces identify`: recordings in, `model.json` and a report out."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ces_cli.campaign.program import add_campaign, run_campaign
from ces_cli.identify.candidates import add_candidates
from ces_cli.identify.distillation import print_teacher
from ces_cli.identify.folds import add_folds, require_folds, with_folds
from ces_cli.identify.identification import prepare_identification, write_report_page
from ces_cli.identify.search_progress import SearchProgress
from ces_cli.identify.structures import add_structure
from ces_cli.terminal import terminal
from ces_cli.terminal.cost_picture import save_cost_picture
from ces_cli.terminal.coverage_picture import require_picture_name
from ces_cli.terminal.tables import cost_table
from ces_identify.identification import IdentificationResult
from ces_identify.polynomial.limits import BOTH, METHODS
from ces_identify.polynomial.regressors import DEFAULT_RULES
from ces_identify.preparation.weighting import FORMS, parse_weighting
from ces_identify.structures import KITS
from ces_identify.validation.usage import RULE
from ces_observer.proof.certificate import summarize


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    words = parser()
    options = words.parse_args(argv)
    if options.show_candidates:
        print(DEFAULT_RULES, end="")
        return 0
    if options.campaign is not None or options.dask is not None or options.jobs is not None:
        return run_campaign(options, words)
    if options.picture is not None:
        require_picture_name(options.picture)
    work = prepare_identification(options)
    require_folds(options, work.bags)
    result = work.run(SearchProgress)
    if options.folds:
        result = with_folds(result, options, work.bags, work.how)
        result.model.save(options.out)
    _print_result(result, options, argv)
    return 0


def _print_result(result: IdentificationResult, options: argparse.Namespace, argv: Sequence[str] | None) -> None:
    best = result.search_results[0]
    weighting = parse_weighting(options.weight).with_common_stroke([e.series for e in result.evaluations])
    terminal.out.print(cost_table(result.evaluations, result.model.size, weighting))
    print_teacher(result)
    print(RULE)
    terminal.out.print(
        f"start {best.seed} of {len(result.search_results)} was best; it ended because {best.ended}", highlight=False
    )
    if not any(e.role == "validation" for e in result.evaluations):
        terminal.print_warning("nothing was held out: these costs say how well the model fits, not how good it is")
    _print_certificate(result.model.certificate)
    print(f"model:  {options.out}")
    if options.picture is not None:
        save_cost_picture(result.evaluations, options.picture)
    if options.report is None:
        return
    command = shlex.join(["ces", "identify", *(sys.argv[2:] if argv is None else argv)])
    write_report_page(result, options, command)
    print(f"report: {options.report}")


def _print_certificate(certificate: Mapping[str, Any] | None) -> None:
    if certificate is None:
        terminal.print_warning(
            "--no-certificate: nothing proves that this model stays stable; the observer will refuse it"
        )
        return
    print(f"stable: {summarize(certificate)} (proved)")


def parser() -> terminal.Parser:
    """Return the parser of the options."""
    p = terminal.parser(
        "identify",
        "Identify a model of the damping force from any number of recordings at once, judged by the cost of its free "
        f"run and proved stable: {', '.join(kit.about for kit in KITS.values())}.",
        "ces identify bags/noise bags/sweep --validate bags/sine_4hz bags/road --out model.json --report report.html",
    )
    number, whole = terminal.number_between, terminal.integer_between
    p.add_argument("bags", nargs="*", type=Path, metavar="BAG", help="recordings with a measured force")
    p.add_argument(
        "--validate", nargs="+", type=Path, default=[], metavar="BAG", help="recordings only to judge the model on"
    )
    terminal.add_signals(p)
    add_structure(p)
    p.add_argument("--out", type=Path, default=Path("model.json"), metavar="FILE", help="default: model.json")
    p.add_argument("--report", type=Path, metavar="FILE", help="write a report page (HTML)")
    p.add_argument("--picture", type=Path, metavar="FILE", help="draw speed-force and time plots (.png, .svg, .pdf)")
    p.add_argument(
        "--split",
        type=number(0.05, 1.0),
        metavar="SHARE",
        help="first share of each BAG to identify on, the rest validates (default 0.75; 1 with --validate)",
    )
    p.add_argument("--teacher", metavar="SIM", help="learn this simulation's force instead of the measured one")
    add_candidates(p)
    p.add_argument(
        "--method",
        choices=METHODS,
        default=BOTH,
        help="how terms are chosen: random forward selection as in the thesis, Gauss-Newton gain on the free-run "
        "error, or starts of both kinds (default)",
    )
    p.add_argument(
        "--weight",
        action="append",
        default=[],
        metavar="REGION=W",
        help=f"let this region's ticks count W times in fit and selection; may be repeated: {FORMS} "
        "[m/s, share of the stroke, A, m]",
    )
    p.add_argument("--terms", type=whole(1, 200), default=25, metavar="N", help="most terms (default 25)")
    time_help = "most seconds, not counting what the first run compiles (default 60)"
    p.add_argument("--time", type=number(0.1, 1e6), default=60.0, metavar="S", help=time_help)
    p.add_argument("--target", type=number(0.0, 100.0), default=0.0, metavar="J", help="stop at this cost in percent")
    p.add_argument("--starts", type=whole(1, 10000), default=8, metavar="N", help="random starts (default 8)")
    p.add_argument("--seed", type=whole(0, 2**31), default=1, metavar="N", help="seed of the first start (default 1)")
    p.add_argument(
        "--threads", type=whole(1, 256), default=os.cpu_count() or 1, metavar="N", help="default: all processors"
    )
    p.add_argument(
        "--no-certificate", action="store_true", help="consider models whose stability is not proved, too (unsafe)"
    )
    p.add_argument("--rate", type=number(1.0, 1e5), metavar="HZ", help="rate of the model (default: from the data)")
    p.add_argument(
        "--bandwidth", type=number(0.01, 5e4), metavar="HZ", help="of the differentiator (default: from the data)"
    )
    add_folds(p)
    add_campaign(p)
    return p
