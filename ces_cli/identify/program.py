"""`ces identify`: identifies a model from recordings; `model.json` and a report go out."""

from __future__ import annotations

import argparse
import hashlib
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial, reduce
from pathlib import Path
from time import monotonic
from typing import Any

from ces_cli.identify.campaign import CAMPAIGN_RULES, run_campaign
from ces_cli.identify.options import OF_THE_PROGRAM, list_shared
from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import (
    find_bags,
    find_file,
    open_simulation,
    print_warnings,
    with_distinct_names,
    with_teacher_force,
)
from ces_cli.terminal.options import ALL, BAGS, BAGS_FORM, OptionRule, never_with
from ces_cli.terminal.outputs import name_report, print_document, require_outputs, schema_line, without_text
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
from ces_data.checks.check import check_together, require_sound
from ces_data.checks.content import require_distinct
from ces_data.compilation import CompilationNotice
from ces_data.findings import Finding
from ces_data.recording import Recording
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
from ces_identify.options import build_identify_options
from ces_identify.polynomial.constructed import add_blend
from ces_identify.polynomial.rules_file import built_in_rules, load_rules
from ces_identify.prepare.cost import Weighting, parse_weighting
from ces_identify.prepare.sampling import choose_motion, describe_motion
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO, REASON, advise, select_fitter
from ces_identify.structures.kit import IdentifyOptions, StructureKit
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_identify.validation.cost_table import NONE, RULE, compare_with_teacher, percent
from ces_identify.validation.evaluate import VALIDATION, describe_size
from ces_identify.validation.lacks import head_lines
from ces_observer.errors import CesError
from ces_observer.model import Model
from ces_observer.proof.certificate import summarize
from ces_report.table import text_table


def _rule_of(kit: StructureKit[Any], names: str) -> OptionRule:
    reason = f"applies to --structure {kit.option} or {AUTO}, not to {{structure}}; remove it"
    return OptionRule(names, lambda options: options.structure in (kit.option, AUTO), reason)


STRUCTURE_RULES = (
    never_with(ALL, "show_candidates", "does not apply with --show-candidates", but="show_candidates method"),
    _rule_of(POLYNOMIAL, "method candidates blend terms"),
    *(_rule_of(kit, " ".join(size.name for size in kit.sizes)) for kit in KITS.values()),
)
SEARCH_SHARE, MIN_LEFT_SHARE = 0.8, 0.5  # of a time limit's rest after reading; of the limit, that counts as left


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    parser = make_parser()
    options = parser.parse_args(argv)
    if options.show_candidates:
        print(schema_line("candidates") + built_in_rules(options.method), end="")
        return 0
    if options.campaign is not None:
        return run_campaign(options, parser)
    work = prepare_identification(options)
    if options.folds:
        split_folds(work.bags, options.folds)  # raises before the long search if the recordings do not suffice
    result, folds = work.run(), None
    with without_text(options.json):
        if options.folds:
            result, folds = with_folds(result, options, work.bags, work.how)
            result.model.save(options.out)
        _print_result(result, options)
        if options.report is not None:
            write_report_page(result, options, terminal.command_line("identify", argv))
            print(f"report: {options.report}")
    if options.json:
        print_document("identify", _as_json(result, folds, work, options))
    return 0


@dataclass(frozen=True)
class Identification:
    """The inputs of an identification.

    `bags` and `validation` are recordings with the force to learn, `measured` all of them as logged. `findings` are
    those of the checks.
    """

    options: argparse.Namespace
    bags: Sequence[Recording]
    validation: Sequence[Recording]
    measured: Sequence[Recording]
    how: IdentifyOptions
    findings: tuple[Finding, ...] = ()

    def run(self, show_progress: Callable[[Limits], Any] = SearchProgress) -> IdentificationResult:
        """Search, write the model and return it; Ctrl-C stops with the best model so far. Raises CesError."""
        CompilationNotice(terminal.print_warning)
        with show_progress(self.how.limits) as progress:
            run = select_identify_function(self.options)
            result = run(self.bags, self.validation, self.how, progress.listen)
        if self.options.teacher is not None:
            result = with_teacher(result, self.options.teacher, self.measured)
        result = result.require_explained(self.findings, self.options.ignore_findings)
        result.model.save(self.options.out)
        return result


def prepare_identification(options: argparse.Namespace) -> Identification:
    """Read and check all files that `options` name, before the long search; raises CesError."""
    began_s = monotonic()
    if not options.bags:
        raise CesError("no recording given; usage: ces identify BAG... --out MODEL.json")
    paths = [find_bags(words, repeated=True) for words in (options.bags, options.validate)]
    tested = paths[1] or paths[0]
    options.report = name_report(options.report, [options.out.stem], [path.stem for path in tested])
    outputs = {"--out": options.out, "--report": options.report}
    inputs = [*paths[0], *paths[1], options.signals, options.candidates, find_file(options.teacher or "")]
    require_outputs(options.overwrite, outputs, inputs=inputs)
    rules = reduce(add_blend, options.blend, load_rules(options.candidates, options.method))
    values = {**vars(options), "candidates": rules, "weight": parse_weighting(options.weight)}
    measured, (bags, validation) = _read_recordings(paths, options)
    require_distinct(bags, validation)
    findings = check_together([*bags, *validation])
    require_sound(findings, options.ignore_findings)
    print_warnings(findings)
    how = build_identify_options({**values, "threads": options.threads or os.cpu_count() or 1})
    if motion := describe_motion([*bags, *validation], choose_motion(bags, how.speed)):
        terminal.print_line(motion, console=terminal.err)
    left_s = max(MIN_LEFT_SHARE * how.limits.time, how.limits.time - monotonic() + began_s)
    how = replace(how, limits=replace(how.limits, time=SEARCH_SHARE * left_s))
    return Identification(options, bags, validation, measured, how, findings)


def _read_recordings(
    groups: Sequence[Sequence[Path]], options: argparse.Namespace
) -> tuple[tuple[Recording, ...], list[list[Recording]]]:
    """Return all recordings as logged, and each group with the force to learn; a teacher needs no measured force."""
    signals = terminal.load_described_signals(options)
    need = terminal.FORCE if options.teacher is None else terminal.FORCE[:2]
    measured = with_distinct_names({path: terminal.read_one(path, signals, need) for group in groups for path in group})
    learned = measured
    if options.teacher is not None:
        teacher = open_simulation(options.teacher)
        learned = {path: with_teacher_force(teacher, path, recording, signals) for path, recording in measured.items()}
    return tuple(measured.values()), [[learned[path] for path in group] for group in groups]


def select_identify_function(options: argparse.Namespace) -> Callable[..., IdentificationResult]:
    """Return the function that identifies the chosen structure: (recordings, validation, options, listener)."""
    return partial(identify, fitter=select_fitter(options.structure, vars(options)))


def with_teacher(result: IdentificationResult, teacher: str, measured: Sequence[Recording]) -> IdentificationResult:
    """Return `result` with its teacher in the model's provenance; `measured` are the recordings as logged."""
    file = file_of(teacher)
    rows = [
        {
            key: v if isinstance(v, str) else _round_finite(v)
            for key, v in {**asdict(comparison), "loss": comparison.loss}.items()
        }
        for comparison in compare_with_teacher(result.model, result.evaluations, measured)
    ]
    sha256 = None if file is None else hashlib.sha256(file.read_bytes()).hexdigest()
    return _with_history(result, "teacher", {"simulation": teacher, "sha256": sha256, "cost_J_percent": rows})


def _with_history(result: IdentificationResult, key: str, facts: object) -> IdentificationResult:
    return replace(result, model=replace(result.model, provenance={**result.model.provenance, key: facts}))


def _round_finite(value: float) -> float | None:
    """Return a cost as the model file stores it; a run that diverged has none."""
    return round(value, 4) if math.isfinite(value) else None


def with_folds(
    result: IdentificationResult, options: argparse.Namespace, recordings: Sequence[Recording], how: IdentifyOptions
) -> tuple[IdentificationResult, CrossValidation]:
    """Cross-validate, print the table, and return `result` with the costs in its model's provenance, and the costs."""

    def identify(
        training: Sequence[Recording], held_out: Sequence[Recording], fold: IdentifyOptions
    ) -> IdentificationResult:
        with SearchProgress(fold.limits) as progress:
            return select_identify_function(options)(training, held_out, fold, progress.listen)

    folds = cross_validate(recordings, options.folds, identify, how)
    terminal.print_table(terminal.lay_out(fold_table(folds)))
    if any(row.interval is None for row in folds.rows):
        print(f"{NONE}: the free run diverged, or the recording is too short for an interval")
    rows = [
        {**row, "J_percent": _round_finite(row["J_percent"]), "ci95_percent": bounds and [round(b, 4) for b in bounds]}
        for row in fold_rows(folds)["rows"]
        for bounds in [row["ci95_percent"]]
    ]
    return _with_history(result, "cross_validation", rows), folds


def write_report_page(result: IdentificationResult, options: argparse.Namespace, command: str) -> None:
    """Write the report to options.report; raises CesError if it cannot be written."""
    from ces_identify.report.page import write_report

    facts = {
        "command": command,
        "selection": f"{describe_starts(result, options)}, {sum(f.trials for f in result.search_results)} trials",
        "end of search": result.search_results[0].ended,
    }
    try:
        write_report(options.report, f"Model {options.out.name}", result.model, result.evaluations, facts)
    except CesError as error:
        raise CesError(f"{error} with --overwrite; {options.out} is complete") from None


def describe_starts(result: IdentificationResult, options: argparse.Namespace) -> str:
    """Return which start was best and how many starts led to a model, or why this kind of damper."""
    selection = result.model.provenance.get("selection", {})
    if "kind_reason" in selection:
        return str(selection["kind_reason"])
    seed = result.search_results[0].seed
    count = result.starts
    return f"best: start {seed - options.seed + 1} of {options.starts} (seed {seed}); {count} led to a model"


def _print_result(result: IdentificationResult, options: argparse.Namespace) -> None:
    evaluations, model = result.evaluations, result.model
    print_costs(evaluations, describe_size(model), _weighting(result, options))
    for line in head_lines(model, evaluations):
        terminal.print_warning(line)
    _print_teacher(result)
    print(RULE)
    if used := model.provenance["selection"].get(THINNED):
        print(f"identified on {used}")
    print(f"{describe_starts(result, options)}; stopped: {result.search_results[0].ended}")
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
    print(f"model:  {options.out}")


def _weighting(result: IdentificationResult, options: argparse.Namespace) -> Weighting:
    return parse_weighting(options.weight).with_common_stroke([e.series for e in result.evaluations])


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


def _as_json(
    result: IdentificationResult, folds: CrossValidation | None, work: Identification, options: argparse.Namespace
) -> dict[str, Any]:
    best, model = result.search_results[0], result.model
    weighting = _weighting(result, options)
    teacher = None
    if options.teacher is not None:
        rows = compare_with_teacher(model, result.evaluations, work.measured)
        teacher = [asdict(row) | {"loss": row.loss} for row in rows]
    return {
        "model": {"path": options.out, **model_facts(model)},
        "certificate": model.certificate,
        "weights": str(weighting) if weighting else None,
        "recordings": cost_rows(result.evaluations, weighting),
        "all_held_out": held_out_row(result.evaluations),
        "search": {"starts": result.starts, "best_seed": best.seed, "stopped": best.ended},
        "structures": model.provenance["selection"].get("structures", {}),
        "folds": None if folds is None else fold_rows(folds),
        "teacher": teacher,
        "findings": work.findings,
        "report": options.report,
    }


def make_parser() -> terminal.Parser:
    """Return the argument parser."""
    return terminal.parser(
        "identify",
        "Identify a model of the damping force from one or more recordings. The free-run cost selects the model, and "
        f"its stability is proved. Structures: {', '.join(kit.about for kit in KITS.values())}.",
        "ces identify bags/noise bags/sweep --validate bags/sine_4hz bags/road --out model.json --report report.html",
        replace(BAGS, meaning=f"recordings with a measured force: {BAGS_FORM}", count="*"),
        *list_shared(),
        *OF_THE_PROGRAM,
        rules=(*CAMPAIGN_RULES, *STRUCTURE_RULES),
    )
