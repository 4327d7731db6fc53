"""The model structures that can be identified: the module of each.

A structure that the vehicle knows has its desk side in the module of the same name here, which declares a
`StructureKit`. Everything else asks the kits.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

from ces_data.arrays import F, I, Mask
from ces_identify.prepare.series import SimulatedSeries
from ces_identify.structures.kit import StructureKit
from ces_observer.model import Model
from ces_observer.structures import STRUCTURES
from ces_observer.structures.structure import Structure
from ces_report.table import Section


def _find_kit(body: type[Structure]) -> StructureKit[Any]:
    module = import_module(f"{__name__}.{body.__module__.rpartition('.')[2]}")
    return next(value for value in vars(module).values() if isinstance(value, StructureKit))


_ALL = {body.option: _find_kit(body) for body in STRUCTURES.values()}
KITS = {name: kit for name, kit in _ALL.items() if kit.body.is_offered}  # by their names for users, the default first


def kit_of(body: Structure) -> StructureKit[Any]:
    """Return the kit of a structure."""
    return KITS.get(body.option) or _ALL[body.option]


def run_batch(model: Model, inputs: F, segments: I) -> tuple[F, Mask]:
    """Return the batch run of a model, as `StructureKit.batch_run` describes it."""
    return kit_of(model.body).batch_run(model.body, model.operating_range, inputs, segments)


def model_section(model: Model, runs: Sequence[SimulatedSeries], role: str) -> Section:
    """Return the section of the model's parameters for a report; `role` is the role of `runs`."""
    return kit_of(model.body).table(model.body, model, runs, role)
