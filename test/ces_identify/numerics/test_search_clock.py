"""The clock of a search stops while a kernel is compiled, and runs otherwise."""

from __future__ import annotations

import time

import numba
import pytest
from numba.core import event

from ces_identify.numerics import search_clock


@pytest.fixture(autouse=True)
def own_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_clock, "time", time)


def test_compilation_takes_no_time() -> None:
    inner = numba.njit(lambda x: x * x + 1.0)
    kernel = numba.njit(lambda x: inner(x) + inner(2.0 * x))
    began, wall = search_clock.now(), time.monotonic()
    with event.install_timer("numba:compile", lambda _: None) as timer:
        kernel(1.5)
    passed, wall = search_clock.now() - began, time.monotonic() - wall
    assert timer.duration > 0.01
    assert wall - passed == pytest.approx(timer.duration, rel=0.3)


def test_everything_else_does() -> None:
    began = search_clock.now()
    time.sleep(0.02)
    assert search_clock.now() - began >= 0.02


def test_it_stands_while_a_compilation_goes_on() -> None:
    with event.trigger_event("numba:compile", data={}):
        stopped = search_clock.now()
        with event.trigger_event("numba:compile", data={}):
            time.sleep(0.01)
        assert search_clock.now() == stopped
        last = time.monotonic()
    assert 0.0 <= search_clock.now() - stopped <= time.monotonic() - last
