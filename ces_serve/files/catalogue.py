"""The list of what the folder holds: one walk with limits, facts kept until a file changes."""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from ces_identify.progress_file import SUFFIX, RunProgress, read_progress
from ces_observer.errors import CesError
from ces_serve.files import facts, item
from ces_serve.files.bounded_reading import UnreadableError, read_head
from ces_serve.files.item import Item
from ces_serve.files.served_folder import ServedFolder

MAX_DEPTH = 12
MAX_FILES = 100_000
FRESH_S = 0.5  # a list younger than this is shown again
SLOW_S, WALKS = 0.1, 5.0  # a walk that takes longer is slow: its list is fresh for as long as so many walks
METADATA = "metadata.yaml"
BAG_FILES = (".mcap", ".db3")
SKIPPED = {"node_modules", "__pycache__", "site-packages"}
SCHEMA = re.compile(rb'"schema"\s*:\s*"(ces-[a-z-]+)/\d+"')
NO_ADDRESS = re.compile(r"[\x00-\x1f\x7f\\]")  # characters that no address of a file has
GENERATOR = b'content="ces_observer'
FOOTER = b"<footer>ces_observer"

FactsOf = Callable[[Path], facts.Facts]
# By kind and path: the stamp of the main file, and the thing.
Memory = dict[tuple[str, str], tuple[tuple[int, int, int], Item | None]]
JSON_KINDS: dict[bytes, tuple[str, FactsOf]] = {
    b"ces-model": (item.MODEL, facts.model_facts),
    b"ces-gap": (item.DIAGNOSIS, facts.diagnosis_facts),
    b"ces-learned-stroke": (item.STROKE, facts.stroke_facts),
}
OUR_NAMES = {"model.json", "gap.json", "augmented.json"}
ROW_KINDS: dict[str, tuple[str, FactsOf]] = {
    "results.jsonl": (item.CAMPAIGN, facts.campaign_facts),
    "fleet.jsonl": (item.FLEET, facts.fleet_facts),
    "iterations.jsonl": (item.ITERATION, facts.iteration_facts),
}
MEMBER = "ensemble_"  # models by which `ces iterate` measures disagreement


@dataclass(frozen=True)
class RunningSearch:
    """A program that is running: the path of its output (relative), its progress file, and what that says."""

    path: str
    file: Path
    progress: RunProgress


@dataclass(frozen=True)
class Listing:
    """What one walk found, newest first; `cut` says that there is more than the limits allow."""

    items: tuple[Item, ...]
    searches: tuple[RunningSearch, ...]
    cut: bool
    made_s: float

    def of_kind(self, kind: str) -> tuple[Item, ...]:
        """Return the things of one kind."""
        return tuple(one for one in self.items if one.kind == kind)

    def outermost(self) -> tuple[Item, ...]:
        """Return the things that are not part of another, such as the models of a campaign are."""
        owners = {one.folder: one for one in self.items if one.kind in item.FOLDERS and one.folder}
        return tuple(one for one in self.items if not _is_part(one, owners))

    def find(self, kind: str, path: str) -> Item | None:
        """Return the thing of a kind at a path, None if there is none."""
        return self._by_place.get((kind, path))

    @cached_property
    def _by_place(self) -> dict[tuple[str, str], Item]:
        return {(one.kind, one.path): one for one in self.items}


@dataclass
class _Walk:
    items: list[Item] = field(default_factory=list)
    searches: list[RunningSearch] = field(default_factory=list)
    files: int = 0
    cut: bool = False


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
        return Listing(tuple(walk.items), tuple(walk.searches), walk.cut, time.monotonic())

    def _folders(self, folder: Path, depth: int, walk: _Walk) -> Iterator[tuple[Path, list[os.DirEntry[str]]]]:
        """Yield the folders, each with its entries; links to folders are not followed, nor what is too deep."""
        try:
            with os.scandir(folder) as found:
                entries = sorted(found, key=lambda entry: entry.name)
        except OSError:
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

    def _has_address(self, folder: Path, entry: os.DirEntry[str], walk: _Walk) -> bool:
        """Return whether a name can stand in an address; folders and files of ours that have another one are listed."""
        shown = NO_ADDRESS.sub("\ufffd", os.fsencode(entry.name).decode("utf-8", "replace"))
        if shown == entry.name:
            return True
        if entry.is_dir(follow_symlinks=False) or _kind_of(Path(entry.name)) is not None:
            where = self.folder.relative(folder / shown)
            walk.items.append(Item(item.UNREADABLE, where, 0.0, {}, "the name is not plain UTF-8 text; rename it"))
        return False

    def _visit(self, folder: Path, entries: list[os.DirEntry[str]], walk: _Walk, before: Memory) -> Iterator[Item]:
        if any(entry.name == METADATA for entry in entries):
            if folder != self.folder.root:
                yield from self._remember(item.RECORDING, folder, folder / METADATA, facts.recording_facts, before)
            return
        for entry in entries:
            path = folder / entry.name
            if entry.is_symlink() and not self.folder.holds(path):
                continue
            if entry.name.startswith("."):
                if entry.name.endswith(SUFFIX) and (progress := read_progress(path)) and progress.alive:
                    output = folder if entry.name == SUFFIX else folder / entry.name[1:].removesuffix(SUFFIX)
                    walk.searches.append(RunningSearch(self.folder.relative(output), path, progress))
            elif not entry.is_dir() and (known := _kind_of(path)) is not None:
                yield from self._remember(*known, before)

    def _remember(self, kind: str, path: Path, main: Path, facts_of: FactsOf, before: Memory) -> Iterator[Item]:
        """Yield the thing whose main file is `main`, from memory if that has not changed."""
        try:
            status = main.stat()
        except OSError:
            return
        stamp = (status.st_mtime_ns, status.st_size, status.st_ino)
        key = (kind, str(path))
        known = before.get(key)
        if known is None or known[0] != stamp:
            known = stamp, self._read(kind, path, status.st_mtime, facts_of)
        self._known[key] = known
        if known[1] is not None:
            yield known[1]

    def _read(self, kind: str, path: Path, modified_s: float, facts_of: FactsOf) -> Item | None:
        where = self.folder.relative(path)
        if kind == JSON:
            return self._read_json(path, where, modified_s)
        try:
            if kind == item.REPORT and not _is_our_page(path):
                return None
            return Item(kind, where, modified_s, facts_of(path))
        except (CesError, OSError, *facts.WRONG_CONTENT) as error:
            return Item(item.UNREADABLE, where, modified_s, {"kind": kind}, _explain(kind, error))

    def _read_json(self, path: Path, where: str, modified_s: float) -> Item | None:
        """Return the thing in a JSON file; None for a file of other programs."""
        try:
            head = read_head(path)
        except (CesError, OSError) as error:
            return Item(item.UNREADABLE, where, modified_s, {}, _explain("JSON file", error))
        schema = SCHEMA.search(head)
        if schema is not None:
            known = JSON_KINDS.get(schema[1])
            return None if known is None else self._read(known[0], path, modified_s, known[1])
        if path.name in OUR_NAMES or head.lstrip()[:1] not in (b"{", b"["):
            what = "empty" if not head.strip() else "no schema of ces_observer at its beginning"
            return Item(item.UNREADABLE, where, modified_s, {}, what)
        return None


JSON = "json"


def _is_part(one: Item, owners: Mapping[str, Item]) -> bool:
    """Return whether a thing is in the folder of an owner, or below it; owners in one folder are not of each other."""
    folder = one.folder
    while folder:
        if folder in owners and owners[folder] is not one and (folder != one.folder or one.kind not in item.FOLDERS):
            return True
        folder = folder.rpartition("/")[0]
    return False


def _kind_of(path: Path) -> tuple[str, Path, Path, FactsOf] | None:
    """Return kind, path, main file and function of facts of a file by its name; None for files that are not shown."""
    if path.name in ROW_KINDS:
        kind, facts_of = ROW_KINDS[path.name]
        return kind, path, path, facts_of
    match path.suffix.lower():
        case ".json" if not path.name.startswith(MEMBER):
            return JSON, path, path, facts.model_facts
        case ".html":
            return item.REPORT, path, path, facts.report_facts
        case suffix if suffix in BAG_FILES:
            return item.RECORDING, path, path, facts.recording_facts
    return None


def _is_our_page(path: Path) -> bool:
    """Return whether a page was written by our programs, by its head or its last lines."""
    if GENERATOR in read_head(path):
        return True
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 2000))
        return FOOTER in file.read(2000) or path.name == "fleet.html"


def _explain(kind: str, error: Exception) -> str:
    """Return why a file cannot be read, in one line without its path."""
    if isinstance(error, UnreadableError):
        return str(error)
    if isinstance(error, OSError):
        return f"cannot be read: {error.strerror or error}"
    if isinstance(error, CesError):
        return str(error).partition(": ")[2] or str(error)
    if isinstance(error, KeyError):
        return f"no key {error} where a {kind} has one"
    return f"not the content of a {kind}: {error}"
