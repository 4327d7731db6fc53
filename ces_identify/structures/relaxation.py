"""Relaxation models offline: size, fit, batch run and table for the report."""

from __future__ import annotations

from collections.abc import Mapping

from ces_identify.physical.common_groups import DataScales
from ces_identify.physical.physical_runs import run_relaxation_model
from ces_identify.physical.relaxation_models import RelaxationModels
from ces_identify.structures.kit import Fitter, Size, SizeOption, StructureKit
from ces_identify.structures.physical_fit import AUTO, physical_fitter
from ces_identify.structures.physical_table import physical_table
from ces_identify.trained.training import Training
from ces_observer.structures.relaxation import Relaxation

SPRINGS = (2, 1, 4)  # sizes to try, after the first one only if better
MAX_SPRINGS = 6


def check_springs(text: str) -> object:
    """Raise ValueError if `text` is not a number of springs."""
    if text != AUTO and (not text.isdecimal() or not 1 <= int(text) <= MAX_SPRINGS):
        raise ValueError(f"{text!r} is not {AUTO} or a whole number from 1 to {MAX_SPRINGS}")
    return text


def _fitter(sizes: Mapping[str, Size]) -> Fitter:
    chosen = str(sizes["springs"])
    counts = SPRINGS if chosen == AUTO else (int(chosen),)

    def models(training: Training, scales: DataScales) -> list[RelaxationModels]:
        return [RelaxationModels(training, scales, springs=count) for count in counts]

    return physical_fitter("relaxation", models)


RELAXATION = StructureKit(
    option="relaxation",
    about="relaxation model (spring and valve in series)",
    body=Relaxation,
    sizes=(
        SizeOption(
            "springs",
            AUTO,
            "yielding springs of a relaxation model",
            f"{AUTO} or 1 to {MAX_SPRINGS}",
            check=check_springs,
        ),
    ),
    fitter=_fitter,
    batch_run=run_relaxation_model,
    table=physical_table,
)
