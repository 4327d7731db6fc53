"""What a program writes: names of reports, and the one JSON document of `--json`.

Every document begins with `schema`, its name and version, and `ces_observer`, the version of the suite. Numbers are not
rounded; one that is not finite is null.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from ces_identify import schema_files
from ces_observer import __version__

MAX_NAMED = 4  # recordings in the name of a report
MAX_LETTERS = 120  # of that name


def name_report(path: Path | None, simulations: Sequence[str], recordings: Sequence[str]) -> Path | None:
    """Return the file of a report: `path`, or in a folder `model_on_road_and_noise.html`; a bag counts as no folder."""
    if path is None or not path.is_dir() or (path / "metadata.yaml").exists():
        return path

    def join(names: Sequence[str]) -> str:
        more = len(names) - MAX_NAMED
        return "_and_".join([*names[:MAX_NAMED], *([f"{more}_more"] if more > 0 else [])])

    on = f"_on_{join(recordings)}" if recordings else ""
    name = re.sub(r"[^\w.+-]+", "-", f"{join(simulations)}{on}")
    return path / f"{name[:MAX_LETTERS]}.html"


SCHEMA_VERSION = 1


@contextlib.contextmanager
def without_text(wanted: bool) -> Iterator[None]:
    """Discard what is printed to standard output while the context is open, if `wanted` (the option --json)."""
    if not wanted:
        yield
        return
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
        yield


def print_document(program: str, content: Mapping[str, object]) -> None:
    """Print the document `ces-PROGRAM/VERSION` with `content`."""
    head = {"schema": f"ces-{program}/{SCHEMA_VERSION}", "ces_observer": __version__}
    document = {**head, **content, **head}  # the head first, whatever `content` has under its keys
    encoding = (getattr(sys.stdout, "encoding", None) or "utf-8").lower().replace("-", "")
    as_escapes = not encoding.startswith("utf")  # JSON has its own for characters that the output does not take
    print(json.dumps(as_plain(document), indent=1, allow_nan=False, ensure_ascii=as_escapes), flush=True)


def as_plain(value: object) -> Any:
    """Return `value` as JSON types.

    Arrays and other sequences become lists, dataclasses and mappings objects, paths texts, numbers that are not finite
    None. Raises TypeError for any other type.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): as_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [as_plain(item) for item in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if isinstance(value, Path):
        return str(value)
    if (to_list := getattr(value, "tolist", None)) is not None:  # an array or scalar of NumPy
        return as_plain(to_list())
    raise TypeError(f"{type(value).__name__} has no form in JSON")


BUILDERS = "ces_cli.schema"  # imports all packages
VERSION = "version.txt"


def schema_line(name: str) -> str:
    """Return the line that names the schema `name`."""
    make_schemas()
    return schema_files.schema_line(name)


def make_schemas() -> None:
    """Make the user's schemas, unless the build or this version has made them, or the folder cannot be written."""
    folder = schema_files.cache_folder() / "schemas"
    if schema_files.path_of_schema("signals").parent != folder:
        return
    try:
        if not (folder / VERSION).is_file() or (folder / VERSION).read_text(encoding="utf-8") != __version__:
            import_module(BUILDERS).write_schemas(folder)
            (folder / VERSION).write_text(__version__, encoding="utf-8")
    except OSError:
        return
