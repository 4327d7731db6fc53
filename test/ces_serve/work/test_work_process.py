"""Work in another process: its result, its failures in one line, its time limit, and its end when nobody waits."""

from __future__ import annotations

import os
import re
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from patience import PATIENCE_S, children_running
from served_folders import BAGS

from ces_identify import make_recording, write_recording
from ces_serve.work import process
from ces_serve.work.inspection import inspect_recording
from ces_serve.work.process import FAILED, RESULT, do_work
from ces_serve.work.worker import MAX_FILE_BYTES, MAX_MEMORY_BYTES

INSPECT = {"name": "inspect", "path": str(BAGS / "sine_4hz"), "signals": None}


def last_message(task: Mapping[str, Any], limit_s: float = PATIENCE_S) -> dict[str, Any]:
    """Return the message with which a task ends."""
    return list(do_work(task, limit_s))[-1]


def test_a_recording_is_inspected_as_by_ces_info() -> None:
    found = last_message(INSPECT)[RESULT]
    channels = {channel["name"]: channel for channel in found["channels"]}
    assert set(channels) == {"position", "current", "force"}
    force = channels["force"]
    assert force["rate_Hz"] == pytest.approx(1000.0, rel=1e-3)
    assert (min(force["value"]), max(force["value"])) == (force["low"], force["high"])  # no peak is lost
    assert len(force["time_s"]) == len(force["value"]) == 1200


def test_a_pause_of_a_recording_is_a_gap_in_its_lines(tmp_path: Path) -> None:
    time_s = np.concatenate([np.arange(0.0, 2.0, 1e-3), np.arange(3.0, 5.0, 1e-3)])
    wave = np.sin(9.0 * time_s)
    write_recording(make_recording(time_s, 0.01 * wave, 0.5 + 0.1 * wave, 900.0 * wave), tmp_path / "paused")
    for channel in inspect_recording(str(tmp_path / "paused"), None, lambda what: None)["channels"]:
        open_s = [t for t, value in zip(channel["time_s"], channel["value"], strict=True) if value is None]
        assert open_s == [pytest.approx(2.5, abs=1e-3)]
        assert channel["time_s"] == sorted(channel["time_s"])


def test_a_wrong_path_is_one_line(tmp_path: Path) -> None:
    assert "no such file or folder" in last_message({**INSPECT, "path": str(tmp_path / "missing")})[FAILED]


def test_work_that_takes_too_long_is_stopped() -> None:
    assert "it took longer than 0 s" in last_message(INSPECT, 0.05)[FAILED]
    assert children_running(process.WORKER) == set()


@pytest.fixture
def endless_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[dict[str, Any], None, None]:
    """The messages of a worker that reports once and then never ends."""
    lines = (
        "import time",
        "from ces_serve.work import worker",
        "worker._do = lambda task, report: (report('begins'), time.sleep(3600))",
        "worker.main()",
    )
    (tmp_path / "endless_worker.py").write_text("\n".join(lines))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(Path(process.__file__).parents[2])]))
    monkeypatch.setattr(process, "WORKER", "endless_worker")
    messages = do_work(INSPECT, 600.0)
    next(message for message in messages if "progress" in message)
    return messages


def test_work_ends_when_nobody_waits_for_it(endless_messages: Generator[dict[str, Any], None, None]) -> None:
    assert len(children_running("endless_worker")) == 1
    endless_messages.close()
    assert children_running("endless_worker") == set()


def test_work_is_limited_and_its_files_go_with_it(endless_messages: Generator[dict[str, Any], None, None]) -> None:
    (pid,) = children_running("endless_worker")
    limits = Path(f"/proc/{pid}/limits").read_text()
    assert re.search(rf"Max address space +{MAX_MEMORY_BYTES}", limits)
    assert re.search(rf"Max file size +{MAX_FILE_BYTES}", limits)
    environment = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    scratch = next(Path(os.fsdecode(one.removeprefix(b"TMPDIR="))) for one in environment if one.startswith(b"TMPDIR="))
    (scratch / "unpacked.mcap").write_bytes(b"half a copy")
    endless_messages.close()
    assert not scratch.exists()


def test_a_process_that_dies_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "WORKER", "ces_serve.no_such_module")
    assert "the process ended without a result" in last_message(INSPECT)[FAILED]
