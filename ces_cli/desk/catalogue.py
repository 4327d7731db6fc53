"""The served folder: texts from a URL go in, paths inside it come out; and the list of what it holds.

The list comes from one walk with limits; facts are kept until a file changes.
"""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ces_cli.desk.items import RESULT, UNREADABLE, Item, ItemReader, find_reader, read_item, read_recording
from ces_observer.errors import CesError

METADATA = "metadata.yaml"
MAX_PATH = 1024  # characters of a path in a URL
MAX_DEPTH, MAX_FILES = 12, 100_000
FRESH_S, WALKS = 0.5, 5.0  # a list is shown again while it is younger than this, and than so many walks have taken
SKIPPED = {"node_modules", "__pycache__", "site-packages"}


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
        """Return a path below the folder; raises NotServedError if hidden, outside (links followed) or not there."""
        parts = PurePosixPath(relative).parts
        odd = not 0 < len(relative) <= MAX_PATH or "\0" in relative or "\\" in relative
        if odd or any(part == ".." or part.startswith((".", "/")) for part in parts):
            raise NotServedError("not a path in this folder")
        real = Path(os.path.realpath(self.root.joinpath(*parts)))
        if not real.is_relative_to(self.root) or not real.exists():
            raise NotServedError(f"{relative}: not in this folder")
        return real

    def find_file(self, relative: str) -> Path:
        """Return the path of a regular file; raises NotServedError."""
        path = self.find(relative)
        if not path.is_file():
            raise NotServedError(f"{relative}: not a file")
        return path

    def holds(self, path: Path) -> bool:
        """Return whether a path, its links followed, is inside the folder."""
        return Path(os.path.realpath(path)).is_relative_to(self.root)

    def relative(self, path: Path) -> str:
        """Return a path below the folder as in a URL."""
        return path.relative_to(self.root).as_posix()


@dataclass(frozen=True)
class Listing:
    """What one walk found, newest first; `cut`: there is more; `problem`: why the folder cannot be read, else empty."""

    items: tuple[Item, ...]
    cut: bool
    made_s: float
    problem: str = ""

    def of_kind(self, kind: str) -> tuple[Item, ...]:
        """Return the things of one kind."""
        return tuple(item for item in self.items if item.kind == kind)

    def outermost(self) -> tuple[Item, ...]:
        """Return the things that are not part of a result, such as the models of a campaign are."""
        owners = {item.folder for item in self.items if item.kind == RESULT and item.folder}

        def is_part(item: Item) -> bool:
            """Return whether a thing is in the folder of a result, or below it; results in one folder are not."""
            parts = (item.folder.rpartition("/")[0] if item.kind == RESULT else item.folder).split("/")
            return any("/".join(parts[:k]) in owners for k in range(1, len(parts) + 1))

        return tuple(item for item in self.items if not is_part(item))

    def find(self, kind: str, path: str) -> Item | None:
        """Return the thing of a kind at a path, None if there is none."""
        return next((item for item in self.items if (item.kind, item.path) == (kind, path)), None)


# By path: the stamp of the main file, and the thing.
Memory = dict[str, tuple[tuple[int, int, int], Item | None]]


class Catalogue:
    """Lists a folder; may be used by many threads. Facts are read again when a file's time or size changes."""

    def __init__(self, folder: ServedFolder) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._known: Memory = {}
        self._listing: Listing | None = None
        self._fresh_s = FRESH_S

    def listing(self, anew: bool = False) -> Listing:
        """Return the present list, or a fresh enough one unless `anew`."""
        with self._lock:
            if anew or self._listing is None or time.monotonic() - self._listing.made_s > self._fresh_s:
                began_s = time.monotonic()
                walk = _Walk(self.folder, self._known)
                walk.enter(self.folder.root)
                items = tuple(sorted(walk.items, key=lambda item: (-item.modified_s, item.path)))
                self._known, made_s = walk.known, time.monotonic()
                self._listing = Listing(items, walk.cut, made_s, walk.problem)
                self._fresh_s = max(FRESH_S, WALKS * (made_s - began_s))
            return self._listing


class _Walk:
    """What a walk has found so far; things whose main file has not changed are those in `before`."""

    def __init__(self, folder: ServedFolder, before: Memory) -> None:
        self.folder, self.before = folder, before
        self.known: Memory = {}
        self.items: list[Item] = []
        self.files, self.cut, self.problem = 0, False, ""

    def enter(self, folder: Path, depth: int = 0) -> None:
        """List a folder and those below it; links to folders are not followed, nor what is too deep."""
        try:
            with os.scandir(folder) as scanned:
                entries = sorted(scanned, key=lambda entry: entry.name)
        except OSError as error:
            if folder == self.folder.root:
                self.problem = f"the folder cannot be read now: {error.strerror or error}"
            elif not isinstance(error, FileNotFoundError):  # else it has gone since its name was read
                self._add_unreadable(folder, 0.0, f"the folder cannot be read: {error.strerror or error}")
            return
        self.files += len(entries)
        if self.files > MAX_FILES or depth > MAX_DEPTH:
            self.cut = True
            return
        entries = [entry for entry in entries if entry.name.isprintable() and "\\" not in entry.name]  # has an address
        if all(entry.name != METADATA for entry in entries):
            for entry in entries:
                self._visit(folder / entry.name, entry, depth)
        elif folder != self.folder.root:
            self._remember(read_recording, folder, folder / METADATA)

    def _add_unreadable(self, path: Path, changed_s: float, problem: str) -> None:
        self.items.append(Item(UNREADABLE, self.folder.relative(path), changed_s, {}, problem))

    def _visit(self, path: Path, entry: os.DirEntry[str], depth: int) -> None:
        if entry.name.startswith(".") or (entry.is_symlink() and not self.folder.holds(path)):
            return
        if entry.is_dir(follow_symlinks=False):
            if entry.name not in SKIPPED:
                self.enter(path, depth + 1)
        elif not entry.is_dir() and (read := find_reader(path)) is not None:
            self._remember(read, path, path)

    def _remember(self, read: ItemReader, path: Path, main: Path) -> None:
        """Add the thing whose main file is `main`, from memory if that has not changed."""
        with suppress(OSError):
            status = main.stat()
            stamp = (status.st_mtime_ns, status.st_size, status.st_ino)
            remembered = self.before.get(str(path))
            if remembered is None or remembered[0] != stamp:
                remembered = stamp, read_item(read, path, self.folder.relative(path), status.st_mtime)
            self.known[str(path)] = remembered
            if remembered[1] is not None:
                self.items.append(remembered[1])
