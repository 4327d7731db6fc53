"""The page of files: the keys of each YAML file and gap.json from its schema, those of model.json from its classes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from bench.reference.tables import as_text, code, codes, first_paragraph, table
from ces_cli.schema import build_schema
from ces_identify.characteristics.rows import TABLES
from ces_identify.schema_files import ABOUT
from ces_observer.signals import NAMES

Schema = Mapping[str, Any]
FILES = ("signals", "import", "candidates", "rules", "campaign", "experiment", "iterate")
DEPTH = 2
OF_SIGNALS = ("signals", "import", "candidates")  # files whose first keys are signals
SIGNAL = re.compile(rf"^({'|'.join(NAMES)})\b")
SENSOR = re.compile(rf"^sensors\.({'|'.join(NAMES)})\b")
SKIPPED = re.compile(
    r"^structures\.|^limits\.(time|target|starts|threads)$|\.parts\[\]|\.again\.|^(time|rate)\.(?!date)|^(name|description)$|^damper\.|^identify\.|^(stroke|current|rig)\.kind$"
)
SHARED = ("rig.", "actuator.")  # alike in all files
OF_ALL_STROKES = ("offset_m", "fade_s")  # told at the top
HEAD = """
`ces schema NAME` prints the JSON Schema of a kind of file, with ranges and required keys; an editor that uses it
completes and checks the file. SIGNAL is a signal's name (or `time`). Keys `rig` and
`actuator` are alike in all files; `structures` and `limits` of a campaign have [options of `ces
identify`](programs.md#identify). A stroke also has `offset_m` (0) and `fade_s` (0.5), but for a sequence. Other files:
parameters of [nodes](nodes.md), dampers of [the virtual rig](../rig.md).
"""
MODEL = (
    ("schema", "`ces-model/1`"),
    ("structure", "name of the [structure](structures.md), whose own keys hold its parameters"),
    ("units", "of all numbers"),
    ("sampling", "rate [Hz], bank and delay of the speed, limits of stroke, outliers, gaps and warm-up"),
    (
        "input_envelope",
        "range of position, speed and current in the identification data, and of currents that it lacks",
    ),
    ("force_envelope_N", "range of the force that the observer publishes"),
    ("certificate", "claim, method and bounds of the proof; the observer proves it anew"),
    ("band", "half-width of the force's band, if one was fitted"),
    ("provenance", "recordings with hashes, costs, options, version, findings that were ignored"),
)


def files_page() -> str:
    """Return the page."""
    text, told = ["# Files", HEAD], set[str]()
    for name in FILES:
        text.append(f"## `{name}`\n\n{ABOUT[name]}.\n")
        rows = _rows(json.loads(build_schema(name)), name in OF_SIGNALS, told)
        text.append(table(("key", "values", "default", "meaning"), rows))
    text.append(f"## `gap.json`\n\n{ABOUT['gap']}. `ces schema gap` has all inner keys; they end with their unit.\n")
    text.append(table(("key", "meaning, or inner keys"), _gap_rows(json.loads(build_schema("gap")))))
    text.append("## `model.json`\n\nA model (`ces identify`); plain JSON, limited in size, never executed.\n")
    text.append(table(("key", "meaning"), ((code(key), about) for key, about in MODEL)))
    text.append("## Tables of `ces characterise`\n\n`columns.csv` beside them has unit and meaning of each column.\n")
    rows = ((code(f"{name}.csv"), first_paragraph(row)) for name, row in TABLES.items())
    return "\n".join([*text, table(("file", "a row"), rows)])


def _rows(root: Schema, of_signals: bool, told: set[str]) -> Iterator[tuple[str, str, str, str]]:
    """Yield the rows of a file; keys that several signals share are one row, keys of another file are left out."""
    for path, one in _walk(root, root):
        key = SENSOR.sub("sensors.SIGNAL", SIGNAL.sub("SIGNAL", path) if of_signals else path)
        row = code(key), _values(one), code(as_text(one.get("default"))), one.get("description", "").replace(" [1]", "")
        shared = f"{key} {row}" if key.startswith(SHARED) else f"{id(root)} {row}"
        if any(row[1:]) and not SKIPPED.search(key) and key not in ("SIGNAL", "sensors.SIGNAL") and shared not in told:
            yield row
        told.add(shared)


def _gap_rows(schema: Schema) -> Iterator[tuple[str, str]]:
    for name, one in schema["properties"].items():
        bare = next((part for part in one.get("anyOf", ()) if part.get("type") != "null"), one)
        values = (*filter(None, one.get("enum", ())), *bare.get("items", bare).get("properties", {}))
        yield code(name), one.get("description") or codes(map(str, values))


def _walk(schema: Schema, root: Schema, path: str = "") -> Iterator[tuple[str, Schema]]:
    """Yield path and schema of every key, those of lists and named entries with [] and NAME in the path.

    Of a mapping with a `kind`, each kind is one entry, which has its keys with their defaults as its values.
    """
    schema = _resolve(schema, root)
    for name, one in schema.get("properties", {}).items():
        inner = _resolve(one, root)
        if not inner.get("properties") and not inner.get("allOf"):
            yield f"{path}{name}", {**inner, **one}
        yield from _inside(inner, root, f"{path}{name}")
    for part in schema.get("allOf", ()):
        kind = part.get("if", {}).get("properties", {}).get("kind", {}).get("const")
        keys = {name: one for name, one in part.get("then", {}).get("properties", {}).items() if name != "kind"}
        about = part.get("then", {}).get("description", "")
        yield f"{path}kind: {kind}", {"keys": keys, "description": about}
    if "then" in schema:
        yield from _walk(schema["then"], root, path)


def _inside(schema: Schema, root: Schema, path: str) -> Iterator[tuple[str, str, Schema]]:
    if path.count(".") >= DEPTH:  # a rule may hold another
        return
    for one in (schema, *schema.get("anyOf", ())):
        if _resolve(one, root).get("type") == "object":
            yield from _walk(one, root, f"{path}.")
    if isinstance(schema.get("items"), dict) and _resolve(schema["items"], root).get("properties"):
        yield from _walk(schema["items"], root, f"{path}[].")
    other = schema.get("additionalProperties")
    if isinstance(other, dict) and _resolve(other, root).get("properties"):
        yield from _walk(other, root, f"{path}.NAME.")


def _resolve(schema: Schema, root: Schema) -> Schema:
    reference = schema.get("$ref", "")
    return root["definitions"][reference.rsplit("/", 1)[1]] if reference else schema


def _values(one: Schema) -> str:
    if "keys" in one:
        own = ((name, inner) for name, inner in one["keys"].items() if name not in OF_ALL_STROKES)
        defaults = ((name, as_text(inner.get("default"))) for name, inner in own)
        return ", ".join(
            f"`{name}{': ' + default if default and len(default) < 20 else ''}`" for name, default in defaults
        )
    if "const" in one:
        return code(one["const"])
    if "enum" in one:
        return codes(map(str, one["enum"]))
    if one.get("type") == "array":
        return f"list{' of ' + inner if (inner := _values(one.get('items', {}))) else ''}"
    return "true, false" if one.get("type") == "boolean" else ""
