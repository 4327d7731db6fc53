"""Progress reports of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]  # the present step and the share of it that is done


def ignore_progress(step: str, share: float) -> None:
    """Report nothing."""
