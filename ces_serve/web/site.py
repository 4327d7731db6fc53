"""What the pages share: the folder, the list of its things, the observer's link, and finished work."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flask import current_app

from ces_serve.files.catalogue import Catalogue
from ces_serve.files.served_folder import ServedFolder
from ces_serve.live.link import ObserverLink

MAX_RESULTS = 32
MAX_INSPECTIONS = 2  # recordings that are read at the same time


class Results:
    """Results of finished work by key, the latest ones; may be used by many threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[object, Any] = OrderedDict()

    def get(self, key: object) -> Any:
        """Return a result, None if it is not kept."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def keep(self, key: object, result: Any) -> None:
        """Keep a result, and forget the oldest."""
        with self._lock:
            self._kept[key] = result
            while len(self._kept) > MAX_RESULTS:
                self._kept.popitem(last=False)


@dataclass
class Site:
    """The folder that is served, and what is known about it."""

    folder: ServedFolder
    catalogue: Catalogue
    link: ObserverLink
    signals: str | None = None
    inspected: Results = field(default_factory=Results)
    compared: Results = field(default_factory=Results)
    inspecting: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(MAX_INSPECTIONS))
    comparing: threading.Semaphore = field(default_factory=threading.Semaphore)  # one at a time

    @staticmethod
    def open(path: Path, observer: str = "", signals: Path | None = None) -> Site:
        """Return the site of a folder; raises CesError if it is not one."""
        folder = ServedFolder(path)
        return Site(folder, Catalogue(folder), ObserverLink(observer), None if signals is None else str(signals))


def site() -> Site:
    """Return the site of the application that handles the present request."""
    found: Site = current_app.extensions["site"]
    return found


def stamp(path: Path) -> tuple[str, int, int]:
    """Return what changes when a file, or the files in a folder, change."""
    files = [path, *sorted(path.iterdir())] if path.is_dir() else [path]
    states = [one.stat() for one in files]
    return str(path), max(state.st_mtime_ns for state in states), sum(state.st_size for state in states)
