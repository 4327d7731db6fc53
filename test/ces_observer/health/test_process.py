"""The load of this process; test_kernel_drops.py has what it loses."""

from __future__ import annotations

from time import monotonic

from ces_observer.health.process import ProcessWatch


def test_the_load_is_that_since_the_last_update() -> None:
    watch = ProcessWatch()
    watch.update()
    end = monotonic() + 0.05
    while monotonic() < end:
        pass
    load = watch.update()
    assert load.executor is not None
    assert load.process is not None
    assert 0.0 < load.executor <= load.process + 0.1
