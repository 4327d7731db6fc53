"""`ces validate`: evaluates a model's free run on recordings, or proves its stability again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import print_findings, print_warnings, with_distinct_names
from ces_cli.terminal.options import BAGS, BAGS_FORM, MODEL, NEED_REPORT, ReportRequest, only_with, option
from ces_cli.terminal.outputs import name_report, print_document, without_text
from ces_cli.terminal.results import cost_rows, held_out_row, model_facts, print_band, print_costs
from ces_data.bags.find import find_bags
from ces_data.checks.content import require_once
from ces_data.findings import Finding
from ces_data.outputs import REPORT as REPORT_FILE
from ces_data.outputs import require_outputs
from ces_data.recording import Recording, describe_days
from ces_data.signals_file import load_signals
from ces_identify.options import REGIONS, WEIGHT
from ces_identify.prepare.cost import Weighting, parse_weighting
from ces_identify.validation.checked import evaluate_checked
from ces_identify.validation.evaluate import Evaluation, describe_size
from ces_identify.validation.lacks import head_lines
from ces_identify.validation.residuals import residual_tests, verdicts
from ces_observer.errors import CesError
from ces_observer.model import Model, load_model
from ces_observer.proof.certificate import Certificate
from ces_observer.records import declare
from ces_report.shell import PageHead

NOT_PROVED = 1  # exit status
ROUNDING = 1e-9  # relative


@dataclass(frozen=True, kw_only=True)
class ValidateRequest(ReportRequest):
    """Evaluate a model by the cost J of its free run on recordings with a measured force, with the interval of J, the
    noise floor where cycles repeat, tests of the residuals, and the regions with the largest error. Or prove its
    stability again.
    """

    program = "validate"
    example = (
        "ces validate model.json bags/road --weight zero_crossing=3 --report validation.html\n"
        "  ces validate model.json --certificate"
    )
    option_rules = (
        NEED_REPORT,
        only_with(
            "report part weight signals overwrite",
            "bags",
            "applies to recordings; name them: ces validate MODEL.json BAG...",
        ),
    )
    intermixed = True

    model: Path = declare(MODEL)
    bags: tuple[str, ...] = declare(replace(BAGS, meaning=f"recordings with a measured force: {BAGS_FORM}", count="*"))
    weight: tuple[str, ...] = declare(
        replace(WEIGHT, meaning=f"also show J with W times the weight for ticks in this region: {REGIONS}")
    )
    certificate: bool = option(
        False, "prove the model stable again; exit status 1 if it cannot be proved, or the file claims more"
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    request = terminal.read(ValidateRequest, argv)
    paths = find_bags(request.bags)
    report = name_report(request.report, [request.model.stem], [path.stem for path in paths])
    outputs = {REPORT_FILE: report}
    require_outputs(request.overwrite, outputs, inputs=[request.model, *paths, request.signals])
    model, weighting = load_model(request.model), parse_weighting(request.weight)
    if not request.bags and not request.certificate:
        raise CesError("no recording given; usage: ces validate MODEL.json BAG..., or --certificate alone")
    with without_text(request.json):
        proof = model.certify() if request.certificate else None
        status = 0 if proof is None else print_proof(model, proof, str(request.model))
        recordings = [] if status else _read_recordings(paths, request)
        evaluations, findings = _evaluate_recordings(model, recordings, request)
        if evaluations:
            weighting = weighting.with_common_stroke([e.series for e in evaluations])
            title = f"{request.model}: {describe_size(model)}"
            print_costs(evaluations, title, weighting)
            with terminal.step("finding what the error depends on"):
                lines = head_lines(model, evaluations)
            for line in lines:
                terminal.print_warning(line)
            print_band(model, evaluations)
            _print_details(evaluations, weighting)
        if evaluations and report is not None:
            from ces_identify.report.page import write_report

            command, recorded = terminal.command_line("validate", argv), describe_days(recordings)
            head = PageHead(request.title, request.note, command, recorded)
            head = head.titled(f"Validation of {request.model.name}")
            with terminal.step("writing the report"):
                write_report(report, head, model, evaluations, weighting=weighting)
            print(f"report: {report}")
    if request.json:
        print_document(
            "validate",
            {**_as_json(model, proof, evaluations, weighting, request), "report": report, "findings": findings},
        )
    return status


def _read_recordings(paths: Sequence[Path], request: ValidateRequest) -> list[Recording]:
    signals = load_signals(request.signals)
    recordings = {path: terminal.read_one(path, signals, terminal.FORCE, request.part) for path in paths}
    return list(with_distinct_names(recordings).values())


def _evaluate_recordings(
    model: Model, recordings: Sequence[Recording], request: ValidateRequest
) -> tuple[list[Evaluation], list[Finding]]:
    """Return the evaluations, and the findings of the checks, which are printed."""
    require_once(recordings)
    findings = [*print_findings(recordings)]
    evaluations: list[Evaluation] = []
    for recording in recordings:
        with terminal.step(f"evaluating {recording.name} ({len(evaluations) + 1} of {len(recordings)})"):
            evaluation, added = evaluate_checked(model, recording, findings)
        print_warnings(added)
        evaluations.append(evaluation)
        findings += added
    return evaluations, findings


def _print_details(evaluations: Sequence[Evaluation], weighting: Weighting) -> None:
    if weighting:
        print(f"weights: {weighting}")
    for e in evaluations:
        tests = residual_tests(e)
        for line in verdicts(tests) if tests else ("not tested: the free run diverged or is too short",):
            print(f"residual of {e.name}: {line}")


def _as_json(
    model: Model,
    proof: Certificate | None,
    evaluations: Sequence[Evaluation],
    weighting: Weighting,
    request: ValidateRequest,
) -> dict[str, Any]:
    return {
        "model": {"path": request.model, **model_facts(model)},
        "certificate": None if proof is None else certificate_facts(model, proof),
        "weights": str(weighting) if weighting else None,
        "recordings": cost_rows(evaluations, weighting),
        "all_held_out": held_out_row(evaluations),
        "residuals": {e.name: _residual_facts(e) for e in evaluations},
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


def print_proof(model: Model, proof: Certificate, name: str) -> int:
    """Print the bounds that a proof of stability gives; return the exit status.

    The status is 0 if the proof succeeds and the file claims no more, else NOT_PROVED, and one line gives the reason.
    """
    excess = _find_overclaim(model.certificate, proof) if proof.holds else ""
    if excess or not proof.holds:
        reason = f"the file claims {excess}; identify the model again" if proof.holds else proof.doubt
        print(f"not proved: {name}: {reason}")
        return NOT_PROVED
    envelope = model.envelope
    print(f"proved: {proof.claim} ({proof.effort})")
    for label, value in proof.rows:
        print(f"  {label:<14}  {value}")
    print(f"  {'inputs outside':<14}  the envelope are {model.body.outside}")
    for label, (low, high), unit in (
        ("position", envelope.position_m, "m"),
        ("speed", envelope.speed_m_s, "m/s"),
        ("current", envelope.current_A, "A"),
        ("force within", model.force_envelope_N, "N"),
    ):
        gap = envelope.gap_text if label == "current" else ""
        print(f"  {label:<14}  {low:.6g} to {high:.6g} {unit}{gap}")
    return 0


def certificate_facts(model: Model, proof: Certificate) -> dict[str, Any]:
    """Return for --json whether a proof succeeded and covers the file's claims, and the bounds that it proves."""
    doubt = _find_overclaim(model.certificate, proof) if proof.holds else proof.doubt
    return {"proved": not doubt, "doubt": doubt or None, "bounds": proof.bounds}


def _find_overclaim(stored: Mapping[str, Any] | None, proof: Certificate) -> str:
    """Return the first bound in the file that is tighter than the proved one, as text; empty if there is none."""
    for key, proved in proof.bounds.items():
        claimed = _number(stored, key)
        if claimed is not None and claimed < proved * (1.0 - ROUNDING):
            return f"{key} {claimed:.6g}, but only {proved:.6g} is proved"
    return ""


def _number(stored: Mapping[str, Any] | None, key: str) -> float | None:
    value = (stored or {}).get(key)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
