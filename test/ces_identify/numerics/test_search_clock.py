"""The clock of a search stops while a kernel is compiled, and runs otherwise."""

from __future__ import annotations

import time

import numba
import pytest
from numba.core import event

from ces_identify.numerics.search import clock_s


class Clock(event.Listener):
    """A clock in place of the module `time`; while it is a listener, each compilation takes a second."""

    def __init__(self) -> None:
        self.now_s = time.monotonic()

    def monotonic(self) -> float:
        return self.now_s

    def on_start(self, _: event.Event) -> None:
        self.now_s += 1.0

    def on_end(self, _: event.Event) -> None: ...


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr("ces_identify.numerics.search.time", made)
    return made


def test_compilation_takes_no_time(clock: Clock) -> None:
    inner = numba.njit(lambda x: x * x + 1.0)
    kernel = numba.njit(lambda x: inner(x) + inner(2.0 * x))
    began, clock_began = clock_s(), clock.now_s
    with event.install_listener("numba:compile", clock):
        kernel(1.5)
    assert clock.now_s == clock_began + 2.0
    assert clock_s() == pytest.approx(began, abs=1e-6)


def test_everything_else_does(clock: Clock) -> None:
    began = clock_s()
    clock.now_s += 3.0
    assert clock_s() - began == pytest.approx(3.0)


def test_it_stands_while_a_compilation_goes_on(clock: Clock) -> None:
    with event.trigger_event("numba:compile", data={}):
        stopped = clock_s()
        with event.trigger_event("numba:compile", data={}):
            clock.now_s += 3.0
        assert clock_s() == stopped
        clock.now_s += 4.0
    assert clock_s() == pytest.approx(stopped, abs=1e-6)
