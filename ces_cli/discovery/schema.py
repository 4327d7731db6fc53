"""`ces schema`: prints the JSON Schema of a kind of YAML file, for editors and other programs."""

from __future__ import annotations

from collections.abc import Sequence

from ces_cli.terminal import terminal
from ces_cli.terminal.json_output import add_json, print_document
from ces_cli.terminal.option_rules import ALL, never_with, only_with
from ces_identify.schema_files import ABOUT, KEYWORD, path_of_schema


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    parser = make_parser()
    options = parser.parse_args(argv)
    if options.list:
        _list(options.json)
    elif options.name is None:
        parser.error("expected NAME, or --list")
    elif options.path:
        print(path_of_schema(options.name))
    else:
        print(path_of_schema(options.name).read_text(encoding="utf-8"), end="")
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "schema",
        "Print the JSON Schema (draft 7) of a kind of YAML file. An editor with a YAML language server completes and "
        f"checks a file whose first line is '{KEYWORD}PATH', where PATH is what --path prints.",
        "ces schema signals > signals.schema.json\n  ces schema --list",
    )
    p.add_argument("name", nargs="?", choices=tuple(ABOUT), metavar="NAME", help=f"one of {', '.join(ABOUT)}")
    p.add_argument("--path", action="store_true", help="print the path of the installed schema instead")
    p.add_argument("--list", action="store_true", help="list the schemas and exit")
    add_json(p)
    p.rules = (
        never_with(ALL, "list", "does not apply with --list, which lists all schemas", but="list json"),
        only_with("json", "list", "applies to --list; a schema itself is JSON"),
    )
    return p


def _list(as_json: bool) -> None:
    if as_json:
        rows = [{"name": name, "about": about, "path": path_of_schema(name)} for name, about in ABOUT.items()]
        print_document("schema", {"schemas": rows})
        return
    for name, about in ABOUT.items():
        print(f"{name:<15}{about}")
