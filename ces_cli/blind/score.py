"""`ces blind score`: opens the seal, checks its hashes and compares the diagnoses with the withheld effects."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import track

from ces_cli.blind.case import DECISION, GAP, REPLAY, ROW
from ces_cli.blind.closure import closure, where_error
from ces_cli.blind.outcome import CaseOutcome, build_case_outcome
from ces_cli.blind.run import SETTINGS, read_seal
from ces_cli.blind.tables import (
    baseline_table,
    case_rows,
    confusion_table,
    headline_table,
    no_effect_table,
    slice_table,
)
from ces_cli.terminal import terminal
from ces_observer.errors import CesError
from ces_observer.json_checks import write_atomically
from ces_rig.blind.draw import HELD_OUT, REAL
from ces_rig.blind.seal import open_arrays, open_seal

TARGET_GAP = 3.0  # the targets apply to this gap-to-noise ratio
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
    settings = _read_settings(options.results, options.cases)
    outcomes, failed = _outcomes(options.cases, options.results, labels, settings["reference"])
    if not outcomes:
        raise CesError(
            f"{options.results}: contains no diagnosis of a case of {options.cases}; run 'ces blind run' first"
        )
    opening = _opening(outcomes, failed, len(labels), settings, about)
    text = "\n\n".join(part for part in (opening, *_tables(outcomes, settings["predictions"])) if part)
    print(text)
    if options.out is not None:
        write_atomically(options.out, text + "\n")
    if options.rows is not None:
        write_atomically(options.rows, case_rows(outcomes))
    return 0


def _tables(cases: Sequence[CaseOutcome], predictions: bool) -> list[str]:
    """Return the tables as Markdown: the cases that the targets apply to, then all cases, also by their properties."""
    parts = []
    if target := [case for case in cases if case.gap_to_noise == TARGET_GAP]:
        parts += [f"### Gap-to-noise {TARGET_GAP:g}", headline_table(target, predictions), baseline_table(target)]
    return [
        *parts,
        "### All cases",
        headline_table(cases, predictions),
        baseline_table(cases),
        slice_table(cases, "gap-to-noise", lambda case: case.gap_to_noise),
        slice_table(cases, "simulation's error / gap", lambda case: case.baseline_ratio),
        slice_table(cases, "excitation", lambda case: case.excitation),
        slice_table(cases, "plant", lambda case: case.plant),
        "### By effect",
        confusion_table(cases),
        no_effect_table(cases),
    ]


def _opening(
    cases: Sequence[CaseOutcome],
    failed: Mapping[str, str],
    sealed: int,
    settings: Mapping[str, Any],
    about: Mapping[str, Any],
) -> str:
    simulation = "known from recorded predictions only" if settings["predictions"] else "run by the diagnosis"
    lines = [
        f"Seed {about['seed']}: {len(cases)} of {sealed} sealed cases, {about['seconds']:g} s per recording, "
        f"simulation {simulation}, {'with' if settings['reference'] else 'without'} reference recordings; "
        f"{np.median([case.seconds for case in cases]):.1f} s per case (median, one thread)."
    ]
    lines += [f"Case {case} could not be diagnosed: {reason}" for case, reason in failed.items()]
    return "  \n".join(lines)


def _outcomes(
    folder: Path, results: Path, labels: Sequence[dict[str, Any]], corrected: bool
) -> tuple[list[CaseOutcome], dict[str, str]]:
    """Return the outcomes of the cases, and the reasons of failures, which count as wrong."""
    outcomes, failed = [], {}
    for label in track(labels, "scoring", console=terminal.err, transient=True, disable=not terminal.err.is_terminal):
        case_results = results / label["case"]
        if not (case_results / ROW).is_file():
            continue
        row = _json(case_results / ROW)
        if row["status"] == "done":
            outcomes.append(_outcome(folder, case_results, label, row["seconds"], corrected))
        else:
            outcomes.append(build_case_outcome(label, FAILED_DIAGNOSIS, {}, {}, row["seconds"]))
            failed[label["case"]] = row["reason"]
    return outcomes, failed


def _outcome(folder: Path, results: Path, label: dict[str, Any], seconds: float, corrected: bool) -> CaseOutcome:
    gap = _json(results / GAP)
    truth = open_arrays(folder, label)
    figures = closure(truth, _load_replay(results / REPLAY), HELD_OUT[0])
    claimed = gap["composition"]["shrink"]
    if figures and claimed is not None:
        figures["shrink_error"] = abs(claimed - figures["closure"])
    misplaced = where_error(truth, gap["where"], (*REAL, *HELD_OUT), corrected)
    baselines = _json(results / DECISION)["baselines"]
    return build_case_outcome(label, gap, {**figures, **misplaced}, baselines, seconds)


def _load_replay(path: Path) -> dict[str, NDArray[np.float64]]:
    with np.load(path, allow_pickle=False) as replay:
        return {name: replay[name].astype(np.float64) for name in replay.files}


def _read_settings(results: Path, cases: Path) -> dict[str, Any]:
    """Return the settings of the run; raises CesError if the results belong to other cases."""
    settings = _json(results / SETTINGS)
    if settings.get("seal") not in ("", read_seal(cases)):
        raise CesError(f"{results}: holds results of other cases than {cases}")
    return settings


def _json(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise CesError(f"{path}: cannot be read ({error}); expected the output of 'ces blind run'") from None
