"""The folder that is served: texts from a URL go in, paths inside the folder come out, or nothing."""

from __future__ import annotations

import os
import stat
from pathlib import Path, PurePosixPath

from ces_observer.errors import CesError

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
