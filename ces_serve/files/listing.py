"""What one walk through the folder found, and which of it is part of something else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ces_identify.progress_file import RunProgress
from ces_serve.files import item
from ces_serve.files.item import Item


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
        """Return the things that are not part of another, such as the models of a campaign are."""
        owners = {one.folder: one for one in self.items if one.kind in item.FOLDERS and one.folder}
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
        if folder in owners and owners[folder] is not one and (folder != one.folder or one.kind not in item.FOLDERS):
            return True
        folder = folder.rpartition("/")[0]
    return False
