"""Schemas of the virtual rig's files: experiments and dampers, which are also simulations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ces_cli.discovery.schemas.parts import (
    TEXT,
    Schema,
    choose_by_kind,
    list_branches,
    list_of,
    mapping_of,
    of_dataclass,
    of_kinds,
    one_of,
    with_description,
)
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.dampers.kinds import HYDRAULIC, LUMPED
from ces_rig.drive import currents, strokes
from ces_rig.drive.sequences import KIND as SEQUENCE
from ces_rig.drive.sequences import MAX_PARTS, Lasting
from ces_rig.drive.servo_actuator import ServoActuator
from ces_rig.experiment import KEYS, ExperimentSettings
from ces_rig.sensors import Sensors


def experiment_schema() -> Schema:
    """Return the schema of an experiment on the virtual rig."""
    hydraulic = of_dataclass(Damper, partial=True)
    described = "values that differ from the default damper, or the name of a damper file beside this one"
    properties = {
        **of_dataclass(ExperimentSettings)["properties"],
        "stroke": _with_sequences(strokes.KINDS, strokes.Common),
        "current": _with_sequences(currents.KINDS, not_in_parts=("reg1",)),
        "damper": with_description({"anyOf": [TEXT, hydraulic]}, described),
        "sensors": of_dataclass(Sensors, partial=True),
        "actuator": of_dataclass(ServoActuator),
    }
    return mapping_of({key: properties[key] for key in KEYS}, ("stroke", "current"))


def damper_schema() -> Schema:
    """Return the schema of a damper of any kind."""
    hydraulic = of_dataclass(Damper, partial=True)
    hydraulic["properties"] = {"kind": {"const": HYDRAULIC}, **hydraulic["properties"]}
    lumped = of_kinds(LUMPED)
    names = (HYDRAULIC, *LUMPED)
    first = {"if": {"properties": {"kind": {"const": HYDRAULIC}}}, "then": hydraulic}
    return {"type": "object", "properties": {"kind": one_of(names)}, "allOf": [first, *lumped["allOf"]]}


def _with_sequences(
    kinds: Mapping[str, type[Any]], more: type[Any] | None = None, not_in_parts: Iterable[str] = ()
) -> Schema:
    """Return the schema of a stroke or current; the parts of a sequence are of the other kinds and have a duration."""
    single = {name: cls for name, cls in kinds.items() if name != SEQUENCE}
    whole = list_branches(single, more)
    in_parts = {
        name: _with_duration(branch) for name, branch in zip(single, whole, strict=True) if name not in not_in_parts
    }
    parts = {**list_of(choose_by_kind(list(in_parts), list(in_parts.values())), 1), "maxItems": MAX_PARTS}
    about = (kinds[SEQUENCE].__doc__ or "").strip()
    sequence = mapping_of({"kind": {"const": SEQUENCE}, "parts": parts}, ("kind", "parts"), about)
    return choose_by_kind([*single, SEQUENCE], [*whole, sequence])


def _with_duration(branch: Schema) -> Schema:
    lasting = of_dataclass(Lasting)
    properties = {**branch["properties"], **lasting["properties"]}
    return {**branch, "properties": properties, "required": [*branch["required"], *lasting["required"]]}
