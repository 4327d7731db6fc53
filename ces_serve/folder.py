"""The served folder: texts from a URL go in, paths inside it come out; its files are read bounded."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path, PurePosixPath
from typing import Any

from ces_observer.errors import CesError

MAX_JSON_BYTES = 8_000_000
MAX_ROWS_BYTES = 64_000_000
HEAD_BYTES = 4096

Json = dict[str, Any]


class UnreadableError(CesError):
    """A file of ours that cannot be read; the message says why, without the path."""


def read_head(path: Path, count: int = HEAD_BYTES) -> bytes:
    """Return the first bytes of a regular file; raises UnreadableError or OSError."""
    return _read_bytes(path, count)


def read_json(path: Path) -> Json:
    """Return the object in a JSON file; raises UnreadableError or OSError."""
    raw = _read_bytes(path, MAX_JSON_BYTES + 1)
    if len(raw) > MAX_JSON_BYTES:
        raise UnreadableError(f"larger than {MAX_JSON_BYTES // 1_000_000} MB")
    return parse_object(raw)


def read_rows(path: Path) -> list[Json]:
    """Return the rows of a file with one JSON object a line; an incomplete last line is one that is being written."""
    raw = _read_bytes(path, MAX_ROWS_BYTES + 1)
    if len(raw) > MAX_ROWS_BYTES:
        raise UnreadableError(f"larger than {MAX_ROWS_BYTES // 1_000_000} MB")
    rows = []
    for number, line in enumerate(raw.rpartition(b"\n")[0].splitlines(), start=1):
        try:
            rows.append(parse_object(line))
        except UnreadableError as error:
            raise UnreadableError(f"line {number}: {error}") from None
    return rows


def parse_object(raw: bytes) -> Json:
    """Return the JSON object in a text; raises UnreadableError."""
    if not raw.strip():
        raise UnreadableError("empty")
    if b"\0" in raw:
        raise UnreadableError("binary data, not JSON")
    try:
        value = json.loads(raw)
    except UnicodeDecodeError as error:
        raise UnreadableError(f"not UTF-8 text: {error.reason} at byte {error.start}") from None
    except RecursionError:
        raise UnreadableError("nested too deep") from None
    except ValueError as error:
        raise UnreadableError(f"not complete JSON: {error}") from None
    if not isinstance(value, dict):
        raise UnreadableError("not a JSON object")
    return value


def _read_bytes(path: Path, count: int) -> bytes:
    if not stat.S_ISREG(path.stat().st_mode):  # opening a pipe would wait
        raise UnreadableError("not a regular file")
    with path.open("rb") as file:
        return file.read(count)


MAX_PATH = 1024


class NotServedError(CesError):
    """A path that is not served: outside the folder, hidden, or not there."""


class ServedFolder:
    """The folder; raises CesError if it is not one."""

    def __init__(self, path: Path) -> None:
        if not path.is_dir():
            what = "is not a folder" if path.exists() else "no such folder"
            raise CesError(f"{path}: {what}; expected the folder to show")
        self.root = path.resolve()

    def find(self, relative: str) -> Path:
        """Return the path of a file or folder below the folder; raises NotServedError.

        Symbolic links are followed only to places inside the folder; hidden names are refused.
        """
        if not 0 < len(relative) <= MAX_PATH or "\0" in relative or "\\" in relative:
            raise NotServedError("not a path in this folder")
        parts = PurePosixPath(relative).parts
        if any(part == ".." or part.startswith((".", "/")) for part in parts):
            raise NotServedError("not a path in this folder")
        real = Path(os.path.realpath(self.root.joinpath(*parts)))
        if not real.is_relative_to(self.root) or not real.exists():
            raise NotServedError(f"{relative}: not in this folder")
        return real

    def find_file(self, relative: str) -> Path:
        """Return the path of a regular file; raises NotServedError."""
        path = self.find(relative)
        if not stat.S_ISREG(path.stat().st_mode):
            raise NotServedError(f"{relative}: not a file")
        return path

    def holds(self, path: Path) -> bool:
        """Return whether a path, its links followed, is inside the folder."""
        return Path(os.path.realpath(path)).is_relative_to(self.root)

    def relative(self, path: Path) -> str:
        """Return a path below the folder as in a URL."""
        return path.relative_to(self.root).as_posix()
