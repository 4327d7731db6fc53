"""The server itself, over real connections: streams are limited, and what they hold is free when the reader leaves."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

from patience import children_running, wait_until
from served_folders import BAGS

from ces_serve.web.server import PageServer
from ces_serve.work import process


@pytest.fixture
def url() -> Iterator[str]:
    server = PageServer(BAGS, "127.0.0.1", 0)
    thread = threading.Thread(target=server.run)
    thread.start()
    yield server.url
    server.stop()
    thread.join()


def test_work_ends_when_the_reader_leaves(url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "endless_worker.py").write_text("import time; time.sleep(3600)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(process, "WORKER", "endless_worker")
    with urlopen(f"{url}events/inspect/sine_4hz") as answer:
        assert answer.headers["Content-Type"].startswith("text/event-stream")
        answer.readline()
        assert wait_until(lambda: children_running("endless_worker"))
    wait_until(lambda: not children_running("endless_worker"))


def test_streams_are_limited_and_closed_ones_are_free_again(url: str) -> None:
    open_streams = [urlopen(f"{url}events/overview") for _ in range(32)]
    with pytest.raises(HTTPError, match="503"):
        urlopen(f"{url}events/overview")
    assert urlopen(url).status == 200  # pages are still there
    for stream in open_streams:
        stream.close()

    def is_free() -> bool:
        try:
            urlopen(f"{url}events/overview").close()
        except HTTPError:
            return False
        return True

    wait_until(is_free)
