"""The folder of recorded bags: it names new bags, checks the free disk space and removes old bags."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Iterator
from errno import ENOSPC
from pathlib import Path

from ces_observer.recorder.bag_folder import METADATA, part_path, remove_bag

MIN_FREE_BYTES = 200 << 20  # that a recording leaves free
INTERRUPTED_S = 3600.0  # another observer may still be writing a younger unfinished bag
STAMP = "%Y-%m-%d-%H-%M-%S"
STAMP_PATTERN = r"\d{4}-\d\d-\d\d-\d\d-\d\d-\d\d(_\d+)?"
SECOND_NS = 1_000_000_000


class RecordFolder:
    """Bags named `label_UTC` in `path`; all methods raise OSError."""

    def __init__(self, path: Path, max_bags: int) -> None:
        self.path = path
        self.max_bags = max_bags

    def new_bag(self, label: str, time_ns: int, size: int) -> Path:
        """Return a free path for a bag of about `size` bytes; raises OSError, also if the disk is nearly full.

        Removes old remains of interrupted recordings of the same label.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        if shutil.disk_usage(self.path).free < size + MIN_FREE_BYTES:
            raise OSError(ENOSPC, f"the disk is nearly full; a recording leaves {MIN_FREE_BYTES >> 20} MiB free")
        for part in self.path.glob(part_path(self.path / f"{label}_*").name):
            if time.time() - part.stat().st_mtime > INTERRUPTED_S:
                remove_bag(part)
        stem = f"{label}_{time.strftime(STAMP, time.gmtime(time_ns // SECOND_NS))}"
        path, count = self.path / stem, 1
        while path.exists():
            count += 1
            path = self.path / f"{stem}_{count}"
        return path

    def prune(self, label: str) -> None:
        """Remove the oldest bags of a label beyond `max_bags`, except those that hold more than a bag's own files."""
        bags = sorted(self._bags(label), key=lambda path: path.stat().st_mtime_ns)
        for path in bags[: -self.max_bags]:
            remove_bag(path)

    def _bags(self, label: str) -> Iterator[Path]:
        pattern = re.compile(f"{re.escape(label)}_{STAMP_PATTERN}")
        for path in self.path.iterdir():
            if pattern.fullmatch(path.name) and path.is_dir():
                files = {file.name for file in path.iterdir()}
                if files == {METADATA, f"{path.name}.mcap"}:
                    yield path
