"""Jobs: the command lines of the buttons, one job at a time, cancelled or ended, the same after the server's end."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import fcntl
import os
import re
from pathlib import Path
from typing import Any

from patience import command_of, wait_until
from served_folders import OWN, fill_folder, open_desk
from werkzeug.datastructures import MultiDict

from ces_cli.desk.jobs import PROGRAMS, Jobs, make_words
from ces_cli.main import PROGRAMS as ALL
from ces_observer.errors import CesError

SLOW = ["-c", "print('half', flush=True); import time; time.sleep(600)"]


def words(program: str, **chosen: object) -> str:
    return " ".join(make_words(MultiDict({"recording": "rig.csv", **chosen}), program, f"07_{program}", ""))


def test_each_button_has_the_command_of_its_program() -> None:
    part, two = {"from": "2.5", "to": "8"}, {"model": ["a.json", "b.json"]}
    assert words("info") == "rig.csv"
    assert words("characterise", **part) == "rig.csv --part 2.5 8 --out 07_characterise/result"
    search = {"structure": "hydraulic", "time": "20"}
    out = "--out 07_identify/model_07.json --report 07_identify/report.html"
    assert words("identify", **search) == f"rig.csv --structure hydraulic --time 20 {out}"
    assert words("validate", model="a.json") == "a.json rig.csv --report 07_validate/report.html"
    assert words("compare", **two, to="8") == "a.json b.json rig.csv --part 0 8 --report 07_compare/report.html"
    assert words("diagnose", model="a.json") == "--sim a.json --real rig.csv --out 07_diagnose/result"


def test_what_cannot_be_run_says_why() -> None:
    wrong: tuple[tuple[str, dict[str, object], str], ...] = (
        ("info", {"recording": ""}, "rename"),
        ("info", {"recording": []}, "choose a recording"),
        ("info", {"recording": "-x.csv"}, "rename -x.csv"),
        ("info", {"recording": "a*.csv"}, "rename a"),
        ("validate", {"model": "os:system.json"}, "rename os:system.json"),
        ("compare", {"model": "a.json"}, "two or more models; chosen: 1"),
        ("diagnose", {"model": ["a.json", "b.json"]}, "one model; chosen: 2"),
        ("characterise", {"from": "--out", "to": "/etc"}, "'--out' is no number"),
    )
    for program, chosen, text in wrong:
        with pytest.raises(CesError, match=text):
            words(program, **chosen)


def start(folder: Path, *code: str) -> Jobs:
    """Start Python with `code` as a job, in place of a program."""
    jobs = Jobs(folder)
    jobs.start(jobs.next_folder("info"), code)
    return jobs


@pytest.fixture
def python(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Let jobs run Python itself."""
    (tmp_path / "python").write_text('#!/bin/sh\nshift 4\nexec python3 "$@"\n')
    (tmp_path / "python").chmod(0o755)
    monkeypatch.setattr("sys.executable", str(tmp_path / "python"))


@pytest.mark.usefixtures("python")
def test_a_job_is_its_folder_and_outlives_the_server(tmp_path: Path) -> None:
    start(tmp_path, "-c", "print('one\\r 9 s  two\\r 9 s  three')\nfor k in range(3): print(f'   {k} s  beat')")
    (job,) = wait_until(lambda: [one for one in Jobs(tmp_path).list() if one.state != "running"])
    assert (job.number, job.state, job.path.name) == (1, "done", "01_info")
    assert job.command.startswith("ces info -c ")
    assert job.lines == "   2 s  beat" or job.lines.splitlines() == [" 9 s  three", "   2 s  beat"]
    start(tmp_path, "-c", "raise SystemExit(2)")
    assert wait_until(lambda: [one.state for one in Jobs(tmp_path).list()] == ["failed: status 2", "done"])
    (tmp_path / "02_info" / "status").write_text("process 1")
    assert Jobs(tmp_path).list()[0].state == "interrupted"


@pytest.mark.usefixtures("python")
def test_one_job_at_a_time_which_can_be_cancelled(tmp_path: Path) -> None:
    start(tmp_path, *SLOW)
    wait_until(lambda: Jobs(tmp_path).list()[0].lines == "half")
    group = int((tmp_path / "01_info" / "status").read_text().split()[1])
    with pytest.raises(CesError, match="job 1 is running"):
        start(tmp_path, *SLOW)
    Jobs(tmp_path).cancel(1)  # as a server that was started again
    assert [(job.number, job.state) for job in Jobs(tmp_path).list()] == [(1, "cancelled")]
    assert b"time.sleep" not in command_of(group)
    with pytest.raises(ProcessLookupError):
        wait_until(lambda: os.killpg(group, 0))
    Jobs(tmp_path).cancel(1)  # again, and one that is not there
    Jobs(tmp_path).cancel(9)


def test_what_only_looks_like_a_job_is_none(tmp_path: Path) -> None:
    for name in ("01_info", "notes", "02_info", "1_info"):
        (tmp_path / name).mkdir()
    (tmp_path / "02_info" / "command").write_text("ces info")
    assert Jobs(tmp_path).list() == []
    assert Jobs(tmp_path).next_folder("info") == "03_info"  # nothing is written into what is there


def commands_of(page: str) -> list[str]:
    return re.findall(r"<code>(.*?)</code>", page)


def test_the_page_shows_the_commands_and_keeps_what_is_chosen(tmp_path: Path) -> None:
    _, client = open_desk(fill_folder(tmp_path))
    assert set(PROGRAMS) <= set(ALL)
    assert commands_of(client.get("/").text)[0] == "choose a recording"
    page = client.get("/?open=recordings/sine_4hz&from=1&to=4").text
    assert "ces characterise recordings/sine_4hz --part 1 4 --out 01_characterise/result" in commands_of(page)
    page = client.get("/?open=recordings/sine_4hz&recording=first&from=1&to=4").text  # others are chosen
    assert "ces characterise first --part 1 4 --out 01_characterise/result" in commands_of(page)
    page = client.get("/?open=other&open=recordings/sine_4hz&recording=other&from=1&to=4").text  # just opened
    assert "ces characterise recordings/sine_4hz --out 01_characterise/result" in commands_of(page)


@pytest.mark.slow
def test_a_button_runs_its_program_and_returns_to_the_page(tmp_path: Path) -> None:
    desk, client = open_desk(fill_folder(tmp_path))
    chosen = {
        "recording": "recordings/sine_4hz",
        "model": "first.json",
        "open": "recordings/sine_4hz",
        "from": "0",
        "to": "6",
    }
    answer = client.post("/run/validate", data=chosen, headers=OWN)
    assert answer.status_code == 303 and answer.headers["Location"].endswith("&to=6&job=1#job")
    assert client.post("/run/validate", data=chosen, headers=OWN).status_code == 409  # one at a time
    wait_until(lambda: desk.jobs.list()[0].state != "running")
    page = client.get(answer.headers["Location"]).text
    assert desk.jobs.list()[0].state == "done", desk.jobs.list()[0].lines
    assert '<iframe src="/files/01_validate/report.html"' in page
    assert client.get("/files/01_validate/report.html").status_code == 200
    assert client.post("/cancel/1", headers=OWN).status_code == 303
    assert client.post("/run/serve", data=chosen, headers=OWN).status_code == 404


def test_a_lock_of_another_server_counts(tmp_path: Path) -> None:
    (tmp_path / "01_info").mkdir()
    for name in ("command", "log"):
        (tmp_path / "01_info" / name).write_text("ces info a")
    with (tmp_path / "01_info" / "log").open("a") as log:
        fcntl.flock(log, fcntl.LOCK_EX)
        assert Jobs(tmp_path).list()[0].state == "running"
    assert Jobs(tmp_path).list()[0].state == "interrupted"


def test_uploads_arrive(tmp_path: Path) -> None:
    _, client = open_desk(tmp_path)

    def send(name: str) -> Any:
        return client.post(f"/upload?name={name}", data=b"1,2\n", headers=OWN)

    assert send("rig.csv").json == {"name": "rig.csv"}
    assert (send("rig.csv").status_code, send("rig.exe").status_code) == (409, 415)
    assert (tmp_path / "rig.csv").read_bytes() == b"1,2\n"
