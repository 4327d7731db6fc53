"""The schema of `gap.json`, and what in a document does not follow it."""

from __future__ import annotations

from typing import Any

from jsonschema import Draft7Validator

from ces_gap.report.gap_json import gap_schema

SCHEMA = gap_schema()


def faults(document: dict[str, Any]) -> list[str]:
    """Return what is wrong with `document`, each with its place; empty if it follows the schema."""
    return [f"{error.json_path}: {error.message}" for error in Draft7Validator(SCHEMA).iter_errors(document)]
