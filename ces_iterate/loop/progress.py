"""What a program shows while an iteration runs."""

from __future__ import annotations

from typing import Protocol

from ces_identify.polynomial.search_limits import SearchResult
from ces_iterate.loop.store import Iteration


class IterateListener(Protocol):
    """Receives the progress of an iteration; a search calls `listen_search` from any thread."""

    def begin(self, number: int, step: str) -> None:
        """Receive the number of the iteration and the step that begins."""

    def listen_search(self, result: SearchResult) -> None:
        """Receive an improvement of the search."""

    def finish(self, iteration: Iteration) -> None:
        """Receive a finished iteration."""


class SilentListener:
    """Ignores all progress."""

    def begin(self, number: int, step: str) -> None:
        """Ignore it."""

    def listen_search(self, result: SearchResult) -> None:
        """Ignore it."""

    def finish(self, iteration: Iteration) -> None:
        """Ignore it."""
