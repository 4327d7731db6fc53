"""Models with two chambers offline: size, fit, batch run and table for the report."""

from __future__ import annotations

from collections.abc import Mapping

from ces_identify.physical.chambers_models import ChambersModels
from ces_identify.physical.common_groups import DataScales
from ces_identify.physical.physical_runs import run_chambers_model
from ces_identify.structures.kit import Fitter, Size, SizeOption, StructureKit
from ces_identify.structures.physical_fit import AUTO, physical_fitter
from ces_identify.structures.physical_table import physical_table
from ces_identify.trained.training import Training
from ces_observer.structures.chambers import Chambers

CURVES = (3, 5)  # sizes to try, after the first one only if better
MAX_CURVES = 8


def check_curves(text: str) -> object:
    """Raise ValueError if `text` is not a number of curves."""
    if text != AUTO and (not text.isdecimal() or not 2 <= int(text) <= MAX_CURVES):
        raise ValueError(f"{text!r} is not {AUTO} or a whole number from 2 to {MAX_CURVES}")
    return text


def _fitter(sizes: Mapping[str, Size]) -> Fitter:
    chosen = str(sizes["curves"])
    counts = CURVES if chosen == AUTO else (int(chosen),)

    def models(training: Training, scales: DataScales) -> list[ChambersModels]:
        return [ChambersModels(training, scales, rows=count) for count in counts]

    return physical_fitter("chambers", models)


CHAMBERS = StructureKit(
    option="chambers",
    about="two chambers with valves",
    body=Chambers,
    sizes=(
        SizeOption(
            "curves", AUTO, "valve curves of a model with chambers", f"{AUTO} or 2 to {MAX_CURVES}", check=check_curves
        ),
    ),
    fitter=_fitter,
    batch_run=run_chambers_model,
    table=physical_table,
)
