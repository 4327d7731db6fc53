"""Files and folders that a program writes: checked before its work begins, by one rule for all programs.

What exists is replaced only with --overwrite, an input never, and a result appears under its name only when it is
complete.
"""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from ces_observer.errors import CesError

NO_PAGES = (".pdf", ".png", ".svg", ".json", ".yaml", ".csv", ".md", ".txt", ".docx")  # that no report is
MAX_NAME = 240  # bytes; file systems allow 255, temporary files have some more than the final name
Outputs = Mapping[str, Path | None]
"""Paths by the option that names them, such as `--report`; None is an output that nobody asked for."""

MAX_NAMED = 4  # recordings in the name of a report
MAX_LETTERS = 120  # of that name


def add_report(to: argparse.ArgumentParser, purpose: str = "write a report page (HTML)") -> None:
    """Add the option --report; `purpose` says what is written."""
    text = f"{purpose}; in a folder: under a name that says which simulation and recordings"
    to.add_argument("--report", type=Path, metavar="FILE", help=text)


def name_report(path: Path | None, simulations: Sequence[str], recordings: Sequence[str]) -> Path | None:
    """Return the file of a report: `path`, or in a folder `model_on_road_and_noise.html`; a bag counts as no folder."""
    if path is None or not path.is_dir() or (path / "metadata.yaml").exists():
        return path
    on = f"_on_{_join_names(recordings)}" if recordings else ""
    name = re.sub(r"[^\w.+-]+", "-", f"{_join_names(simulations)}{on}")
    return path / f"{name[:MAX_LETTERS]}.html"


def _join_names(names: Sequence[str]) -> str:
    more = len(names) - MAX_NAMED
    return "_and_".join([*names[:MAX_NAMED], *([f"{more}_more"] if more > 0 else [])])


def add_overwrite(to: argparse.ArgumentParser) -> None:
    """Add the option --overwrite."""
    to.add_argument("--overwrite", action="store_true", help="replace outputs that exist (default: refuse)")


def require_outputs(
    overwrite: bool,
    files: Outputs | None = None,
    bags: Outputs | None = None,
    folders: Outputs | None = None,
    inputs: Iterable[Path | None] = (),
) -> None:
    """Raise CesError unless all outputs can be written, have different names and are no inputs.

    `files` and `bags` (one folder each) are replaced as a whole; `folders` receive results.
    """
    files, bags, folders = ({k: v for k, v in (some or {}).items() if v} for some in (files, bags, folders))
    for option, path in files.items():
        require_new_file(path, overwrite, option)
    for option, path in bags.items():
        require_new_bag(path, overwrite, option)
    for option, path in folders.items():
        require_new_folder(path, overwrite, option)
    _require_different({**files, **bags, **folders})
    _require_no_inputs({**files, **bags}, inputs)
    _require_page_name(files.get("--report"))


def require_new_file(path: Path | None, overwrite: bool, option: str = "") -> None:
    """Raise CesError unless a file can be written to `path`; None, an output that nobody asked for, is fine."""
    if path is None:
        return
    _require_short_name(path)
    if path.is_dir():
        raise CesError(f"{path}: is a folder; expected the name of a file to write")
    if path.exists() and not path.is_file():
        raise CesError(f"{path}: is a device; expected the name of a file to write")
    _require_absent(path, overwrite, option)
    if not path.parent.is_dir():
        raise CesError(f"{path}: the folder {path.parent} does not exist; make it first, or choose another")
    _require_writable(path.parent, path)


def require_new_folder(path: Path | None, overwrite: bool, option: str = "") -> None:
    """Raise CesError unless the folder `path` is new or empty, or its results may be replaced with --overwrite."""
    if path is None:
        return
    require_folder(path)
    if path.is_dir() and any(path.iterdir()):
        _require_absent(path, overwrite, option)


def require_new_bag(path: Path | None, overwrite: bool, option: str = "") -> None:
    """Raise CesError unless a bag can be written to the folder `path`: new, empty, or a bag to replace."""
    if path is None:
        return
    require_new_folder(path, overwrite, option)
    if path.is_dir() and any(path.iterdir()) and not (path / "metadata.yaml").is_file():
        raise CesError(f"{path}: is a folder but not a bag, so it is not replaced; choose another name")


def require_folder(path: Path) -> None:
    """Raise CesError unless results can be written into the folder `path`, which is made if it does not exist."""
    _require_short_name(path)
    if path.exists() and not path.is_dir():
        raise CesError(f"{path}: is not a folder; expected the name of a folder to write")
    existing = next(folder for folder in (path.absolute(), *path.absolute().parents) if folder.exists())
    if not existing.is_dir():
        raise CesError(f"{path}: {existing} is not a folder; expected a folder to write into")
    _require_writable(existing, path)


def _require_short_name(path: Path) -> None:
    """Raise CesError for a name that is too long for a file system, with what the temporary file beside it adds."""
    longest = max((len(os.fsencode(part)) for part in path.parts), default=0)
    if longest > MAX_NAME:
        raise CesError(f"{path}: a name in it has {longest} bytes; expected at most {MAX_NAME}, choose a shorter one")


def _require_absent(path: Path, overwrite: bool, option: str) -> None:
    if path.exists() and not overwrite:
        another = f"choose another name for {option}" if option else "choose another name"
        raise CesError(f"{path}: exists; {another}, or replace it with --overwrite")


def _require_writable(folder: Path, path: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise CesError(f"{path}: the folder {folder.absolute()} cannot be written; choose another")


def _require_different(outputs: Mapping[str, Path]) -> None:
    """Raise CesError if two outputs have the same path."""
    seen: dict[Path, str] = {}
    for option, path in outputs.items():
        first = seen.setdefault(path.resolve(), option)
        if first != option:
            raise CesError(f"{path}: is named by {first} and {option}; choose another name for one of them")


def _require_page_name(path: Path | None) -> None:
    """Raise CesError if a report is to have the name of another kind of file."""
    if path is not None and path.suffix.lower() in NO_PAGES:
        raise CesError(
            f"{path}: a report is an HTML page; expected a name that ends in .html (a browser prints it to PDF)"
        )


def _require_no_inputs(outputs: Mapping[str, Path], inputs: Iterable[Path | None]) -> None:
    """Raise CesError if an output would replace an input, or be a file in a bag that is read."""
    read = [path.resolve() for path in inputs if path is not None]
    for option, path in outputs.items():
        if any(one.is_relative_to(path.resolve()) for one in read):
            raise CesError(f"{path}: is an input, too; choose another name for {option}")
        inside = next((one for one in read if path.resolve().is_relative_to(one)), None)
        if inside is not None:
            raise CesError(f"{path}: is inside the input {inside.name}; choose another place for {option}")
