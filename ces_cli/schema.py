"""`ces schema`: prints the JSON Schema of a kind of YAML file, for editors and other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ces_cli.schemas import build_schema, write_schemas
from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, JSON, Argument, never_with, only_with
from ces_cli.terminal.outputs import make_schemas, print_document, require_folder
from ces_identify.schema_files import ABOUT, KEYWORD, path_of_schema
from ces_observer.options import Option


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    parser = make_parser()
    options = parser.parse_args(argv)
    if options.list:
        make_schemas()
        if options.json:
            rows = [{"name": name, "about": about, "path": path_of_schema(name)} for name, about in ABOUT.items()]
            print_document("schema", {"schemas": rows})
        else:
            print("\n".join(f"{name:<15}{about}" for name, about in ABOUT.items()))
    elif options.all is not None:
        require_folder(options.all)
        write_schemas(options.all)
    elif options.name is None:
        parser.error("expected NAME, --list or --all DIR")
    elif options.path:
        make_schemas()
        print(path_of_schema(options.name))
    else:
        print(build_schema(options.name), end="")
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    return terminal.parser(
        "schema",
        "Print the JSON Schema (draft 7) of a kind of YAML file. An editor with a YAML language server completes and "
        f"checks a file whose first line is '{KEYWORD}PATH', where PATH is what --path prints.",
        "ces schema signals > signals.schema.json\n  ces schema --list",
        Argument("name", None, f"one of {', '.join(ABOUT)}", choices=tuple(ABOUT), metavar="NAME", count="?"),
        Option("path", False, "print the path of the schema's file instead"),
        Option("list", False, "list the schemas and exit"),
        Option("all", None, "write all schemas into a folder and exit", kind=Path, metavar="DIR"),
        JSON,
        rules=(
            never_with(ALL, "list", "does not apply with --list, which lists all schemas", but="list json"),
            never_with(ALL, "all", "does not apply with --all, which writes all schemas", but="all"),
            only_with("json", "list", "applies to --list; a schema itself is JSON"),
        ),
    )
