"""Files and folders that a program writes: checked before its work begins, by one rule for all programs.

What exists is replaced only with --overwrite, and a result appears under its name only when it is complete.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from ces_observer.errors import CesError


def add_overwrite(to: argparse.ArgumentParser) -> None:
    """Add the option --overwrite."""
    to.add_argument("--overwrite", action="store_true", help="replace outputs that exist (default: refuse)")


def require_new_file(path: Path | None, overwrite: bool) -> None:
    """Raise CesError unless a file can be written to `path`; None, an output nobody asked for, is fine."""
    if path is None:
        return
    if path.is_dir():
        raise CesError(f"{path}: is a folder; expected the name of a file to write")
    if path.exists() and not overwrite:
        raise CesError(f"{path}: exists; choose another name, or replace it with --overwrite")
    _require_writable_parent(path)


def require_new_folder(path: Path | None, overwrite: bool) -> None:
    """Raise CesError unless the folder `path` can be made: new or empty, or one to replace with --overwrite."""
    if path is None:
        return
    if path.exists() and not path.is_dir():
        raise CesError(f"{path}: is a file; expected the name of a folder to write")
    if path.is_dir() and any(path.iterdir()) and not overwrite:
        raise CesError(f"{path}: exists; choose another name, or replace it with --overwrite")
    _require_writable_parent(path)


def _require_writable_parent(path: Path) -> None:
    """Raise CesError unless the nearest existing folder above `path` is a folder that can be written."""
    parent = next(folder for folder in path.absolute().parents if folder.exists())
    if not parent.is_dir():
        raise CesError(f"{path}: {parent} is a file; expected a folder to write into")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise CesError(f"{path}: the folder {parent} cannot be written; choose another place")
