"""Schemas of the files that say where signals are: signals files, and mappings for `ces import`."""

from __future__ import annotations

from collections.abc import Mapping

from ces_cli.discovery.schemas.parts import (
    NUMBER,
    TEXT,
    Schema,
    list_of,
    mapping_of,
    number_between,
    one_of,
    with_description,
)
from ces_identify.recordings.log_mapping import BLANKS, COLUMN_KEYS, FORMATS, LAYOUT_KEYS, SOURCES
from ces_observer.nodes.observer_table import DAMPERS, DAMPERS_MEANING, SIGNAL_KEYS
from ces_observer.signals import LARGEST, LONGEST, MAX_DELAY_S, NAMES, UNITS

FACTOR: Schema = {"type": "number", "not": {"const": 0}, "minimum": -LARGEST, "maximum": LARGEST}
ABOUT_CONSTANT = "a known value that is not recorded, instead of a topic"
SIGNAL_SETTINGS: Mapping[str, Schema] = {
    "topic": {**TEXT, "minLength": 1, "maxLength": LONGEST},
    "type": {**TEXT, "pattern": r"^[A-Za-z]\w*/msg/[A-Za-z]\w*$", "maxLength": LONGEST},
    "field": {**TEXT, "minLength": 1, "maxLength": LONGEST},
    "scale": FACTOR,
    "offset": number_between(-LARGEST, LARGEST),
    "delay": number_between(-MAX_DELAY_S, MAX_DELAY_S),
    "constant": number_between(-LARGEST, LARGEST),
}
LAYOUT: Mapping[str, Schema] = {
    "format": with_description(one_of(FORMATS), "left out, the file's suffix decides"),
    "delimiter": with_description({**TEXT, "minLength": 1, "maxLength": 1}, "between the cells of a CSV file"),
    "decimal": with_description(one_of((".", ",")), "mark in the numbers of a CSV file"),
    "blank": with_description(one_of(BLANKS), "a blank cell is a mistake, or a sample that was not taken"),
    "dbc": with_description({"type": ["string", "array"], "items": TEXT}, "databases of a CAN log (.dbc)"),
    "header_lines": with_description(
        number_between(0, float("inf"), whole=True), "lines before the first row of numbers"
    ),
    "names": with_description(list_of({"type": ["string", "number"]}), "names for the columns"),
    "rows": with_description(TEXT, "where the table is in a JSON or MAT file, a path such as results.data"),
}


def signal_properties() -> dict[str, Schema]:
    """Return the schema of each signal in a signals file or a node's parameters."""
    about = {**SIGNAL_KEYS, "constant": ABOUT_CONSTANT}
    settings = {key: with_description(schema, about[key]) for key, schema in SIGNAL_SETTINGS.items()}
    return {name: mapping_of(settings, about=f"{name} [{UNITS[name]}]") for name in NAMES}


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
    own = {DAMPERS: with_description(list_of(TEXT), DAMPERS_MEANING), **signals}
    damper = {**mapping_of(signals), "patternProperties": patterns}
    file = parameter_file(own, patterns, damper)
    plain = {"$ref": "#/definitions/parameters"}
    as_parameters = {key: file[key] for key in ("type", "additionalProperties", "minProperties")}
    is_plain = {"anyOf": [{"required": [name]} for name in (*NAMES, DAMPERS)]}
    plain_names = {"propertyNames": {"not": {"pattern": rf"^({'|'.join(NAMES)})\."}}}
    return {
        "type": "object",
        "if": {"anyOf": [is_plain, {"not": plain_names}]},
        "then": plain,
        "else": as_parameters,
        "definitions": file["definitions"],
    }


def import_schema() -> Schema:
    """Return the schema of a mapping for `ces import`."""
    scaling = {"scale": {**NUMBER, "not": {"const": 0}}, "offset": NUMBER}
    column = {"type": ["string", "integer"], "minimum": 0}
    kinds = {
        "column": with_description(column, "name of the column, or its number from 0"),
        "constant": with_description(NUMBER, "the same value in all rows"),
        "from_name": with_description(
            {"type": "string", "format": "regex"}, "the first group, found in the file's name"
        ),
    }
    of_a_column = {
        "unit": with_description(TEXT, "unit of the column, instead of scale and offset"),
        "group": with_description({"type": ["string", "integer"]}, "number or name of a channel group or bus"),
        "date": with_description({**TEXT, "pattern": "%"}, 'pattern of a date, such as "%d/%m/%Y %H:%M:%S.%f"'),
    }
    about_scale = "value in SI units = scale * cell + offset"
    settings = {**kinds, **{key: with_description(schema, about_scale) for key, schema in scaling.items()}}
    settings |= {key: of_a_column[key] for key in COLUMN_KEYS}
    either = {"not": {"required": ["unit"], "anyOf": [{"required": ["scale"]}, {"required": ["offset"]}]}}
    of_time = {**mapping_of(settings, ("column",)), **either}
    del settings["date"]
    source = {**mapping_of(settings), **either, "oneOf": [{"required": [key]} for key in SOURCES]}
    only_column = {**mapping_of(settings, ("column",)), **either}
    properties = {
        **{name: with_description(source, f"{name} [{UNITS[name]}] after scaling") for name in NAMES},
        **LAYOUT,
        "time": with_description(of_time, "[s] after scaling"),
        "rate": {"anyOf": [{**NUMBER, "exclusiveMinimum": 0}, only_column], "description": "[Hz], instead of time"},
    }
    keys = (*LAYOUT_KEYS, *NAMES)
    whole = mapping_of({key: properties[key] for key in keys}, ("position", "current", "force"))
    return {**whole, "not": {"required": ["time", "rate"]}}
