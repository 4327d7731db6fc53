"""The node's worker process without ROS: its messages, how it stops, and that it ends with its parent."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from patience import command_of, wait_until

from ces_cli.identify.process import (
    DONE,
    EXIT_STATUS,
    READING,
    SEARCHING,
    WARNING,
    WRITING,
    IdentifyProcess,
    SearchState,
)
from ces_cli.identify.worker import name_parameters
from ces_observer.model import load_model

ROOT = Path(__file__).resolve().parents[3]
QUICK = ("--terms=2", "--threads=1", "--method=random")


def read_until(process, until=EXIT_STATUS):
    """Return the messages of the process up to one with the key `until`."""
    messages = []

    def has_come():
        messages.extend(process.read_messages())
        return any(until in message for message in messages)

    wait_until(has_come, messages)
    return messages


def start_identification(*words):
    return IdentifyProcess([*QUICK, *words, "--", str(ROOT / "bags" / "noise" / "noise.mcap")])


def test_it_sends_stages_costs_warnings_and_the_result(tmp_path):
    out, report = tmp_path / "model.json", tmp_path / "report.html"
    messages = read_until(start_identification("--time=60", "--starts=1", f"--out={out}", f"--report={report}"))
    assert [message["stage"] for message in messages if "stage" in message] == [READING, SEARCHING, WRITING]
    assert any("no header" in message[WARNING] for message in messages if WARNING in message)
    costs = [message["cost"] for message in messages if "cost" in message]
    assert costs and costs == sorted(costs, reverse=True)
    result = next(message["result"] for message in messages if "result" in message)
    assert result["text"] == out.read_text() == load_model(out).to_json()
    assert [(cost["recording"], cost["role"]) for cost in result["costs"]] == [
        ("noise", "identification"),
        ("noise", "validation"),
    ]
    assert (result["facts"]["model"], result["facts"]["report"]) == (str(out), str(report))
    assert report.stat().st_size > 10_000
    assert messages[-1] == {EXIT_STATUS: 0}


def test_interrupted_it_writes_the_best_so_far(tmp_path):
    process = start_identification("--time=600", "--starts=10000", f"--out={tmp_path / 'model.json'}")
    read_until(process, "cost")
    process.interrupt()
    messages = read_until(process)
    assert messages[-1] == {EXIT_STATUS: 0}
    assert load_model(tmp_path / "model.json").body.terms


def test_a_mistake_gives_one_line():
    for words, line in (
        ("--terms=999", "parameter terms: found '999'; expected a whole number from 1 to 200"),
        ("--signals=no", "no: cannot be read"),
    ):
        messages = read_until(start_identification(words))
        assert next(message["error"] for message in messages if "error" in message).startswith(line)
        assert messages[-1] == {EXIT_STATUS: 2}


def test_it_ends_with_its_parent():
    code = "from test_identify_process import start_identification; import os; "
    code += "print(start_identification('--time=600')._process.pid, flush=True)"
    folders = (ROOT, ROOT / "test" / "support", Path(__file__).parent)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))}
    command = [sys.executable, "-c", f"{code}; os._exit(1)"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if not Path("/proc").is_dir():
        pytest.skip("needs /proc")
    wait_until(lambda: b"ces_cli.identify" not in command_of(int(done.stdout)))


def test_progress_is_a_line_and_values():
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


def test_errors_name_parameters_instead_of_options(tmp_path):
    out = tmp_path / "model.json"
    out.touch()
    errors = [message["error"] for message in read_until(start_identification(f"--out={out}")) if "error" in message]
    assert errors == [f"{out}: exists; choose another name for parameter out, or replace it with parameter overwrite"]
    assert (
        name_parameters("--no-band: not --terms=3, a--b or --9") == "parameter band: not parameter terms=3, a--b or --9"
    )
