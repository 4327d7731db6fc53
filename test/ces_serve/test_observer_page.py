"""The page of running observers in a real browser, fed by a script in place of the listening process."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("flask", reason="Flask is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from browser import find_clipped, find_collisions, open_page, start_browser
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

PAUSE = """\
import json, os, sys, threading
threading.Thread(target=lambda: (os.read(0, 1), os._exit(0)), daemon=True).start()
def send(message):
    sys.stdout.write(json.dumps(message) + "\\n"); sys.stdout.flush()
def send_batch(first_s):
    times = [str(round((first_s + 0.0125 * k) * 1e9)) for k in range(40)]
    values = {name: [k % 2 for k in range(40)] for name in ("force", "speed", "position")}
    bounds = {name: [None] * 40 for name in ("lower", "upper")}
    send({"topic": "/car/observer/front/estimate", "batch": {"time_ns": times, "count": 500, **values, **bounds}})
send({"topics": ["/car/observer/front/estimate", "/car/observer/rear/estimate"]})
send_batch(1.0)
send_batch(1.7)  # 0.2 s later, of an estimate each millisecond
threading.Event().wait()
"""


@contextmanager
def watching(listener: str, folder: Path, monkeypatch: pytest.MonkeyPatch, width: int = 1280) -> Iterator[Any]:
    """Yield the page of running observers, which a script feeds."""
    start_browser()  # skips before the work where there is none
    (folder / "some_listener.py").write_text(listener)
    monkeypatch.setattr(link, "find_python", lambda: sys.executable)
    monkeypatch.setattr(link, "LISTENER", "some_listener")
    monkeypatch.setenv("PYTHONPATH", str(folder))
    with serving(folder) as url, open_page("about:blank", network=True, width=width) as page:
        page.goto(f"{url}observer")
        yield page


def test_no_line_is_drawn_over_a_pause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with watching(PAUSE, tmp_path, monkeypatch) as page:
        expect(page.locator("#state")).to_have_text("listening to the estimates of 2 dampers")
        expect(page.locator(".now").first).to_contain_text("1 N")
        expect(page.locator("g.area path.simulated").first).to_have_attribute("d", re.compile("^M[^M]+M[^M]+$"))


def test_observers_that_have_ended_are_said_to_have_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ends = PAUSE.replace("threading.Event()", 'send({"topics": []}); threading.Event()')
    with watching(ends, tmp_path, monkeypatch, width=390) as page:
        expect(page.locator("#state")).to_have_text("listening; no observer publishes an estimate now")
        assert (find_clipped(page), find_collisions(page)) == ([], [])
        drawn_px = page.locator(".observer .tick").first.evaluate("e => e.getBBox().height * e.getScreenCTM().a")
        assert drawn_px > 12.0


def test_a_bag_that_begins_again_is_followed_and_silence_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with watching(LISTENER.replace("END", str(tmp_path / "end")), tmp_path, monkeypatch) as page:
        expect(page.locator("#statuses")).to_contain_text("ok /observer: rear: estimating")
        expect(page.locator(".now")).to_contain_text("−250 N (band −260 to −240 N)")
        (tmp_path / "end").touch()
        expect(page.locator(".now")).to_contain_text("no estimate for")
        silent = re.compile("stale /observer: rear: silent for [0-9]+ s; before: estimating")
        expect(page.locator("#statuses")).to_contain_text(silent)
