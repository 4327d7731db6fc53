"""`ces schema`: prints the JSON Schema of a kind of YAML file, for editors and other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ces_cli.schemas import build_schema, write_schemas
from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, JSON, ProgramRequest, argument, never_with, only_with, option
from ces_cli.terminal.outputs import make_schemas, print_document, require_folder
from ces_identify.schema_files import ABOUT, KEYWORD, path_of_schema
from ces_observer.records import declare


@dataclass(frozen=True, kw_only=True)
class SchemaRequest(ProgramRequest):
    """What `ces schema` is asked for."""

    name: str | None = argument(None, f"one of {', '.join(ABOUT)}", choices=tuple(ABOUT), metavar="NAME", count="?")
    path: bool = option(False, "print the path of the schema's file instead")
    list: bool = option(False, "list the schemas and exit")
    all: Path | None = option(None, "write all schemas into a folder and exit", metavar="DIR")
    json: bool = declare(JSON)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    parser = make_parser()
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


def make_parser() -> terminal.Parser[SchemaRequest]:
    """Return the parser of the program."""
    return terminal.parser(
        "schema",
        "Print the JSON Schema (draft 7) of a kind of YAML file. An editor with a YAML language server completes and "
        f"checks a file whose first line is '{KEYWORD}PATH', where PATH is what --path prints.",
        "ces schema signals > signals.schema.json\n  ces schema --list",
        SchemaRequest,
        rules=(
            never_with(ALL, "list", "does not apply with --list, which lists all schemas", but="list json"),
            never_with(ALL, "all", "does not apply with --all, which writes all schemas", but="all"),
            only_with("json", "list", "applies to --list; a schema itself is JSON"),
        ),
    )
