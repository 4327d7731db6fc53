"""What all tests share: searches with a time limit get the time of the processor, however busy the computer is."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session", autouse=True)
def busy_search_clock() -> Iterator[pytest.MonkeyPatch]:
    """Let the clock of searches in this process stand still while the computer is busy with other work."""
    from busy_clock import BusyClock

    from ces_identify.numerics import search_clock

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search_clock, "time", BusyClock())
        yield patch
