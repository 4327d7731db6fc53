"""The server itself, over real connections: streams are limited, and what they hold is free when the reader leaves."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

from served_folders import BAGS

from ces_serve.web.server import PageServer


@pytest.fixture
def url() -> Iterator[str]:
    server = PageServer(BAGS, "127.0.0.1", 0)
    thread = threading.Thread(target=server.run)
    thread.start()
    yield server.url
    server.stop()
    thread.join()


def workers() -> int:
    """Return the number of worker processes of this one."""
    found = [path.read_text().split() for path in Path("/proc/self/task").glob("*/children")]
    lines = [Path(f"/proc/{pid}/cmdline").read_bytes() for pids in found for pid in pids]
    return sum(b"ces_serve.work.worker" in line for line in lines)


def wait_for_no_worker() -> None:
    end = time.monotonic() + 5.0
    while workers():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_work_ends_when_the_reader_leaves(url: str) -> None:
    with urlopen(f"{url}events/inspect/sine_4hz") as answer:
        assert answer.headers["Content-Type"].startswith("text/event-stream")
        answer.readline()
        while not workers():
            time.sleep(0.01)
    wait_for_no_worker()


def test_streams_are_limited_and_closed_ones_are_free_again(url: str) -> None:
    open_streams = [urlopen(f"{url}events/overview") for _ in range(32)]
    with pytest.raises(HTTPError, match="503"):
        urlopen(f"{url}events/overview")
    assert urlopen(url).status == 200  # pages are still there
    for stream in open_streams:
        stream.close()
    end = time.monotonic() + 5.0
    while True:
        try:
            urlopen(f"{url}events/overview").close()
            break
        except HTTPError:
            assert time.monotonic() < end
            time.sleep(0.1)
