"""`ces identify --folds K`: cross-validation, which holds every recording out once."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from typing import Any

from ces_cli.identify.structures import select_identify_function
from ces_cli.terminal import terminal
from ces_cli.terminal.progress import SearchProgress
from ces_cli.terminal.tables import NONE, fold_table
from ces_identify.folds import CrossValidation, HeldOutCost, cross_validate
from ces_identify.identification import IdentificationResult
from ces_identify.recordings.recording import Recording
from ces_identify.structures.kit import IdentifyOptions


def add_folds(to: argparse.ArgumentParser) -> None:
    """Add the option --folds."""
    text = (
        "cross-validate, too: hold out each of K folds of the BAGs once (K = number of BAGs: one at a time); a single "
        "BAG is cut into K stretches. Takes K times as long again (default 0: off)"
    )
    to.add_argument("--folds", type=terminal.integer_between(0, 1000), default=0, metavar="K", help=text)


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
    terminal.out.print(fold_table(folds))
    if any(row.interval is None for row in folds.rows):
        print(f"{NONE}: the free run diverged, or the recording is too short for an interval")
    history = {**result.model.provenance, "cross_validation": [_as_row(row) for row in folds.rows]}
    return replace(result, model=replace(result.model, provenance=history)), folds


def _as_row(row: HeldOutCost) -> dict[str, Any]:
    """Return a row as the model file stores it; a run that diverged has no J."""
    return {
        "recording": row.recording,
        "fold": row.fold,
        "J_percent": round(row.cost, 4) if isfinite(row.cost) else None,
        "ci95_percent": [round(row.interval.low, 4), round(row.interval.high, 4)] if row.interval else None,
        "model": row.model,
    }
