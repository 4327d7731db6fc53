"""`ces blind score`: opens the seal, checks its hashes and compares the diagnoses with the withheld effects."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import track

from ces_cli.blind.case import DECISION, GAP, REPLAY, ROW
from ces_cli.blind.closure import closure, where_error
from ces_cli.blind.figures import TARGET_GAP, cases_with_targets
from ces_cli.blind.mode import Mode
from ces_cli.blind.outcome import CaseOutcome, build_case_outcome
from ces_cli.blind.run import SETTINGS, read_seal
from ces_cli.blind.tables import (
    baseline_table,
    case_rows,
    confusion_table,
    headline_table,
    mode_facts,
    no_effect_table,
    slice_table,
    summary_table,
)
from ces_cli.terminal import terminal
from ces_cli.terminal.json_output import print_document
from ces_observer.errors import CesError
from ces_observer.json_checks import write_atomically
from ces_rig.blind.draw import HELD_OUT, REAL
from ces_rig.blind.seal import open_arrays, open_seal

FAILED_DIAGNOSIS: Mapping[str, Any] = {
    "verdict": "failed",
    "causes": [],
    "composition": {"effects": [], "shrink": None},
    "probabilities": {"none": 0.0, "unknown": 0.0},
    "indistinguishable": [],
}  # in place of the gap.json of a failed diagnosis


def score(options: argparse.Namespace) -> int:
    """Score results against the seal, print the tables and write them; returns the exit status. Raises CesError."""
    about, labels = open_seal(options.cases)
    by_mode: dict[str, list[CaseOutcome]] = {}
    parts = []
    for folder, mode in find_modes(options.results, options.cases):
        if mode.name in by_mode:
            raise CesError(f"{folder}: a second folder with results of mode {mode.name}; give one for each mode")
        outcomes, failed = _outcomes(options.cases, folder, labels, mode)
        if outcomes:
            by_mode[mode.name] = outcomes
            parts += [f"## `{mode.name}`", _opening(outcomes, failed, len(labels), about), *_tables(outcomes)]
    if not by_mode:
        raise CesError(
            f"{options.results[0]}: contains no diagnosis of a case of {options.cases}; run 'ces blind run' first"
        )
    text = "\n\n".join(part for part in (*_summary(by_mode), *parts) if part)
    if options.json:
        print_document("blind-score", {"modes": {name: mode_facts(cases) for name, cases in by_mode.items()}})
    else:
        print(text)
    if options.out is not None:
        write_atomically(options.out, text + "\n")
    if options.rows is not None:
        write_atomically(options.rows, case_rows([case for cases in by_mode.values() for case in cases]))
    return 0


def _summary(by_mode: Mapping[str, Sequence[CaseOutcome]]) -> list[str]:
    """Return the table of all modes over the cases that the targets apply to, or over all if there are none."""
    chosen = {name: part for name, cases in by_mode.items() if (part := cases_with_targets(cases))}
    about = "cases that the targets apply to" if chosen else f"all cases; none has a gap of {TARGET_GAP:g} x noise"
    return [f"## Summary: {about}", summary_table(chosen or by_mode)]


def _tables(cases: Sequence[CaseOutcome]) -> list[str]:
    """Return the tables as Markdown: the cases that the targets apply to, then all cases, also by their properties."""
    parts = []
    target = cases_with_targets(cases)
    if 0 < len(target) < len(cases):
        parts += ["### Cases that the targets apply to", headline_table(target), baseline_table(target)]
    return [
        *parts,
        "### All cases",
        headline_table(cases),
        baseline_table(cases),
        slice_table(cases, "gap-to-noise", lambda case: case.gap_to_noise),
        slice_table(cases, "simulation's error / gap", lambda case: case.baseline_ratio),
        slice_table(cases, "excitation", lambda case: case.excitation),
        slice_table(cases, "plant", lambda case: case.plant),
        "### By effect",
        confusion_table(cases),
        no_effect_table(cases),
    ]


def _opening(cases: Sequence[CaseOutcome], failed: Mapping[str, str], sealed: int, about: Mapping[str, Any]) -> str:
    lines = [
        f"Seed {about['seed']}: {len(cases)} of {sealed} sealed cases, {about['seconds']:g} s per recording, "
        f"{cases[0].mode.text}; {np.median([case.seconds for case in cases]):.1f} s per case (median, one thread)."
    ]
    lines += [f"Case {case} could not be diagnosed: {reason}" for case, reason in failed.items()]
    return "  \n".join(lines)


def _outcomes(
    folder: Path, results: Path, labels: Sequence[dict[str, Any]], mode: Mode
) -> tuple[list[CaseOutcome], dict[str, str]]:
    """Return the outcomes of the cases, and the reasons of failures, which count as wrong."""
    outcomes, failed = [], {}
    for label in track(labels, "scoring", console=terminal.err, transient=True, disable=not terminal.err.is_terminal):
        case_results = results / label["case"]
        if not (case_results / ROW).is_file():
            continue
        row = _json(case_results / ROW)
        if row["status"] == "done":
            outcomes.append(_outcome(folder, case_results, label, row["seconds"], mode))
        else:
            outcomes.append(build_case_outcome(label, FAILED_DIAGNOSIS, {}, {}, row["seconds"], mode))
            failed[label["case"]] = row["reason"]
    return outcomes, failed


def _outcome(folder: Path, results: Path, label: dict[str, Any], seconds: float, mode: Mode) -> CaseOutcome:
    gap = _json(results / GAP)
    truth = open_arrays(folder, label)
    figures = closure(truth, _load_replay(results / REPLAY), HELD_OUT[0])
    claimed = gap["composition"]["shrink"]
    if figures and claimed is not None:
        figures["shrink_error"] = abs(claimed - figures["closure"])
    misplaced = where_error(truth, gap["where"], (*REAL, *HELD_OUT), corrected=mode.references > 0)
    baselines = _json(results / DECISION)["baselines"]
    return build_case_outcome(label, gap, {**figures, **misplaced}, baselines, seconds, mode)


def _load_replay(path: Path) -> dict[str, NDArray[np.float64]]:
    with np.load(path, allow_pickle=False) as replay:
        return {name: replay[name].astype(np.float64) for name in replay.files}


def find_modes(results: Sequence[Path], cases: Path) -> Iterator[tuple[Path, Mode]]:
    """Yield each folder of results with its mode; raises CesError if there is none, or if it is of other cases."""
    for given in results:
        folders = (
            [given] if (given / SETTINGS).is_file() else sorted(path.parent for path in given.glob(f"*/{SETTINGS}"))
        )
        if not folders:
            raise CesError(f"{given}: contains no {SETTINGS}; expected the output of 'ces blind run'")
        for folder in folders:
            settings = _json(folder / SETTINGS)
            if settings.get("seal") not in ("", read_seal(cases)):
                raise CesError(f"{folder}: holds results of other cases than {cases}")
            if "references" not in settings:
                raise CesError(f"{folder}: holds results of an older version; run 'ces blind run' again")
            yield folder, Mode(settings["simulation"], settings["references"])


def _json(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise CesError(f"{path}: cannot be read ({error}); expected the output of 'ces blind run'") from None
