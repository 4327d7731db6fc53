"""The page that stands in the report's place while a search runs: the best model so far, marked as preliminary."""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from ces_identify.polynomial.search_limits import SearchResult
from ces_observer.errors import CesError
from ces_observer.json_text import write_atomically
from ces_report.shell import page_template, replace_unencodable

EVERY_S = 1.0  # between two versions of the page, which loads itself every two seconds
MAX_ROWS = 20


class PreliminaryReport:
    """Writes the page from `begin` to the end of its context; `listen` may be called from any thread.

    The caller replaces the page by the report. After an error, what was there before is there again. A page that cannot
    be written never stops the search.
    """

    def __init__(self) -> None:
        self._path: Path | None = None
        self._lock, self._began, self._written = threading.Lock(), time.monotonic(), -EVERY_S
        self._rows: list[tuple[float, int, float]] = []
        self._before: bytes | None = None

    def begin(self, path: Path | None, title: str, facts: Mapping[str, str]) -> None:
        """Write the first page, without a model, to `path`, if one is given."""
        self._path, self._title, self._facts = path, title, facts
        if path is not None:
            self._template = page_template("preliminary.html.j2", "ces_identify.report")
            self._before = path.read_bytes() if path.is_file() else None
            self._write()
            atexit.register(self.__exit__, KeyboardInterrupt, None, None)  # for an end by a signal

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        atexit.unregister(self.__exit__)
        with self._lock, suppress(CesError, OSError):
            path, self._path = self._path, None
            if path is not None and kind is not None and self._before is not None:
                write_atomically(path, self._before)
            elif path is not None and kind is not None:
                path.unlink(missing_ok=True)

    def listen(self, result: SearchResult) -> None:
        """Show a better model."""
        with self._lock:
            if not result.cost < min((row[2] for row in self._rows), default=float("inf")):
                return
            self._rows.insert(0, (time.monotonic() - self._began, len(result.chosen), result.cost))
            if time.monotonic() - self._written >= EVERY_S or len(self._rows) == 1:
                self._write()

    def _write(self) -> None:
        if self._path is None:
            return
        page = self._template.render(
            title=self._title, clock=time.strftime("%H:%M:%S"), facts=self._facts, rows=self._rows[:MAX_ROWS]
        )
        with suppress(CesError, OSError):
            write_atomically(self._path, replace_unencodable(page))
        self._written = time.monotonic()
