"""`ces validate`: evaluates a model's free run on recordings."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ces_cli.identify.certificate_check import certificate_facts, verify_certificate
from ces_cli.identify.model_check import print_against_model
from ces_cli.terminal import terminal
from ces_cli.terminal.bag_paths import add_bags, find_bags, require_model_first, with_distinct_names
from ces_cli.terminal.cost_picture import save_cost_picture
from ces_cli.terminal.coverage_picture import require_picture_name
from ces_cli.terminal.findings import print_findings
from ces_cli.terminal.json_costs import cost_rows, held_out_row, model_facts
from ces_cli.terminal.json_output import add_json, print_document, without_text
from ces_cli.terminal.option_rules import OptionRule
from ces_cli.terminal.outputs import add_overwrite, name_report, require_outputs
from ces_cli.terminal.tables import cost_table, print_band, print_missing, print_outside
from ces_identify.preparation.series import prepare
from ces_identify.preparation.weighting import Weighting, parse_weighting
from ces_identify.recordings.checks import WRONG_MODEL, Finding
from ces_identify.sense.content import find_known_recording, require_once
from ces_identify.validation.error_regions import error_cells
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation, evaluate
from ces_identify.validation.residuals import residual_tests, verdicts
from ces_observer.errors import CesError
from ces_observer.model import Model, load_model

WORST_CELLS = 3


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_intermixed_args(argv)  # bags may follow options
    if options.picture is not None:
        require_picture_name(options.picture)
    require_model_first("validate", options.model)
    paths = find_bags(options.bags)
    options.report = name_report(options.report, [options.model.stem], [path.stem for path in paths])
    outputs = {"--report": options.report, "--picture": options.picture}
    require_outputs(options.overwrite, outputs, inputs=[options.model, *paths, options.signals])
    model, weighting = load_model(options.model), parse_weighting(options.weight)
    if not options.bags and not options.certificate:
        raise CesError("no recording given; usage: ces validate MODEL.json BAG..., or --certificate alone")
    with without_text(options.json):
        status = verify_certificate(model, str(options.model)) if options.certificate else 0
        evaluations, found = ([], []) if status else _evaluations(model, paths, options)
        weighting = weighting.with_common_stroke([e.series for e in evaluations]) if evaluations else weighting
        if evaluations:
            _print_evaluations(model, evaluations, weighting, options)
            _write_pages(model, evaluations, weighting, options, argv)
    if options.json:
        print_document("validate", {**_as_json(model, evaluations, weighting, options), "findings": found})
    return status


def _print_evaluations(
    model: Model, evaluations: Sequence[Evaluation], weighting: Weighting, options: argparse.Namespace
) -> None:
    terminal.print_table(cost_table(evaluations, f"{options.model}: {model.size}", weighting, exact=False))
    print_missing(evaluations)
    print_outside(evaluations)
    print_band(model, evaluations)
    _print_details(evaluations, weighting)


def _write_pages(
    model: Model,
    evaluations: Sequence[Evaluation],
    weighting: Weighting,
    options: argparse.Namespace,
    argv: Sequence[str] | None,
) -> None:
    """Write the picture and the report that the options ask for."""
    if options.picture is not None:
        save_cost_picture(evaluations, options.picture)
    if options.report is not None:
        from ces_identify.report import write_report

        facts = {"command": shlex.join(["ces", "validate", *(sys.argv[2:] if argv is None else argv)])}
        write_report(options.report, f"Validation of {options.model.name}", model, evaluations, facts, weighting)
        print(f"report: {options.report}")


def _as_json(
    model: Model, evaluations: Sequence[Evaluation], weighting: Weighting, options: argparse.Namespace
) -> dict[str, Any]:
    """Return the document of --json."""
    proof = model.certify() if options.certificate else None
    return {
        "model": {"path": options.model, **model_facts(model)},
        "certificate": None if proof is None else certificate_facts(model, proof),
        "weights": str(weighting) if weighting else None,
        "recordings": cost_rows(evaluations, weighting),
        "all_held_out": held_out_row(evaluations),
        "residuals": {e.name: _residual_facts(e) for e in evaluations},
        "error_cells": error_cells(evaluations) if evaluations else [],
        "report": options.report,
        "picture": options.picture,
    }


def _residual_facts(evaluation: Evaluation) -> dict[str, Any] | None:
    """Return the residual tests of a recording; None where the free run diverged or is too short."""
    tests = residual_tests(evaluation)
    if tests is None:
        return None
    correlations = [
        {"input": c.first, "residual": c.second, "share": c.share, "lag_s": c.lags_s[c.worst], "p_value": c.p_value}
        for c in tests.inputs
    ]
    return {"whiteness_p_value": tests.whiteness.p_value, "ljung_box": tests.ljung_box, "inputs": correlations}


def _evaluations(
    model: Model, paths: Sequence[Path], options: argparse.Namespace
) -> tuple[list[Evaluation], list[Finding]]:
    """Return the evaluations, and the findings of the sense check, which are printed."""
    signals = terminal.load_described_signals(options)
    recordings = list(
        with_distinct_names({path: terminal.read_one(path, signals, terminal.FORCE) for path in paths}).values()
    )
    require_once(recordings)
    found = [*print_findings(recordings)]
    evaluations: list[Evaluation] = []
    for recording in recordings:
        overlaps = find_known_recording(recording, model.provenance, options.part)
        if overlaps:
            terminal.print_warning(
                f"{recording.name}: the model was identified on seconds of this recording (as '{overlaps}'): its cost "
                "here is lower than on new data"
            )
        series = prepare(recording, model.sampling).part(*options.part)
        evaluations += evaluate(model, [series], IDENTIFICATION if overlaps else VALIDATION)
        if not (overlaps or any(f.severity == WRONG_MODEL and f.text.startswith(f"{recording.name}:") for f in found)):
            found += print_against_model(model, recording, evaluations[-1], options.part)
    return evaluations, found


def _print_details(evaluations: Sequence[Evaluation], weighting: Weighting) -> None:
    """Print the weights, the residual tests of each recording, and the regions with the largest error."""
    if weighting:
        print(f"weights: {weighting}")
    for e in evaluations:
        tests = residual_tests(e)
        for line in verdicts(tests) if tests else ("not tested: the free run diverged or is too short",):
            print(f"residual of {e.name}: {line}")
    for cell in error_cells(evaluations)[:WORST_CELLS]:
        print(
            f"error: {100 * cell.energy:.0f} % of its energy in {100 * cell.ticks:.0f} % of the time at {cell.region} "
            f"(RMS {cell.rms_N:.0f} N, {cell.cost:.2f} of J)"
        )


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "validate",
        "Evaluate a model by the cost J of its free run on recordings with a measured force, with the interval of J, "
        "the noise floor where cycles repeat, tests of the residuals, and the regions with the largest error. Or prove "
        "its stability again.",
        "ces validate model.json bags/road --weight zero_crossing=3 --report validation.html\n"
        "  ces validate model.json --certificate",
    )
    p.add_argument("model", type=Path, metavar="MODEL.json")
    add_bags(p, "recordings with a measured force", nargs="*")
    terminal.add_signals(p)
    terminal.add_part(p)
    terminal.add_weight(p, "also show J with W times the weight for ticks in this region")
    text = "prove the model stable again and compare with the file; exit status 1 if it cannot be proved"
    p.add_argument("--certificate", action="store_true", help=text)
    terminal.add_report_and_picture(p)
    add_json(p)
    add_overwrite(p)
    p.rules = (
        OptionRule(
            "report picture part weight signals overwrite",
            lambda options: bool(options.bags),
            "applies to recordings; name them: ces validate MODEL.json BAG...",
        ),
    )
    return p
