"""Writes the schemas into ces_identify/schemas: `python -m ces_cli.discovery.write_schemas`, after a table changed."""

from __future__ import annotations

from ces_cli.discovery.schemas.table import BUILDERS, build_schema
from ces_identify.schema_files import path_of_schema
from ces_observer.json_checks import write_atomically

if __name__ == "__main__":
    for name in BUILDERS:
        write_atomically(path_of_schema(name), build_schema(name))
