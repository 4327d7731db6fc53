"""The registry of model structures that can be identified: a module and a `StructureKit` for each. The first is the
default.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ces_identify.numerics.arrays import F, I
from ces_identify.preparation.simulated_series import SimulatedSeries
from ces_identify.structures.chambers import CHAMBERS
from ces_identify.structures.fuzzy import ANFIS
from ces_identify.structures.kit import StructureKit
from ces_identify.structures.network import SIGMOID
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_identify.structures.relaxation import RELAXATION
from ces_identify.typesetting import ModelTable
from ces_observer.model import Model

KITS: dict[str, StructureKit[Any]] = {kit.option: kit for kit in (POLYNOMIAL, SIGMOID, ANFIS, RELAXATION, CHAMBERS)}


def run_batch(model: Model, inputs: F, segments: I) -> tuple[F, int]:
    """Return the batch run of a model, as `StructureKit.batch_run` describes it."""
    return _find_kit(model).batch_run(model.body, model, inputs, segments)


def model_table(model: Model, runs: Sequence[SimulatedSeries], role: str) -> ModelTable:
    """Return the table of the model's parameters for a report; `role` is the role of `runs`."""
    return _find_kit(model).table(model.body, model, runs, role)


def _find_kit(model: Model) -> StructureKit[Any]:
    return next(kit for kit in KITS.values() if kit.body.name == model.structure)
