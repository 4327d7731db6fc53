"""Who is told what a diagnosis is doing."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]  # what is being done, and the share of that step that is done


def ignore_progress(what: str, share: float) -> None:
    """Take in progress that nobody watches."""
