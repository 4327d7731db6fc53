"""What programs and scripts write, checked before their work begins.

What exists is replaced only with --overwrite (`overwrite=True`), an input never.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from ces_observer.errors import CesError, OptionName

NO_PAGES = (".pdf", ".png", ".svg", ".json", ".yaml", ".csv", ".md", ".txt", ".docx")  # that no report is
PAGE = ".html"
OUT, REPORT, OVERWRITE = OptionName("out"), OptionName("report"), OptionName("overwrite", True)
Outputs = Mapping[OptionName, Path | None] | Mapping[str, Path | None] | Mapping[OptionName | str, Path | None]
"""Paths by the option that names them, or by words; None is an output that nobody asked for."""


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


def require_model_name(path: Path) -> None:
    """Raise CesError unless a path names a JSON file, as which a model is written."""
    if path.suffix.lower() != ".json":
        raise CesError(f"{path}: a model is a JSON file; expected a name that ends in .json")


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
    if not path.exists() and path.suffix.lower() in (PAGE, *NO_PAGES):
        raise CesError(f"{path}: is named like a file; several are written, expected the name of a folder")
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
