"""Server-sent events: messages in, a response that goes on until its end or until the browser leaves."""

from __future__ import annotations

import json
import threading
import traceback
from collections.abc import Generator
from contextlib import closing
from typing import Any

from flask import Response, abort, current_app, stream_with_context

MAX_STREAMS = 32  # at the same time: each holds a thread
Event = tuple[str, Any]  # name and data; an empty name is a sign of life
Events = Generator[Event, None, None]
ALIVE: Event = ("", None)
SERVER_ERROR = "This page failed; the terminal of ces serve has the reason."


class Streams:
    """Counts the open streams."""

    def __init__(self) -> None:
        self._free = threading.BoundedSemaphore(MAX_STREAMS)

    def respond(self, events: Events) -> Response:
        """Return the response that sends `events`; they are closed when the browser leaves."""
        if not self._free.acquire(blocking=False):
            abort(503, f"{MAX_STREAMS} live views are open; close one")
        response = Response(stream_with_context(_encode_all(events)), mimetype="text/event-stream")
        response.call_on_close(self._free.release)
        return response


def streams() -> Streams:
    """Return the application's streams."""
    found: Streams = current_app.extensions["streams"]
    return found


def _encode_all(events: Events) -> Generator[bytes, None, None]:
    yield b"retry: 2000\n\n"
    try:
        with closing(events):
            for name, data in events:
                yield _encode(name, data)
    except Exception:  # the status of the response has been sent already
        traceback.print_exc()
        yield _encode("failed", SERVER_ERROR)


def _encode(name: str, data: Any) -> bytes:
    return f"event: {name}\ndata: {json.dumps(data)}\n\n".encode() if name else b":\n\n"
