"""`ces identify --teacher SIM`: the distillation loss, as a table and in the model's provenance."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

from ces_cli.terminal import terminal
from ces_cli.terminal.tables import NONE, percent
from ces_gap.augmented.simulation_spec import file_of
from ces_identify.identification import IdentificationResult
from ces_identify.recordings.recording import Recording
from ces_identify.validation.distillation import DistillationCosts, compare_with_teacher


def with_teacher(result: IdentificationResult, teacher: str, measured: Sequence[Recording]) -> IdentificationResult:
    """Return `result` with its teacher in the model's provenance; `measured` are the recordings as logged."""
    rows = compare_with_teacher(result.model, result.evaluations, measured)
    file = file_of(teacher)
    facts = {
        "simulation": teacher,
        "sha256": None if file is None else hashlib.sha256(file.read_bytes()).hexdigest(),
        "cost_J_percent": [_as_row(row) for row in rows],
    }
    history = {**result.model.provenance, "teacher": facts}
    return replace(result, model=replace(result.model, provenance=history))


def print_teacher(result: IdentificationResult) -> None:
    """Print the teacher and the distillation loss from the provenance, if there was a teacher."""
    facts = result.model.provenance.get("teacher")
    if facts is None:
        return
    print(f"J above compares with the teacher {facts['simulation']}, not with the measured force")
    rows = facts["cost_J_percent"]
    if all(row["teacher_to_measured"] is None for row in rows):
        print("these recordings hold no measured force to compare the teacher with")
        return
    headings = ("model to teacher", "teacher to measured", "model to measured", "loss")
    table = terminal.make_table("distillation loss, J in %", ("recording",), headings)
    for row in rows:
        costs = (row["model_to_teacher"], row["teacher_to_measured"], row["model_to_measured"])
        loss = NONE if row["loss"] is None else f"{row['loss']:+.2f}"
        table.add_row(row["recording"], *(NONE if c is None else percent(c) for c in costs), loss)
    terminal.out.print(table)
    if any(None in row.values() for row in rows):
        print(f"{NONE}: a recording without a measured force, or a free run that diverged")


def _as_row(costs: DistillationCosts) -> dict[str, Any]:
    values = {key: value if isinstance(value, str) else _round_finite(value) for key, value in asdict(costs).items()}
    return {**values, "loss": _round_finite(costs.loss)}


def _round_finite(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None
