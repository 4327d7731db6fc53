"""Work as events: it waits for its turn, and gives it back when the browser leaves."""

from __future__ import annotations

import threading

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

from served_folders import BAGS

from ces_serve.web import work_events
from ces_serve.web.work_events import stream_work

INSPECT = {"name": "inspect", "path": str(BAGS / "sine_4hz"), "signals": None}


def test_work_begins_when_it_is_its_turn_and_gives_it_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work_events, "WAIT_S", 0.01)
    turns = threading.Semaphore(0)
    events = stream_work(INSPECT, 60.0, turns, lambda found: ("result", found))
    waiting = ("progress", "waiting for other work of this server")
    assert next(events) == next(events) == waiting
    turns.release()
    assert next(events) != waiting
    assert not turns.acquire(blocking=False)
    events.close()
    assert turns.acquire(blocking=False)


def test_who_leaves_while_waiting_holds_no_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work_events, "WAIT_S", 0.01)
    turns = threading.Semaphore(0)
    events = stream_work(INSPECT, 60.0, turns, lambda found: ("result", found))
    next(events)
    events.close()
    turns.release()
    assert turns.acquire(blocking=False) and not turns.acquire(blocking=False)
