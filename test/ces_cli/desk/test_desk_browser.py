"""The desk in a real browser: from a log on the disk to a diagnosis in ten clicks; no error, no other server."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")
pytest.importorskip("plotly", reason="plotly is not installed")

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from browser import find_clipped, find_low_contrast, start_browser
from patience import PATIENCE_S
from programs import ces
from served_folders import BAGS

from ces_cli.desk.app import Desk

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
from playwright.sync_api import expect

pytestmark = pytest.mark.slow

# plotly.js brings a style for maps, which the desk does not need; a file that cannot be read is a conflict
EXPECTED = re.compile("Applying inline style violates|status of 409")


@contextmanager
def open_page(folder: Path) -> Iterator[tuple[Any, str]]:
    """Yield a page of a desk, which asks no other server and has no error, and the address without the token."""
    server, url = Desk(folder).listen(0)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    context = start_browser().new_context(viewport={"width": 1280, "height": 900}, reduced_motion="reduce")
    context.set_default_timeout(1e3 * PATIENCE_S)
    page, wrong, origin = context.new_page(), [], url.partition("?")[0]
    page.on("console", lambda m: wrong.append(m.text) if m.type == "error" and not EXPECTED.search(m.text) else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda r: None if r.url.startswith((origin, "data:", "blob:")) else wrong.append(r.url))
    try:
        page.goto(url)
        yield page, origin
    finally:
        context.close()
        server.shutdown()
        thread.join()
        server.server_close()
    assert wrong == []


def drag(page: Any, begin: float, end: float) -> None:
    """Drag over the first chart from one share of its width to another."""
    expect(page.locator("#chart .nsewdrag")).to_have_count(3)
    box = page.locator("#chart .nsewdrag").first.bounding_box()
    across = [box["x"] + share * box["width"] for share in (begin, 0.5 * (begin + end), end)]
    page.mouse.move(across[0], box["y"] + 20)
    page.mouse.down()
    for x in across[1:]:
        page.mouse.move(x, box["y"] + 20)
    page.mouse.up()


def press(page: Any, name: str) -> None:
    """Press a button and wait for the end of its job."""
    command = page.locator(f"#run-{name.lower()} + code").inner_text()
    page.get_by_role("button", name=name).click()
    expect(page.locator("#command")).to_have_text(command)  # that was shown before
    expect(page.locator("#job h2")).not_to_contain_text("running")
    assert "done" in page.locator("#job h2").inner_text(), page.locator("#lines").inner_text()


def test_from_a_log_on_the_disk_to_a_diagnosis(tmp_path: Path) -> None:
    start_browser()  # skips before the work where there is none
    folder = tmp_path / "folder"
    folder.mkdir()
    assert ces("export-data", BAGS / "noise", "--out", tmp_path / "rig.csv") == 0
    with open_page(folder) as (page, origin):
        assert "token" not in page.url
        page.locator("#files").set_input_files(tmp_path / "rig.csv")  # the first click, and the one that chooses
        drag(page, 0.1, 0.44)  # the third
        expect(page.get_by_label("from, in s")).to_have_value(re.compile(r"2\.[45]\d"))
        expect(page.locator("#run-identify + code")).to_contain_text("ces identify rig.csv --part 2.")
        page.get_by_label("time limit").fill("2")  # the fourth
        expect(page.locator("#run-identify + code")).to_contain_text("--time 2 ")
        press(page, "Identify")  # the fifth
        expect(page.get_by_label("Use 01_identify/model_01.json")).to_be_checked()
        press(page, "Diagnose")  # the sixth
        report = page.frame_locator("iframe")
        expect(report.locator("h1")).not_to_be_empty()
        expect(page.locator("#lists")).to_contain_text("02_diagnose/result/report.html")
        shown = page.url
        page.reload()  # loses nothing
        expect(page.locator("#chart .nsewdrag")).to_have_count(3)
        assert (page.url, page.get_by_label("time limit").input_value()) == (shown, "2")
        expect(report.locator("h1")).not_to_be_empty()
        page.mouse.move(700, 200)
        page.mouse.wheel(0, -400)  # a zoom asks for the window
        with page.expect_response(lambda answer: "from=" in answer.url and "/traces" in answer.url):
            page.mouse.wheel(0, -400)
        for width, scheme in ((1280, "light"), (800, "dark"), (390, "light")):
            page.set_viewport_size({"width": width, "height": 900})
            page.emulate_media(color_scheme=scheme)
            page.goto(f"{origin}?open=rig.csv&job=2")
            expect(page.locator("#chart .nsewdrag")).to_have_count(3)
            clipped = [one for one in find_clipped(page) if "svg" not in one]
            assert clipped + find_low_contrast(page) == [], (width, scheme)
    assert {path.name for path in folder.iterdir()} == {"rig.csv", "01_identify", "02_diagnose"}


def test_a_job_is_cancelled_and_a_wrong_file_refused(tmp_path: Path) -> None:
    start_browser()
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "long.csv").write_text(
        "time_s,position_m,current_A,force_N\n"
        + "".join(f"{k / 500},{k % 50 / 1e3},0.5,{k % 50}\n" for k in range(5000))
    )
    with open_page(folder) as (page, _):
        page.get_by_role("button", name="long.csv").click()
        page.get_by_role("button", name="Identify").click()
        expect(page.locator("#run-info")).to_be_disabled()
        page.get_by_role("button", name="Cancel").click()
        expect(page.locator("#job h2")).to_contain_text("cancelled")
        expect(page.locator("#run-info")).to_be_enabled()
        page.locator("#files").set_input_files(tmp_path / "notes.csv")
        expect(page.locator("#note")).to_contain_text("notes.csv")  # says why it cannot be read
    assert sorted(path.name for path in (folder / "01_identify").iterdir()) == ["command", "log", "status"]
