"""`--json`: one JSON document on standard output instead of tables, for other programs.

Every document begins with `schema`, its name and version, and `ces_observer`, the version of the suite. Numbers are
not rounded; one that is not finite is null. Warnings and progress go to the error stream.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from ces_observer import __version__

SCHEMA_VERSION = 1


def add_json(to: argparse.ArgumentParser) -> None:
    """Add the option --json."""
    to.add_argument("--json", action="store_true", help="print JSON for other programs instead of tables")


@contextlib.contextmanager
def without_text(wanted: bool) -> Iterator[None]:
    """Discard what is printed to standard output while the context is open, if `wanted` (the option --json)."""
    if not wanted:
        yield
        return
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
        yield


def print_document(program: str, content: Mapping[str, object], version: int = SCHEMA_VERSION) -> None:
    """Print the document `ces-PROGRAM/VERSION` with `content`."""
    head = {"schema": f"ces-{program}/{version}", "ces_observer": __version__}
    document = {**head, **content, **head}  # the head first, whatever `content` has under its keys
    print(json.dumps(as_plain(document), indent=1, allow_nan=False, ensure_ascii=not _is_unicode()), flush=True)


def _is_unicode() -> bool:
    """Return whether standard output takes all characters; JSON has escapes of its own for the others."""
    return (getattr(sys.stdout, "encoding", None) or "utf-8").lower().replace("-", "").startswith("utf")


def as_plain(value: object) -> Any:
    """Return `value` as JSON types.

    Arrays and other sequences become lists, dataclasses and mappings objects, paths texts, numbers that are not finite
    None. Raises TypeError for any other type.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): as_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [as_plain(item) for item in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: as_plain(getattr(value, field.name)) for field in fields(value)}
    return _convert(value)


def _convert(value: object) -> Any:
    """Return a path as text, and an array or scalar of NumPy (which has `tolist`) as Python's own types."""
    if isinstance(value, Path):
        return str(value)
    if (to_list := getattr(value, "tolist", None)) is not None:
        return as_plain(to_list())
    raise TypeError(f"{type(value).__name__} has no form in JSON")
