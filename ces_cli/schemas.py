"""The JSON Schemas (draft 7) of the YAML files and results, from the fields, options and tables that check them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ces_cli.identify.options import EXIT_WHEN_DONE, PARAMETERS
from ces_data.logs.log_mapping import DynoMapping
from ces_gap.report.calibration import calibrated_schema
from ces_gap.report.gap_json import gap_schema
from ces_identify.campaign.plan import FILE as CAMPAIGN
from ces_identify.polynomial.rules_file import rules_schema
from ces_identify.schema_files import ABOUT
from ces_iterate import plan as iterate_plan
from ces_iterate.rigs.kinds import RIG_SETTINGS
from ces_observer.fields import Schema
from ces_observer.json_text import write_atomically
from ces_observer.nodes import parameter_table
from ces_observer.options import Option
from ces_observer.records import record_schema
from ces_observer.signals import FIELDS, NAMES, UNITS
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.dampers.kinds import HYDRAULIC, LUMPED
from ces_rig.drive import currents, strokes
from ces_rig.drive.sequences import KIND as SEQUENCE
from ces_rig.drive.sequences import MAX_PARTS, TimedPart
from ces_rig.drive.servo_actuator import ServoActuator
from ces_rig.experiment import KEYS, ExperimentSettings
from ces_rig.live.rig import OF_THE_NODE as OF_THE_RIG_NODE
from ces_rig.live.rig import OF_THE_RIG
from ces_rig.sensors import Sensors

TEXT: Schema = {"type": "string"}
FLAG: Schema = {"type": "boolean"}
NUMBER: Schema = {"type": "number"}
TEXTS: Schema = {"type": "array", "items": TEXT}


def with_description(schema: Schema, text: str) -> Schema:
    """Return `schema` with a description, which editors show beside the key."""
    return {**schema, "description": text}


def mapping_of(properties: Mapping[str, Schema], required: Sequence[str] = (), about: str = "") -> Schema:
    """Return the schema of a mapping with these keys and no others."""
    schema: Schema = {"type": "object", "properties": dict(properties), "additionalProperties": False}
    schema |= {"required": list(required)} if required else {}
    return schema | ({"description": about} if about else {})


def one_of(values: Iterable[object]) -> Schema:
    """Return the schema of a choice."""
    return {"enum": list(values)}


def number_between(low: float, high: float) -> Schema:
    """Return the schema of a number in [low, high]."""
    return {"type": "number", "minimum": low, "maximum": high}


def list_of(item: Schema, least: int = 0) -> Schema:
    """Return the schema of a list."""
    return {"type": "array", "items": item} | ({"minItems": least} if least else {})


def list_branches(kinds: Mapping[str, type[Any]], more: type[Any] | None = None) -> dict[str, Schema]:
    """Return the schema of each kind for `choose_by_kind`; `more` has the keys that all kinds share."""
    common = record_schema(more)["properties"] if more else {}
    branches = {}
    for name, cls in kinds.items():
        own = record_schema(cls)
        properties = {"kind": {"const": name}, **own["properties"], **common}
        branches[name] = mapping_of(properties, ["kind", *own.get("required", ())], own["description"])
    return branches


def choose_by_kind(branches: Mapping[str, Schema]) -> Schema:
    """Return a schema that applies the branch of a mapping's `kind`, so that an error names the key at fault."""
    rules = [
        {"if": {"properties": {"kind": {"const": name}}, "required": ["kind"]}, "then": branch}
        for name, branch in branches.items()
    ]
    return {"properties": {"kind": one_of(branches)}, "type": "object", "required": ["kind"], "allOf": rules}


def of_parameters(table: Iterable[Option]) -> dict[str, Schema]:
    """Return the schemas of a node's parameters, nested where a name has dots."""
    groups: dict[str, Any] = {}
    for option in table:
        first, _, rest = option.name.partition(".")
        if rest:
            groups.setdefault(first, []).append(replace(option, name=rest))
        else:
            groups[first] = option
    return {
        name: value.schema if isinstance(value, Option) else mapping_of(of_parameters(value))
        for name, value in groups.items()
    }


SIGNAL_SETTINGS: dict[str, Schema] = {name: one.schema for name, one in FIELDS.items()}


def signal_properties() -> dict[str, Schema]:
    """Return the schema of each signal in a signals file or a node's parameters."""
    return {name: mapping_of(SIGNAL_SETTINGS, about=f"{name} [{UNITS[name]}]") for name in NAMES}


def dotted_signals() -> dict[str, Schema]:
    """Return patterns of names such as `position.topic`, which ROS 2 reads as the nested form."""
    return {rf"^({'|'.join(NAMES)})\.{key}$": schema for key, schema in SIGNAL_SETTINGS.items()}


def parameter_file(own: Mapping[str, Schema], patterns: Mapping[str, Schema], others: Schema | bool) -> Schema:
    """Return the schema of a ROS 2 parameter file: below node names, `ros__parameters` with these parameters."""
    parameters = {
        "type": "object",
        "properties": dict(own),
        "patternProperties": dict(patterns),
        "additionalProperties": others,
    }
    section = {
        "type": "object",
        "properties": {"ros__parameters": {"$ref": "#/definitions/parameters"}},
        "additionalProperties": {"$ref": "#/definitions/section"},
        "minProperties": 1,
    }
    definitions = {"parameters": parameters, "section": section}
    root = {"type": "object", "additionalProperties": {"$ref": "#/definitions/section"}, "minProperties": 1}
    return {**root, "definitions": definitions}


def signals_schema() -> Schema:
    """Return the schema of a signals file: a parameter file, or a plain mapping of signals."""
    signals, patterns = signal_properties(), dotted_signals()
    own = {parameter_table.DAMPERS: with_description(list_of(TEXT), parameter_table.DAMPERS_MEANING), **signals}
    damper = {**mapping_of(signals), "patternProperties": patterns}
    file = parameter_file(own, patterns, damper)
    plain = {"$ref": "#/definitions/parameters"}
    as_parameters = {key: file[key] for key in ("type", "additionalProperties", "minProperties")}
    is_plain = {"anyOf": [{"required": [name]} for name in (*NAMES, parameter_table.DAMPERS)]}
    plain_names = {"propertyNames": {"not": {"pattern": rf"^({'|'.join(NAMES)})\."}}}
    return {
        "type": "object",
        "if": {"anyOf": [is_plain, {"not": plain_names}]},
        "then": plain,
        "else": as_parameters,
        "definitions": file["definitions"],
    }


def experiment_schema() -> Schema:
    """Return the schema of an experiment on the virtual rig."""
    hydraulic = record_schema(Damper, partial=True)
    described = "values that differ from the default damper, or the name of a damper file beside this one"
    properties = {
        **record_schema(ExperimentSettings)["properties"],
        "stroke": _with_sequences(strokes.KINDS, strokes.Common),
        "current": _with_sequences(currents.KINDS, not_in_parts=("reg1",)),
        "damper": with_description({"anyOf": [TEXT, hydraulic]}, described),
        "sensors": record_schema(Sensors, partial=True),
        "actuator": record_schema(ServoActuator),
    }
    return mapping_of({key: properties[key] for key in KEYS}, ("stroke", "current"))


def damper_schema() -> Schema:
    """Return the schema of a damper of any kind."""
    hydraulic = record_schema(Damper, partial=True)
    hydraulic["properties"] = {"kind": {"const": HYDRAULIC}, **hydraulic["properties"]}
    first = {"if": {"properties": {"kind": {"const": HYDRAULIC}}}, "then": hydraulic}
    kind = {"kind": one_of((HYDRAULIC, *LUMPED))}
    return {"type": "object", "properties": kind, "allOf": [first, *choose_by_kind(list_branches(LUMPED))["allOf"]]}


def _with_sequences(
    kinds: Mapping[str, type[Any]], more: type[Any] | None = None, not_in_parts: Iterable[str] = ()
) -> Schema:
    """Return the schema of a stroke or current; the parts of a sequence are of the other kinds and have a duration."""
    whole = list_branches({name: cls for name, cls in kinds.items() if name != SEQUENCE}, more)
    lasting = record_schema(TimedPart)
    in_parts = {
        name: {
            **branch,
            "properties": {**branch["properties"], **lasting["properties"]},
            "required": [*branch["required"], *lasting["required"]],
        }
        for name, branch in whole.items()
        if name not in not_in_parts
    }
    parts = {**list_of(choose_by_kind(in_parts), 1), "maxItems": MAX_PARTS}
    about = (kinds[SEQUENCE].__doc__ or "").strip()
    sequence = mapping_of({"kind": {"const": SEQUENCE}, "parts": parts}, ("kind", "parts"), about)
    return choose_by_kind({**whole, SEQUENCE: sequence})


def iterate_schema() -> Schema:
    """Return the schema of a plan for `ces iterate`."""
    properties = dict(record_schema(iterate_plan.PlanSettings)["properties"])
    properties["rig"] = choose_by_kind(list_branches(RIG_SETTINGS))
    return mapping_of({key: properties[key] for key in iterate_plan.KEYS}, ("limits", "rig"))


ROS: dict[str, Schema] = {
    "use_sim_time": with_description(FLAG, "take time from /clock"),
    "start_type_description_service": FLAG,
    "qos_overrides": with_description({"type": "object"}, "quality of service by resolved topic name"),
}
ROS_DOTTED: dict[str, Schema] = {rf"^({'|'.join(parameter_table.OF_ROS)})\.": {}}


def observer_schema() -> Schema:
    """Return the schema of the observer's parameters: of the node, of each damper, and of its signals."""
    of_a_damper = {**of_parameters((*parameter_table.OF_A_DAMPER, parameter_table.NAME)), **signal_properties()}
    dampers = with_description(list_of(TEXT), parameter_table.DAMPERS_MEANING)
    own = {**of_parameters(parameter_table.OF_THE_NODE), **of_a_damper, parameter_table.DAMPERS: dampers}
    damper = {**mapping_of(of_a_damper), "patternProperties": dotted_signals()}
    return parameter_file({**own, **ROS}, {**dotted_signals(), **ROS_DOTTED}, damper)


def node_schema(table: Sequence[Option], with_dots: bool = False) -> Schema:
    """Return the schema of a node's parameters, `with_dots` also by the names that ROS 2 reads as the nested form."""
    dotted = {rf"^{re.escape(option.name)}$": option.schema for option in table if "." in option.name}
    return parameter_file({**of_parameters(table), **ROS}, (dotted if with_dots else {}) | ROS_DOTTED, False)


DRAFT = "http://json-schema.org/draft-07/schema#"
BUILDERS: Mapping[str, Callable[[], Schema]] = {
    "signals": signals_schema,
    "import": partial(record_schema, DynoMapping),
    "candidates": rules_schema,
    "campaign": lambda: CAMPAIGN.schema,
    "experiment": experiment_schema,
    "damper": damper_schema,
    "iterate": iterate_schema,
    "observer": observer_schema,
    "controller": partial(node_schema, parameter_table.OF_THE_CONTROLLER),
    "rig-node": partial(node_schema, (*OF_THE_RIG_NODE, *OF_THE_RIG), with_dots=True),
    "identify-node": partial(node_schema, (*PARAMETERS, EXIT_WHEN_DONE)),
    "gap": gap_schema,
    "calibrated": calibrated_schema,
}


def build_schema(name: str) -> str:
    """Return the text of a schema's file."""
    head = {"$schema": DRAFT, "title": ABOUT[name]}
    return json.dumps({**head, **BUILDERS[name]()}, indent=1, ensure_ascii=False) + "\n"


def write_schemas(folder: Path) -> None:
    """Write all schemas into a folder, which is made if it does not exist."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in BUILDERS:
        write_atomically(folder / f"{name}.json", build_schema(name))
