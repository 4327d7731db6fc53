"""The registry of structures that can be identified, by their names for users; the first is the default."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ces_identify.numerics.arrays import F, I
from ces_identify.preparation.simulated_series import SimulatedSeries
from ces_identify.structures.fuzzy import ANFIS
from ces_identify.structures.kit import StructureKit
from ces_identify.structures.network import SIGMOID
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_identify.typesetting import ModelTable
from ces_observer.model import Model

KITS: dict[str, StructureKit[Any]] = {kit.option: kit for kit in (POLYNOMIAL, SIGMOID, ANFIS)}


def run_batch(model: Model, inputs: F, segments: I) -> tuple[F, int]:
    """Return force (ticks,) [N] and the first tick out of the force envelope (-1 if none), from each segment's start.

    `inputs` (3, ticks) are position [m], speed [m/s] and current [A].
    """
    return _kit_of(model).batch_run(model.body, model, inputs, segments)


def model_table(model: Model, runs: Sequence[SimulatedSeries], role: str) -> ModelTable:
    """Return the model's numbers as a report shows them; `role` names what the runs are of."""
    return _kit_of(model).table(model.body, model, runs, role)


def _kit_of(model: Model) -> StructureKit[Any]:
    return next(kit for kit in KITS.values() if kit.body.name == model.structure)
