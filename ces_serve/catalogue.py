"""The list of what the folder holds: one walk with limits, facts kept until a file changes."""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from ces_identify.progress_file import SUFFIX, RunProgress, read_progress
from ces_serve.folder import ServedFolder
from ces_serve.items import RESULT, UNREADABLE, Item, ItemReader, find_reader, read_item, read_recording


@dataclass(frozen=True)
class RunningSearch:
    """A program that is running: the path of its output (relative), its progress file, and what that says."""

    path: str
    file: Path
    progress: RunProgress


@dataclass(frozen=True)
class Listing:
    """What one walk found, newest first; `cut` says that there is more than the limits allow.

    `problem` is why the folder itself cannot be read, empty if it can.
    """

    items: tuple[Item, ...]
    searches: tuple[RunningSearch, ...]
    cut: bool
    made_s: float
    problem: str = ""

    def of_kind(self, kind: str) -> tuple[Item, ...]:
        """Return the things of one kind."""
        return tuple(one for one in self.items if one.kind == kind)

    def outermost(self) -> tuple[Item, ...]:
        """Return the things that are not part of a result, such as the models of a campaign are."""
        owners = {one.folder: one for one in self.items if one.kind == RESULT and one.folder}
        return tuple(one for one in self.items if not _is_part(one, owners))

    def find(self, kind: str, path: str) -> Item | None:
        """Return the thing of a kind at a path, None if there is none."""
        return self._by_place.get((kind, path))

    @cached_property
    def _by_place(self) -> dict[tuple[str, str], Item]:
        return {(one.kind, one.path): one for one in self.items}


def _is_part(one: Item, owners: Mapping[str, Item]) -> bool:
    """Return whether a thing is in the folder of an owner, or below it; owners in one folder are not of each other."""
    folder = one.folder
    while folder:
        if folder in owners and owners[folder] is not one and (folder != one.folder or one.kind != RESULT):
            return True
        folder = folder.rpartition("/")[0]
    return False


METADATA = "metadata.yaml"
MAX_DEPTH = 12
MAX_FILES = 100_000
FRESH_S = 0.5  # a list younger than this is shown again
SLOW_S, WALKS = 0.1, 5.0  # a walk that takes longer is slow: its list is fresh for as long as so many walks
SKIPPED = {"node_modules", "__pycache__", "site-packages"}
NO_ADDRESS = re.compile(r"[\x00-\x1f\x7f\\]")  # characters that no address of a file has

# By path: the stamp of the main file, and the thing.
Memory = dict[str, tuple[tuple[int, int, int], Item | None]]


@dataclass
class _Walk:
    items: list[Item] = field(default_factory=list)
    searches: list[RunningSearch] = field(default_factory=list)
    files: int = 0
    cut: bool = False
    problem: str = ""


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
                self._listing = self._walk()
                walked_s = self._listing.made_s - began_s
                self._fresh_s = FRESH_S if walked_s < SLOW_S else WALKS * walked_s
            return self._listing

    def _walk(self) -> Listing:
        walk = _Walk()
        before, self._known = self._known, {}
        for folder, entries in self._folders(self.folder.root, 0, walk):
            for entry in self._visit(folder, entries, walk, before):
                walk.items.append(entry)
        walk.items.sort(key=lambda one: (-one.modified_s, one.path))
        return Listing(tuple(walk.items), tuple(walk.searches), walk.cut, time.monotonic(), walk.problem)

    def _folders(self, folder: Path, depth: int, walk: _Walk) -> Iterator[tuple[Path, list[os.DirEntry[str]]]]:
        """Yield the folders, each with its entries; links to folders are not followed, nor what is too deep."""
        try:
            with os.scandir(folder) as found:
                entries = sorted(found, key=lambda entry: entry.name)
        except OSError as error:
            self._explain_missing(folder, error, walk)
            return
        walk.files += len(entries)
        if walk.files > MAX_FILES or depth > MAX_DEPTH:
            walk.cut = True
            return
        entries = [entry for entry in entries if self._has_address(folder, entry, walk)]
        yield folder, entries
        if any(entry.name == METADATA for entry in entries):
            return
        for entry in entries:
            if not entry.name.startswith(".") and entry.name not in SKIPPED and entry.is_dir(follow_symlinks=False):
                yield from self._folders(folder / entry.name, depth + 1, walk)

    def _explain_missing(self, folder: Path, error: OSError, walk: _Walk) -> None:
        """Say why a folder cannot be listed, unless it is below and has gone since its name was read."""
        if folder == self.folder.root:
            walk.problem = f"the folder cannot be read now: {error.strerror or error}"
        elif not isinstance(error, FileNotFoundError):
            problem = f"the folder cannot be read: {error.strerror or error}"
            walk.items.append(Item(UNREADABLE, self.folder.relative(folder), 0.0, {}, problem))

    def _has_address(self, folder: Path, entry: os.DirEntry[str], walk: _Walk) -> bool:
        """Return whether a name can stand in an address; folders and files of ours that have another one are listed."""
        shown = NO_ADDRESS.sub("\ufffd", os.fsencode(entry.name).decode("utf-8", "replace"))
        if shown == entry.name:
            return True
        if entry.is_dir(follow_symlinks=False) or find_reader(Path(entry.name)) is not None:
            where, problem = self.folder.relative(folder / shown), "the name is not plain UTF-8 text; rename it"
            with suppress(OSError):  # it may be gone by now
                changed_s = entry.stat(follow_symlinks=False).st_mtime
                walk.items.append(Item(UNREADABLE, where, changed_s, {}, problem))
        return False

    def _visit(self, folder: Path, entries: list[os.DirEntry[str]], walk: _Walk, before: Memory) -> Iterator[Item]:
        if any(entry.name == METADATA for entry in entries):
            if folder != self.folder.root:
                yield from self._remember(read_recording, folder, folder / METADATA, before)
            return
        for entry in entries:
            path = folder / entry.name
            if entry.is_symlink() and not self.folder.holds(path):
                continue
            if entry.name.startswith("."):
                if entry.name.endswith(SUFFIX) and (progress := read_progress(path)) and progress.alive:
                    output = folder if entry.name == SUFFIX else folder / entry.name[1:].removesuffix(SUFFIX)
                    walk.searches.append(RunningSearch(self.folder.relative(output), path, progress))
            elif not entry.is_dir() and (read := find_reader(path)) is not None:
                yield from self._remember(read, path, path, before)

    def _remember(self, read: ItemReader, path: Path, main: Path, before: Memory) -> Iterator[Item]:
        """Yield the thing whose main file is `main`, from memory if that has not changed."""
        try:
            status = main.stat()
        except OSError:
            return
        stamp = (status.st_mtime_ns, status.st_size, status.st_ino)
        known = before.get(str(path))
        if known is None or known[0] != stamp:
            known = stamp, read_item(read, path, self.folder.relative(path), status.st_mtime)
        self._known[str(path)] = known
        if known[1] is not None:
            yield known[1]
