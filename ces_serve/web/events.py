"""Server-sent events: messages in, a response that goes on until its end or until the browser leaves."""

from __future__ import annotations

import json
import threading
import traceback
from collections.abc import Iterator
from typing import Any

from flask import Response, abort, current_app, stream_with_context

MAX_STREAMS = 32  # at the same time: each holds a thread
Event = tuple[str, Any]  # name and data; an empty name is a sign of life
ALIVE: Event = ("", None)
SERVER_ERROR = "This page failed; the terminal of ces serve has the reason."


class Streams:
    """Counts the open streams."""

    def __init__(self) -> None:
        self._free = threading.BoundedSemaphore(MAX_STREAMS)

    def respond(self, events: Iterator[Event]) -> Response:
        """Return the response that sends `events`; they are closed when the browser leaves."""
        if not self._free.acquire(blocking=False):
            abort(503, f"{MAX_STREAMS} live views are open; close one")
        response = Response(_Body(stream_with_context(events), self._free), mimetype="text/event-stream")
        response.headers["X-Accel-Buffering"] = "no"
        return response


class _Body:
    """The body of a response; the server calls `close` in every case, also if it never began to send."""

    def __init__(self, events: Iterator[Event], free: threading.BoundedSemaphore) -> None:
        self._events, self._free, self._closed = events, free, False

    def __iter__(self) -> Iterator[bytes]:
        yield b"retry: 2000\n\n"
        try:
            for name, data in self._events:
                yield _encode(name, data)
        except Exception:  # the status of the response has been sent already
            traceback.print_exc()
            yield _encode("failed", SERVER_ERROR)

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._free.release()
            close = getattr(self._events, "close", None)
            if close is not None:
                close()


def _encode(name: str, data: Any) -> bytes:
    return f"event: {name}\ndata: {json.dumps(data)}\n\n".encode() if name else b":\n\n"


def streams() -> Streams:
    """Return the application's streams."""
    found: Streams = current_app.extensions["streams"]
    return found
