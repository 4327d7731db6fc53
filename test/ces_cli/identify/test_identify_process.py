"""The node's worker process without ROS: what it tells, how it is stopped, and that it ends with whoever started it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ces_cli.identify.process import EXIT_STATUS, WARNING, IdentifyProcess
from ces_cli.identify.progress import DONE, READING, SEARCHING, WRITING, SearchState
from ces_observer.model import load_model

ROOT = Path(__file__).resolve().parents[3]
LONG_S = 60.0
QUICK = ("--terms=2", "--threads=1", "--method=random")


def said(process, until=EXIT_STATUS):
    """Return what the process told up to a message with the key `until`."""
    found, end = [], time.monotonic() + LONG_S
    while not any(until in message for message in found):
        assert time.monotonic() < end, found
        found += process.heard()
        time.sleep(0.01)
    return found


def started(*words):
    return IdentifyProcess([*QUICK, *words, "--", str(ROOT / "bags" / "noise")])


def test_it_tells_stages_costs_warnings_and_the_result(tmp_path):
    out, report = tmp_path / "model.json", tmp_path / "report.html"
    told = said(started("--time=0.5", "--starts=2", f"--out={out}", f"--report={report}"))
    assert [message["stage"] for message in told if "stage" in message] == [READING, SEARCHING, WRITING]
    assert any("no header" in message[WARNING] for message in told if WARNING in message)
    costs = [message["cost"] for message in told if "cost" in message]
    assert costs and costs == sorted(costs, reverse=True)
    result = next(message["result"] for message in told if "result" in message)
    assert result["text"] == out.read_text() == load_model(out).to_json()
    assert [(cost["recording"], cost["role"]) for cost in result["costs"]] == [
        ("noise", "identification"),
        ("noise", "validation"),
    ]
    assert (result["facts"]["model"], result["facts"]["report"]) == (str(out), str(report))
    assert report.stat().st_size > 10_000
    assert told[-1] == {EXIT_STATUS: 0}


def test_interrupted_it_writes_the_best_so_far(tmp_path):
    process = started("--time=600", "--starts=10000", f"--out={tmp_path / 'model.json'}")
    said(process, "cost")
    process.interrupt()
    told = said(process)
    assert told[-1] == {EXIT_STATUS: 0}
    assert load_model(tmp_path / "model.json").body.terms


def test_mistakes_are_one_line():
    for words, line in (
        ("--terms=999", "parameter terms: 999 is outside 1 to 200"),
        ("--signals=no", "no: cannot be read"),
    ):
        told = said(started(words))
        assert next(message["error"] for message in told if "error" in message).startswith(line)
        assert told[-1] == {EXIT_STATUS: 2}


def test_it_ends_with_its_starter():
    code = "from test_identify_process import started; print(started('--time=600')._process.pid, flush=True); import os"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(Path(__file__).parent)])}
    command = [sys.executable, "-c", f"{code}; os._exit(1)"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    worker = Path(f"/proc/{int(done.stdout)}/cmdline")
    if not Path("/proc").is_dir():
        pytest.skip("needs /proc")
    end = time.monotonic() + LONG_S
    while worker.exists() and b"identify_worker" in worker.read_bytes():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_progress_is_a_line_and_figures():
    now = [100.0]
    state = SearchState(lambda: now[0])
    assert state.as_status() == ("starting", {"stage": "starting", "elapsed [s]": "0.0", "share": "0.000"})
    state.update({"stage": SEARCHING, "seconds": 20.0, "starts": 8})
    now[0] = 105.0
    assert state.as_status()[0] == "searching: no model yet"
    state.update({"cost": 12.345, "size": 7, "ended": 3})
    assert state.as_status() == (
        "searching: selection cost J = 12.35 %, size 7, 3 of 8 starts done, 5 s",
        {
            "stage": SEARCHING,
            "elapsed [s]": "5.0",
            "share": "0.250",
            "J [%]": "12.3450",
            "size": "7",
            "starts ended": "3",
        },
    )
    state.clear_changes()
    assert not state.changed
    state.update({"stage": DONE})
    assert (state.changed_stage, state.as_status()[1]["share"]) == (True, "1.000")
