"""Schemas of the virtual rig's files: experiments and dampers, which are also simulations."""

from __future__ import annotations

from ces_cli.discovery.schemas.parts import TEXT, Schema, mapping_of, of_dataclass, of_kinds, one_of, with_description
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.dampers.kinds import HYDRAULIC, LUMPED
from ces_rig.drive import currents, strokes
from ces_rig.drive.servo_actuator import ServoActuator
from ces_rig.experiment import KEYS, ExperimentSettings
from ces_rig.sensors import Sensors


def experiment_schema() -> Schema:
    """Return the schema of an experiment on the virtual rig."""
    hydraulic = of_dataclass(Damper, partial=True)
    described = "values that differ from the default damper, or the name of a damper file beside this one"
    properties = {
        **of_dataclass(ExperimentSettings)["properties"],
        "stroke": of_kinds(strokes.KINDS, strokes.Common),
        "current": of_kinds(currents.KINDS),
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
