"""`ces identify --teacher SIM`: what the model lost of its teacher, in a table and in the model's provenance."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

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
        "cost_J_percent": [_row(row) for row in rows],
    }
    history = {**result.model.provenance, "teacher": facts}
    return replace(result, model=replace(result.model, provenance=history))


def print_teacher(result: IdentificationResult) -> None:
    """Print what the provenance says of the teacher, if there was one."""
    facts = result.model.provenance.get("teacher")
    if facts is None:
        return
    print(f"J above is against the teacher {facts['simulation']}, not against a measured force")
    rows = facts["cost_J_percent"]
    if all(row["teacher_to_measured"] is None for row in rows):
        print("these recordings hold no measured force to judge the teacher by")
        return
    terminal.out.print(_table(rows))


def _row(row: DistillationCosts) -> dict[str, Any]:
    return {
        "recording": row.recording,
        "role": row.role,
        "model_to_teacher": _round_finite(row.model_to_teacher),
        "teacher_to_measured": _round_finite(row.teacher_to_measured),
        "model_to_measured": _round_finite(row.model_to_measured),
        "loss": _round_finite(row.loss),
    }


def _table(rows: Sequence[dict[str, Any]]) -> Table:
    look: dict[str, Any] = {"title_justify": "left", "header_style": "bold", "box": SIMPLE_HEAD}
    table = Table(title="what the distillation loses, J in %", padding=(0, 1, 0, 0), **look)
    table.add_column("recording", overflow="fold")
    for heading in ("model to teacher", "teacher to measured", "model to measured", "loss"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        costs = (row["model_to_teacher"], row["teacher_to_measured"], row["model_to_measured"])
        loss = NONE if row["loss"] is None else f"{row['loss']:+.2f}"
        table.add_row(row["recording"], *(NONE if c is None else percent(c) for c in costs), loss)
    return table


def _round_finite(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None
