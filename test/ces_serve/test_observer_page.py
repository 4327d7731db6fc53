"""The page of running observers in a real browser, fed by a script in place of the listening process."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

pytest.importorskip("flask", reason="Flask is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from browser import open_page, start_browser
from page_servers import serving
from playwright.sync_api import expect

from ces_serve.live import link

LISTENER = """\
import json, os, sys, threading, time
threading.Thread(target=lambda: (os.read(0, 1), os._exit(0)), daemon=True).start()
def send(message):
    sys.stdout.write(json.dumps(message) + "\\n"); sys.stdout.flush()
def send_second(first_s, force):
    for k in range(20):
        numbers = {name: [value] for name, value in dict(force=force, speed=0.1, position=0.02).items()}
        bounds = {"lower": [force - 10.0], "upper": [force + 10.0]}
        stamp = {"time_ns": [str(round((first_s + 0.05 * k) * 1e9))], "count": 50}
        send({"topic": "/observer/estimate", "batch": {**stamp, **numbers, **bounds}})
        time.sleep(0.05)
send({"topics": ["/observer/estimate"]})
send_second(7.0, 100.0)
while not os.path.exists("END"):
    send({"status": {"name": "/observer: rear", "level": 0, "message": "estimating", "values": {"forces": "50"}}})
    send_second(0.0, -250.0)  # a bag that begins again
time.sleep(600)
"""


def test_a_bag_that_begins_again_is_followed_and_silence_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start_browser()  # skips before the work where there is none
    (tmp_path / "some_listener.py").write_text(LISTENER.replace("END", str(tmp_path / "end")))
    monkeypatch.setattr(link, "find_python", lambda: sys.executable)
    monkeypatch.setattr(link, "LISTENER", "some_listener")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with serving(tmp_path) as url, open_page("about:blank", network=True) as page:
        page.goto(f"{url}observer")
        expect(page.locator("#statuses")).to_contain_text("ok /observer: rear: estimating")
        expect(page.locator(".now")).to_contain_text("−250 N (band −260 to −240 N)")
        (tmp_path / "end").touch()
        expect(page.locator(".now")).to_contain_text("no estimate for")
        silent = re.compile("stale /observer: rear: silent for [0-9]+ s; before: estimating")
        expect(page.locator("#statuses")).to_contain_text(silent)
