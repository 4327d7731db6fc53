"""The server itself, over a real connection: work ends with it, and its files are gone."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import threading
from pathlib import Path
from urllib.request import urlopen

from patience import children_running, wait_until
from served_folders import BAGS

from ces_cli.desk.app import PageServer


def test_work_ends_with_the_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (tmp_path / "sitecustomize.py").write_text("import sys, time\nif '-m' in sys.orig_argv: time.sleep(3600)\n")
    server = PageServer(BAGS, "127.0.0.1", 0)
    thread = threading.Thread(target=server.run)
    thread.start()
    assert b"reading the bag" in urlopen(f"{server.url}view/recording/sine_4hz").read().lower()
    assert wait_until(lambda: children_running("ces_cli.desk.work"))
    server.stop()
    thread.join()
    wait_until(lambda: not children_running("ces_cli.desk.work"))
    assert not list(tmp_path.glob("ces-serve-*"))
