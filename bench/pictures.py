"""The pictures of the documents that show pages: python -m bench.pictures [NAME...]

Each is made by the commands of `PICTURES`, in out/pictures, and drawn by Chromium (playwright). Commands whose output
exists are not run again. Others are written by `make tables` (thesis_5_*).
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).resolve().parents[1]
WORK, IMAGES = ROOT / "out" / "pictures", ROOT / "docs" / "img"
CES = Path(sys.executable).with_name("ces")
WIDTH_px = 1120
ITERATE = """\
limits: {stroke_m: 0.025, speed_m_s: 1.25, acceleration_m_s2: 95, frequency_Hz: 16, low_A: 0.29, high_A: 0.70}
rig: {kind: virtual}
stop: {budget_s: 60}
identify: {structure: hydraulic}
validate: [bags/road, bags/sine_4hz]
"""
IDENTIFY = "ces identify bags/noise bags/sweep --validate bags/sine_4hz bags/road --structure auto --out best.json"


@dataclass(frozen=True)
class Picture:
    """What makes a picture: files, commands, and the part of a page from `first` to `last`, which are CSS selectors."""

    output: str
    commands: tuple[str, ...]
    page: str
    first: str = "header"
    last: str = "main"
    files: tuple[tuple[str, str], ...] = ()


def read_page(name: str) -> tuple[tuple[tuple[str, str], ...], tuple[str, ...]]:
    """Return the files of a page of docs/, and the commands of its block that runs the virtual rig."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", (ROOT / "docs" / name).read_text(encoding="utf-8"), re.M | re.S)
    files = [(match[1], block) for block in blocks if (match := re.match(r"# ([\w.]+\.yaml)\n", block))]
    return tuple(files), tuple(next(block for block in blocks if "ces rig " in block).splitlines())


FILES, DIAGNOSE = read_page("diagnose.md")
FIRST = "main section:first-of-type"
TIME = ".recording figure"
DYNO = (
    "ces rig characterise --out dyno",
    "ces identify bags/noise bags/sweep --structure hydraulic --out hydraulic.json",
    "ces characterise dyno --model hydraulic.json --out dyno_page",
)
GAP = ("gap_rig", DIAGNOSE, "gap_rig/report.html")
PICTURES = {
    "readme": Picture("best.json", (f"{IDENTIFY} --report best.html",), "best.html", TIME, TIME),
    "characterise": Picture("dyno_page", DYNO, "dyno_page/characteristics.html", "#family", "#family"),
    "iterate": Picture(
        "rear_damper",
        ("ces iterate rear_damper.yaml",),
        "rear_damper/report.html",
        last=FIRST,
        files=(("rear_damper.yaml", ITERATE),),
    ),
    "gap_summary": Picture(*GAP, last="#shrink", files=FILES),
    "gap_report": Picture(*GAP, last="#causes", files=FILES),
    "gap_where": Picture(*GAP, first="#where", last="#where", files=FILES),
    "serve": Picture("desk", ("mkdir desk", "ces export-data bags/noise --out desk/rig.csv"), "ces serve"),
}


def make(picture: Picture) -> None:
    """Run the commands of a picture unless their output exists."""
    for name, text in picture.files:
        (WORK / name).write_text(text, encoding="utf-8")
    if picture.output and not (WORK / picture.output).exists():
        for command in picture.commands:
            print("$", command, flush=True)
            subprocess.run(["bash", "-c", f'ces() {{ {CES} "$@"; }}; {command}'], cwd=WORK, check=True)


def photograph(page: Page, picture: Picture, path: Path) -> None:
    """Write the part of a page that a picture shows, as a page of `WIDTH_px` looks when it opens."""
    if picture.page == "ces serve":
        words = [str(CES), "serve", "desk", "--port", "0"]
        with subprocess.Popen(words, cwd=WORK, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as server:
            assert server.stdout is not None
            printed = next(line for line in server.stdout if "http" in line)
            page.goto(address := re.findall(r"http\S+", printed)[0])
            page.goto(f"{address.partition('?')[0]}?open=rig.csv&from=4&to=16")
            page.click("#run-characterise")
            page.wait_for_selector("#job[data-state=done] >> text=characteristics.html")
            page.wait_for_selector("#chart .main-svg")
            page.evaluate("scrollTo(0, 0)")
            page.screenshot(path=path)
            server.terminate()
    else:
        page.goto((WORK / picture.page).as_uri())
        clip(page, picture, path)


def clip(page: Page, picture: Picture, path: Path) -> None:
    """Write the part from `first` to `last`."""
    first, last = (page.locator(selector).first.bounding_box() for selector in (picture.first, picture.last))
    assert first is not None and last is not None
    top, bottom = max(0.0, first["y"] - 10), last["y"] + last["height"] + 10
    page.screenshot(path=path, full_page=True, clip={"x": 0, "y": top, "width": WIDTH_px, "height": bottom - top})


def main(names: list[str]) -> None:
    WORK.mkdir(parents=True, exist_ok=True)
    for folder in ("bags", "config"):
        if not (WORK / folder).exists():
            (WORK / folder).symlink_to(ROOT / folder)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for name in names or list(PICTURES):
            picture = PICTURES[name]
            make(picture)
            page = browser.new_page(viewport={"width": WIDTH_px, "height": 760})
            photograph(page, picture, WORK / f"{name}.png")
            Image.open(WORK / f"{name}.png").quantize(64).save(IMAGES / f"{name}.png", optimize=True)
            print(IMAGES / f"{name}.png", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
