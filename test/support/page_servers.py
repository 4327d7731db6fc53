"""A running server of `ces serve` for tests in a browser."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ces_serve.server import PageServer


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """Yield the address of a server of `folder`."""
    server = PageServer(folder, "127.0.0.1", 0)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield server.url
    finally:
        server.stop()
        thread.join()
