"""`ces identify --folds K`: every recording held out once, by as many further identifications."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ces_cli.identify.search_progress import SearchProgress
from ces_cli.identify.structures import select_identify_function
from ces_cli.terminal import terminal
from ces_cli.terminal.tables import fold_table
from ces_identify.folds import CrossValidation, cross_validate, split_folds
from ces_identify.identification import IdentificationResult
from ces_identify.recordings.recording import Recording
from ces_identify.structures.kit import IdentifyOptions

MAX_FOLDS = 1000


def add_folds(to: argparse.ArgumentParser) -> None:
    """Add the option --folds."""
    to.add_argument(
        "--folds",
        type=terminal.integer_between(0, MAX_FOLDS),
        default=0,
        metavar="K",
        help="also hold each of K folds of the BAGs out once (as many as BAGs: one at a time); a single BAG is cut "
        "into K stretches. Takes K times as long again (default 0: no)",
    )


def require_folds(options: argparse.Namespace, recordings: Sequence[Recording]) -> None:
    """Raise CesError before the long work if --folds asks for what `recordings` cannot give."""
    if options.folds:
        split_folds(recordings, options.folds)


def with_folds(
    result: IdentificationResult, options: argparse.Namespace, recordings: Sequence[Recording], how: IdentifyOptions
) -> IdentificationResult:
    """Cross-validate if --folds asks for it: print the table, and return `result` with the rows in its provenance."""
    if not options.folds:
        return result

    def identify(
        kept: Sequence[Recording], held_out: Sequence[Recording], fold: IdentifyOptions
    ) -> IdentificationResult:
        with SearchProgress(fold.limits) as progress:
            return select_identify_function(options)(kept, held_out, fold, progress.listen)

    folds = cross_validate(recordings, options.folds, identify, how)
    terminal.out.print(fold_table(folds))
    history = {**result.model.provenance, "cross_validation": as_rows(folds)}
    return replace(result, model=replace(result.model, provenance=history))


def as_rows(folds: CrossValidation) -> list[dict[str, Any]]:
    """Return the rows as the model file keeps them; a run that diverged has no J."""
    return [
        {
            "recording": row.recording,
            "fold": row.fold,
            "J_percent": round(row.cost, 4) if row.cost < float("inf") else None,
            "ci95_percent": [round(row.interval.low, 4), round(row.interval.high, 4)] if row.interval else None,
            "model": row.model,
        }
        for row in folds.rows
    ]
