"""`ces identify`: identifies a model from recordings; `model.json` and a report go out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ces_cli.identify.campaign import run_campaign
from ces_cli.identify.request import IdentifyProgramRequest
from ces_cli.terminal import terminal
from ces_cli.terminal.heartbeat import heartbeat
from ces_cli.terminal.inputs import find_file, open_simulation, print_warnings, with_distinct_names, with_teacher_force
from ces_cli.terminal.outputs import name_report, print_document, schema_line, without_text
from ces_cli.terminal.progress import SearchProgress
from ces_cli.terminal.results import (
    cost_rows,
    fold_rows,
    fold_table,
    held_out_row,
    model_facts,
    print_band,
    print_costs,
)
from ces_data.bags.find import find_bags
from ces_data.checks.check import check_together, require_sound
from ces_data.checks.content import require_distinct
from ces_data.findings import Finding
from ces_data.outputs import OUT, OVERWRITE, REPORT, require_model_name, require_outputs
from ces_data.recording import Recording, describe_days
from ces_data.signals_file import load_signals
from ces_gap.augmented import file_of
from ces_identify.identification import (
    THINNED,
    CrossValidation,
    IdentificationResult,
    cross_validate,
    identify,
    split_folds,
)
from ces_identify.numerics.search import Limits
from ces_identify.options import IdentifyRequest
from ces_identify.polynomial.rules_file import built_in_rules
from ces_identify.prepare.cost import Weighting
from ces_identify.prepare.sampling import choose_motion, describe_motion
from ces_identify.structures.auto import REASON, advise, select_fitter
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.validation.cost_table import NONE, RULE, compare_with_teacher, percent, round_finite, teacher_facts
from ces_identify.validation.evaluate import VALIDATION, describe_size
from ces_identify.validation.lacks import head_lines
from ces_observer.errors import CesError
from ces_observer.model import Model
from ces_observer.proof.certificate import summarize
from ces_report.shell import PageHead
from ces_report.table import text_table

MIN_MODEL_SHARE, TOLERANCE = 0.7, 1.2  # of a time limit: for the model at least, and that counts as met
TAIL_TIMES = 1.0  # that tables and report take as long as start and reading did on this machine (measured: 0.8 to 1.1)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    request = terminal.read(IdentifyProgramRequest, argv)
    if request.show_candidates:
        print(schema_line("candidates") + built_in_rules(request.model.method), end="")
        return 0
    if request.campaign is not None:
        return run_campaign(request, request.campaign)
    work = prepare_identification(request)
    if request.folds:
        split_folds(work.bags, request.folds)  # raises before the long search if the recordings do not suffice
    result, folds = work.run(), None
    with without_text(request.json):
        if request.folds:
            result, folds = with_folds(result, request, work.bags, work.how)
            result.model.save(request.out)
        _print_result(result, request, work.how.weight)
        if work.report is not None:
            write_report_page(result, work, terminal.command_line("identify", argv))
            print(f"report: {work.report}")
    if request.json:
        print_document("identify", _as_json(result, folds, work))
    return 0


@dataclass(frozen=True)
class Identification:
    """The inputs of an identification, and the file of its `report`.

    `bags` and `validation` are recordings with the force to learn, `measured` all of them as logged. `findings` are
    those of the checks.
    """

    request: IdentifyProgramRequest
    report: Path | None
    bags: Sequence[Recording]
    validation: Sequence[Recording]
    measured: Sequence[Recording]
    how: IdentifyOptions
    findings: tuple[Finding, ...] = ()

    def run(self, show_progress: Callable[[Limits], Any] = SearchProgress) -> IdentificationResult:
        """Search, write the model and return it; Ctrl-C stops with the best model so far. Raises CesError."""
        with show_progress(self.how.limits) as progress:
            run = select_identify_function(self.request.model)
            result = run(self.bags, self.validation, self.how, progress.listen)
        if self.request.teacher is not None:
            result = with_teacher(result, self.request.teacher, self.measured)
        result = result.require_explained(self.findings, self.request.model.ignore_findings)
        result.model.save(self.request.out)
        return result


def prepare_identification(request: IdentifyProgramRequest) -> Identification:
    """Read and check all files that a request names, before the long search; raises CesError."""
    if not request.bags:
        raise CesError("no recording given; usage: ces identify BAG... --out MODEL.json")
    paths = [find_bags(words, repeated=True) for words in (request.bags, request.validate)]
    tested, candidates = paths[1] or paths[0], request.model.candidates
    report = name_report(request.report, [request.out.stem], [path.stem for path in tested])
    inputs = [*paths[0], *paths[1], request.signals, find_file(request.teacher or "")]
    inputs += [candidates] if isinstance(candidates, Path) else []
    require_outputs(request.overwrite, {OUT: request.out, REPORT: report}, inputs=inputs)
    require_model_name(request.out)
    how = request.model.options()
    measured, (bags, validation) = _read_recordings(paths, request)
    require_distinct(bags, validation)
    with terminal.step("checking the recordings"):
        findings = check_together([*bags, *validation])
    require_sound(findings, request.model.ignore_findings)
    print_warnings(findings)
    if motion := describe_motion([*bags, *validation], choose_motion(bags, how.speed)):
        terminal.print_line(motion, console=terminal.err)
    how = replace(how, limits=replace(how.limits, time=share_time(how.limits.time)))
    return Identification(request, report, bags, validation, measured, how, findings)


def share_time(limit_s: float) -> float:
    """Return how much of a time limit is for the model, and say so if the limit cannot be met."""
    both_s = (1.0 + TAIL_TIMES) * heartbeat.elapsed_s
    model_s = max(limit_s - both_s, MIN_MODEL_SHARE * limit_s)
    if model_s + both_s > TOLERANCE * limit_s:
        took = f"start and reading took {heartbeat.elapsed_s:.1f} s, as will the report"
        terminal.print_warning(f"--time {limit_s:g} cannot be met: {took}; it will be about {model_s + both_s:.0f} s")
    return model_s


def _read_recordings(
    groups: Sequence[Sequence[Path]], request: IdentifyProgramRequest
) -> tuple[tuple[Recording, ...], list[list[Recording]]]:
    """Return all recordings as logged, and each group with the force to learn; a teacher needs no measured force."""
    signals = load_signals(request.signals)
    need = terminal.FORCE if request.teacher is None else terminal.FORCE[:2]
    measured = with_distinct_names(
        {path: terminal.read_one(path, signals, need, request.part) for group in groups for path in group}
    )
    learned = measured
    if request.teacher is not None:
        teacher = open_simulation(request.teacher)
        learned = {path: with_teacher_force(teacher, path, recording, signals) for path, recording in measured.items()}
    return tuple(measured.values()), [[learned[path] for path in group] for group in groups]


def select_identify_function(request: IdentifyRequest) -> Callable[..., IdentificationResult]:
    """Return the function that identifies the chosen structure: (recordings, validation, options, listener)."""
    return partial(identify, fitter=select_fitter(request.structure, request.all_sizes))


def with_teacher(result: IdentificationResult, teacher: str, measured: Sequence[Recording]) -> IdentificationResult:
    """Return `result` with its teacher in the model's provenance; `measured` are the recordings as logged."""
    facts = teacher_facts(result.model, result.evaluations, teacher, file_of(teacher), measured)
    return _with_history(result, "teacher", facts)


def _with_history(result: IdentificationResult, key: str, facts: object) -> IdentificationResult:
    return replace(result, model=replace(result.model, provenance={**result.model.provenance, key: facts}))


def with_folds(
    result: IdentificationResult, request: IdentifyProgramRequest, recordings: Sequence[Recording], how: IdentifyOptions
) -> tuple[IdentificationResult, CrossValidation]:
    """Cross-validate, print the table, and return `result` with the costs in its model's provenance, and the costs."""

    def identify(
        training: Sequence[Recording], held_out: Sequence[Recording], fold: IdentifyOptions
    ) -> IdentificationResult:
        with SearchProgress(fold.limits) as progress:
            return select_identify_function(request.model)(training, held_out, fold, progress.listen)

    folds = cross_validate(recordings, request.folds, identify, how)
    terminal.print_table(terminal.lay_out(fold_table(folds)))
    if any(row.interval is None for row in folds.rows):
        print(f"{NONE}: the free run diverged, or the recording is too short for an interval")
    rows = [
        {**row, "J_percent": round_finite(row["J_percent"]), "ci95_percent": bounds and [round(b, 4) for b in bounds]}
        for row in fold_rows(folds)["rows"]
        for bounds in [row["ci95_percent"]]
    ]
    return _with_history(result, "cross_validation", rows), folds


def write_report_page(result: IdentificationResult, work: Identification, command: str) -> None:
    """Write the report if one is wanted; raises CesError if it cannot be written."""
    from ces_identify.report.page import write_report

    if work.report is None:
        return
    out = work.request.out
    trials = sum(f.trials for f in result.search_results)
    recorded = describe_days([*work.bags, *work.validation])
    head = PageHead(work.request.title, work.request.note, command, recorded).titled(f"Model {out.name}")
    facts = {
        "selection": f"{describe_starts(result, work.request.model)}, {trials} trials",
        "end of search": result.search_results[0].ended,
    }
    try:
        with terminal.step("writing the report"):
            write_report(work.report, head, result.model, result.evaluations, facts)
    except CesError as error:
        raise CesError(*error.args, " with ", OVERWRITE, f"; {out} is complete") from None


def describe_starts(result: IdentificationResult, request: IdentifyRequest) -> str:
    """Return which start was best and how many starts led to a model, or why this kind of damper."""
    selection = result.model.provenance.get("selection", {})
    if "kind_reason" in selection:
        return str(selection["kind_reason"])
    seed = result.search_results[0].seed
    count = result.starts
    return f"best: start {seed - request.seed + 1} of {request.starts} (seed {seed}); {count} led to a model"


def _print_result(result: IdentificationResult, request: IdentifyProgramRequest, weight: Weighting) -> None:
    evaluations, model = result.evaluations, result.model
    print_costs(evaluations, describe_size(model), _weighting(result, weight))
    with terminal.step("finding what the error depends on"):
        lines = head_lines(model, evaluations)
    for line in lines:
        terminal.print_warning(line)
    _print_teacher(result)
    print(RULE)
    if used := model.provenance["selection"].get(THINNED):
        print(f"identified on {used}")
    print(f"{describe_starts(result, request.model)}; stopped: {result.search_results[0].ended}")
    if not any(e.role == VALIDATION for e in evaluations):
        terminal.print_warning(
            "no validation data: these costs show the fit, not how well the model predicts other recordings"
        )
    selection = model.provenance["selection"]
    _print_certificate(model, selection.get("not_proved", ""))
    if costs := selection.get("structures"):
        chosen = selection["structure"]
        print(f"J on blocks left out: {', '.join(f'{name} {cost:.2f} %' for name, cost in costs.items())}")
        if REASON in selection:
            print(selection[REASON])
        if advice := advise(costs, chosen):
            terminal.print_warning(advice)
    print_band(model, evaluations)
    print(f"model:  {request.out}")


def _weighting(result: IdentificationResult, weight: Weighting) -> Weighting:
    return weight.with_common_stroke([e.series for e in result.evaluations])


def _print_teacher(result: IdentificationResult) -> None:
    facts = result.model.provenance.get("teacher")
    if facts is None:
        return
    print(f"J above compares with the teacher {facts['simulation']}, not with the measured force")
    rows = facts["cost_J_percent"]
    if all(row["teacher_to_measured"] is None for row in rows):
        print("these recordings hold no measured force to compare the teacher with")
        return
    lines = []
    for row in rows:
        costs = (row["model_to_teacher"], row["teacher_to_measured"], row["model_to_measured"])
        loss = NONE if row["loss"] is None else f"{row['loss']:+.2f}"
        lines.append((row["recording"], *(NONE if c is None else percent(c) for c in costs), loss))
    headings = ("recording", "model to teacher", "teacher to measured", "model to measured", "loss")
    terminal.print_table(terminal.lay_out(text_table(headings, lines, "distillation loss, J in %")))
    if any(None in row.values() for row in rows):
        print(f"{NONE}: a recording without a measured force, or a free run that diverged")


def _print_certificate(model: Model, doubt: str) -> None:
    """Print the certificate, or why there is none and what that means; `doubt` is why a proof failed."""
    if model.certificate is not None:
        print(f"proved stable: {summarize(model.certificate)}")
        return
    if doubt:
        text = f"not proved stable: {doubt}; the"
    else:
        text = "--no-certificate: no proof of this model's stability was tried; if the observer's fails, the"
    terminal.print_warning(f"{text} observer will refuse this model unless allow_uncertified is true")


def _as_json(result: IdentificationResult, folds: CrossValidation | None, work: Identification) -> dict[str, Any]:
    best, model = result.search_results[0], result.model
    weighting = _weighting(result, work.how.weight)
    teacher = None
    if work.request.teacher is not None:
        rows = compare_with_teacher(model, result.evaluations, work.measured)
        teacher = [asdict(row) | {"loss": row.loss} for row in rows]
    return {
        "model": {"path": work.request.out, **model_facts(model)},
        "certificate": model.certificate,
        "weights": str(weighting) if weighting else None,
        "recordings": cost_rows(result.evaluations, weighting),
        "all_held_out": held_out_row(result.evaluations),
        "search": {"starts": result.starts, "best_seed": best.seed, "stopped": best.ended},
        "structures": model.provenance["selection"].get("structures", {}),
        "folds": None if folds is None else fold_rows(folds),
        "teacher": teacher,
        "findings": work.findings,
        "report": work.report,
    }
