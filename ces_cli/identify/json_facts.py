"""An identification as the document of `ces identify --json`."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from ces_cli.identify.identification import Identification
from ces_cli.terminal.json_costs import cost_rows, fold_rows, held_out_row, model_facts
from ces_identify.folds import CrossValidation
from ces_identify.identification import IdentificationResult
from ces_identify.preparation.weighting import parse_weighting
from ces_identify.validation.distillation import compare_with_teacher


def identification_facts(
    result: IdentificationResult, folds: CrossValidation | None, work: Identification, options: argparse.Namespace
) -> dict[str, Any]:
    """Return what the program prints: the model, its costs, the search, and the files written."""
    best, model = result.search_results[0], result.model
    weighting = parse_weighting(options.weight).with_common_stroke([e.series for e in result.evaluations])
    return {
        "model": {"path": options.out, **model_facts(model)},
        "certificate": model.certificate,
        "weights": str(weighting) if weighting else None,
        "recordings": cost_rows(result.evaluations, weighting),
        "all_held_out": held_out_row(result.evaluations),
        "search": {"starts": len(result.search_results), "best_seed": best.seed, "stopped": best.ended},
        "structures": model.provenance["selection"].get("structures", {}),
        "folds": fold_rows(folds),
        "teacher": _teacher_rows(result, work, options),
        "findings": work.findings,
        "report": options.report,
        "picture": options.picture,
    }


def _teacher_rows(
    result: IdentificationResult, work: Identification, options: argparse.Namespace
) -> list[dict[str, Any]] | None:
    """Return the distillation loss on each recording; None without a teacher."""
    if options.teacher is None:
        return None
    rows = compare_with_teacher(result.model, result.evaluations, work.measured)
    return [asdict(row) | {"loss": row.loss} for row in rows]
