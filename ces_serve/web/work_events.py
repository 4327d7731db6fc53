"""Work in another process as events: its progress, when its turn has come, and what is made of its result."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Any

from ces_serve.web.events import ALIVE, Event, Events
from ces_serve.work.process import FAILED, RESULT, do_work

WAIT_S = 1.0


def stream_work(
    task: Mapping[str, Any], limit_s: float, turns: threading.Semaphore, finish: Callable[[Any], Event]
) -> Events:
    """Yield the progress of a task once `turns` lets it begin, then what `finish` makes of its result, or a failure."""
    while not turns.acquire(timeout=WAIT_S):
        yield "progress", "waiting for other work of this server"
    try:
        with closing(do_work(task, limit_s)) as messages:
            for message in messages:
                yield _as_event(message, finish)
    finally:
        turns.release()


def _as_event(message: Mapping[str, Any], finish: Callable[[Any], Event]) -> Event:
    if RESULT in message:
        return finish(message[RESULT])
    if FAILED in message:
        return "failed", message[FAILED]
    return ("progress", message["progress"]) if "progress" in message else ALIVE
