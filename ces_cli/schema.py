"""`ces schema`: prints the JSON Schema of a kind of YAML file or result, for editors and other programs.

The schemas (draft 7) are made of the fields, options and tables that check the files.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ces_cli.identify.request import EXIT_WHEN_DONE, PARAMETERS
from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, JSON, ProgramRequest, argument, never_with, only_with, option
from ces_cli.terminal.outputs import make_schemas, print_document
from ces_data.logs.log_mapping import DynoMapping
from ces_data.outputs import require_folder
from ces_gap.report.calibration import calibrated_schema
from ces_gap.report.gap_json import gap_schema
from ces_identify.campaign.plan import FILE as CAMPAIGN
from ces_identify.characteristics.rules import BenchRules
from ces_identify.polynomial.rules_file import rules_schema
from ces_identify.schema_files import ABOUT, KEYWORD, path_of_schema
from ces_observer.fields import Field, Schema
from ces_observer.json_text import write_atomically
from ces_observer.nodes import parameter_table
from ces_observer.options import Option
from ces_observer.records import declare, record_schema
from ces_observer.signals import FIELDS, NAMES, UNITS
from ces_rig.dampers.stepper import DAMPER
from ces_rig.experiments.virtual import Experiment
from ces_rig.live.rig import OF_THE_NODE as OF_THE_RIG_NODE
from ces_rig.live.rig import OF_THE_RIG
from ces_rig.loop.rigs import RIG, Plan


@dataclass(frozen=True, kw_only=True)
class SchemaRequest(ProgramRequest):
    """What `ces schema` is asked for."""

    program = "schema"
    about = (
        "Print the JSON Schema (draft 7) of a kind of YAML file. An editor with a YAML language server completes and "
        f"checks a file whose first line is '{KEYWORD}PATH', where PATH is what --path prints."
    )
    example = "ces schema signals > signals.schema.json\n  ces schema --list"
    option_rules = (
        never_with(ALL, "list", "does not apply with --list, which lists all schemas", but="list json"),
        never_with(ALL, "all", "does not apply with --all, which writes all schemas", but="all"),
        only_with("json", "list", "applies to --list; a schema itself is JSON"),
    )

    name: str | None = argument(None, f"one of {', '.join(ABOUT)}", choices=tuple(ABOUT), metavar="NAME", count="?")
    path: bool = option(False, "print the path of the schema's file instead")
    list: bool = option(False, "list the schemas and exit")
    all: Path | None = option(None, "write all schemas into a folder and exit", metavar="DIR")
    json: bool = declare(JSON)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    parser = terminal.parser(SchemaRequest)
    request = parser.read(argv)
    if request.list:
        make_schemas()
        if request.json:
            rows = [{"name": name, "about": about, "path": path_of_schema(name)} for name, about in ABOUT.items()]
            print_document("schema", {"schemas": rows})
        else:
            print("\n".join(f"{name:<15}{about}" for name, about in ABOUT.items()))
    elif request.all is not None:
        require_folder(request.all)
        write_schemas(request.all)
    elif request.name is None:
        parser.error("expected NAME, --list or --all DIR")
    elif request.path:
        make_schemas()
        print(path_of_schema(request.name))
    else:
        print(build_schema(request.name), end="")
    return 0


DAMPERS = Field(kind=str, many=True, meaning=parameter_table.DAMPERS_MEANING).schema
ROS = {
    "use_sim_time": Field(kind=bool, meaning="take time from /clock").schema,
    "start_type_description_service": Field(kind=bool).schema,
    "qos_overrides": Field(kind=Mapping, meaning="quality of service by resolved topic name").schema,
}
ROS_DOTTED: dict[str, Schema] = {rf"^({'|'.join(parameter_table.OF_ROS)})\.": {}}
SIGNAL_SETTINGS: dict[str, Schema] = {name: one.schema for name, one in FIELDS.items()}


def mapping_of(properties: Mapping[str, Schema], about: str = "") -> Schema:
    """Return the schema of a mapping with these keys and no others."""
    schema: Schema = {"type": "object", "properties": dict(properties), "additionalProperties": False}
    return schema | ({"description": about} if about else {})


def of_parameters(table: Iterable[Option]) -> dict[str, Schema]:
    """Return the schemas of a node's parameters, nested where a name has dots."""
    groups: dict[str, Any] = {}
    for parameter in table:
        first, _, rest = parameter.name.partition(".")
        if rest:
            groups.setdefault(first, []).append(replace(parameter, name=rest))
        else:
            groups[first] = parameter
    return {
        name: value.schema if isinstance(value, Option) else mapping_of(of_parameters(value))
        for name, value in groups.items()
    }


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
    own = {parameter_table.DAMPERS: DAMPERS, **signals}
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


def damper_schema() -> Schema:
    """Return the schema of a damper of any kind; without a kind it is hydraulic."""
    schema = DAMPER.bare_schema
    of_hydraulic = schema["allOf"][0]
    del schema["required"], of_hydraulic["if"]["required"], of_hydraulic["then"]["required"]
    return schema


def iterate_schema() -> Schema:
    """Return the schema of a plan for `ces iterate`."""
    schema = record_schema(Plan)
    return {**schema, "properties": {**schema["properties"], "rig": RIG.schema}}


def observer_schema() -> Schema:
    """Return the schema of the observer's parameters: of the node, of each damper, and of its signals."""
    of_a_damper = {**of_parameters((*parameter_table.OF_A_DAMPER, parameter_table.NAME)), **signal_properties()}
    own = {**of_parameters(parameter_table.OF_THE_NODE), **of_a_damper, parameter_table.DAMPERS: DAMPERS}
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
    "rules": partial(record_schema, BenchRules),
    "campaign": lambda: CAMPAIGN.schema,
    "experiment": partial(record_schema, Experiment),
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
