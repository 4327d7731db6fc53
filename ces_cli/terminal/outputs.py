"""What a program writes: files and folders, checked before its work begins, and the one JSON document of `--json`.

What exists is replaced only with --overwrite, an input never. Every document begins with `schema`, its name and
version, and `ces_observer`, the version of the suite. Numbers are not rounded; one that is not finite is null.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from ces_identify import schema_files
from ces_observer import __version__
from ces_observer.errors import CesError, OptionName

NO_PAGES = (".pdf", ".png", ".svg", ".json", ".yaml", ".csv", ".md", ".txt", ".docx")  # that no report is
OUT, REPORT, OVERWRITE = OptionName("out"), OptionName("report"), OptionName("overwrite", True)
Outputs = Mapping[OptionName, Path | None] | Mapping[OptionName | str, Path | None]
"""Paths by the option that names them, or by words; None is an output that nobody asked for."""

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


def require_outputs(
    overwrite: bool,
    files: Outputs | None = None,
    bags: Outputs | None = None,
    folders: Outputs | None = None,
    inputs: Iterable[Path | None] = (),
) -> None:
    """Raise CesError unless all outputs can be written, differ and are no inputs; files and bags are replaced whole."""
    read = [path.resolve() for path in inputs if path is not None]
    seen: dict[Path, OptionName | str] = {}
    kinds = {"file": files, "bag": bags, "folder": folders}
    for kind, option, path in ((kind, *output) for kind, named in kinds.items() for output in (named or {}).items()):
        if path is None:
            continue
        _require_file(path) if kind == "file" else require_folder(path)
        other = seen.setdefault(path.resolve(), option)
        if other != option:
            raise CesError(f"{path}: is named by ", other, " and ", option, "; choose another name for one of them")
        if option == REPORT and path.suffix.lower() in NO_PAGES:
            raise CesError(
                f"{path}: a report is an HTML page; expected a name that ends in .html (a browser prints it to PDF)"
            )
        if kind != "folder":
            _require_no_input(path, option, read)
        if any(path.iterdir()) if path.is_dir() else path.is_file() or path.is_symlink():
            if kind == "bag" and path.is_dir() and not (path / "metadata.yaml").is_file():
                raise CesError(f"{path}: is a folder but not a bag, so it is not replaced; choose another name")
            if not overwrite:
                advice = f"{path}: exists; choose another name for ", option, ", or replace it with ", OVERWRITE
                raise CesError(*advice)


def _require_file(path: Path) -> None:
    if path.exists() and not path.is_file():
        what = "folder" if path.is_dir() else "device"
        raise CesError(f"{path}: is a {what}; expected the name of a file to write")
    if not path.parent.is_dir():
        raise CesError(f"{path}: the folder {path.parent} does not exist; make it first, or choose another")
    _require_writable(path.parent, path)


def require_folder(path: Path) -> None:
    """Raise CesError unless files can be written into the folder `path`, which need not exist yet."""
    if path.exists() and not path.is_dir():
        raise CesError(f"{path}: is not a folder; expected the name of a folder to write")
    existing = next(folder for folder in (path.absolute(), *path.absolute().parents) if folder.exists())
    if not existing.is_dir():
        raise CesError(f"{path}: {existing} is not a folder; expected a folder to write into")
    _require_writable(existing, path)


def _require_writable(folder: Path, path: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise CesError(f"{path}: the folder {folder.absolute()} cannot be written; choose another")


def _require_no_input(path: Path, option: OptionName | str, read: Sequence[Path]) -> None:
    """Raise CesError if an output would replace an input, or be a file in a bag that is read."""
    if any(source.is_relative_to(path.resolve()) for source in read):
        raise CesError(f"{path}: is an input, too; choose another name for ", option)
    inside = next((source for source in read if path.resolve().is_relative_to(source)), None)
    if inside is not None:
        raise CesError(f"{path}: is inside the input {inside.name}; choose another place for ", option)


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
