"""The node's worker process without ROS: its messages, how it stops, and that it ends with its parent."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from patience import command_of, wait_until
from shared_results import SharedResults

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
from ces_observer.model import load_model

ROOT = Path(__file__).resolve().parents[3]


def read_until(process: IdentifyProcess, until: str = EXIT_STATUS) -> list[dict[str, Any]]:
    """Return the messages of the process up to one with the key `until`."""
    messages: list[dict[str, Any]] = []

    def has_come() -> bool:
        messages.extend(process.read_messages())
        return any(until in message or EXIT_STATUS in message for message in messages)

    wait_until(has_come, messages)
    return messages


def values_of(messages: list[dict[str, Any]], key: str) -> list[Any]:
    return [message[key] for message in messages if key in message]


@pytest.mark.slow
def test_interrupted_it_sends_stages_costs_warnings_and_the_best_so_far(
    shared_model: SharedResults, tmp_path: Path
) -> None:
    out, report = tmp_path / "model.json", tmp_path / "report.html"
    given = {"terms": 2, "threads": 1, "time": 600.0, "starts": 10000, "out": str(out), "report": str(report)}
    given |= {"candidates": str(shared_model.folder / "rules.yaml")}
    process = IdentifyProcess({**given, "bags": [str(shared_model.folder / "one" / "one.mcap")]})
    messages = read_until(process, "cost")
    while values_of(messages, "cost")[-1] > 50.0:  # the first model of a start explains nothing
        messages += read_until(process, "cost")
    process.interrupt()
    messages += read_until(process)
    assert values_of(messages, "stage") == [READING, SEARCHING, WRITING]
    assert any("no header" in warning for warning in values_of(messages, WARNING))
    costs = values_of(messages, "cost")
    assert costs and costs == sorted(costs, reverse=True)
    (result,) = values_of(messages, "result")
    assert out.read_text() == load_model(out).to_json()
    assert [(cost["recording"], cost["role"]) for cost in result["costs"]] == [
        ("one", "identification"),
        ("one", "validation"),
    ]
    assert (result["facts"]["model"], result["facts"]["report"]) == (str(out), str(report))
    assert report.stat().st_size > 10_000
    assert messages[-1] == {EXIT_STATUS: 0}


@pytest.mark.slow
def test_a_mistake_gives_one_line_that_names_parameters(tmp_path: Path) -> None:
    out = tmp_path / "model.json"
    out.touch()
    for name, value, line in (
        ("terms", 999, "parameter 'terms' is 999; expected a whole number from 1 to 200"),
        ("out", str(out), f"{out}: exists; choose another name for parameter 'out', or replace it with parameter over"),
    ):
        messages = read_until(IdentifyProcess({name: value, "bags": ["bag"]}))
        assert [error[: len(line)] for error in values_of(messages, "error")] == [line]
        assert messages[-1] == {EXIT_STATUS: 2}


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
def test_it_ends_with_its_parent() -> None:
    code = "import os; from ces_cli.identify.process import IdentifyProcess as P; "
    code += "print(P({'time': 600.0, 'bags': ['bags/noise']})._process.pid, flush=True); os._exit(1)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    wait_until(lambda: b"ces_cli.identify" not in command_of(int(done.stdout)))


def test_progress_is_a_line_and_values() -> None:
    now = [100.0]
    state = SearchState(lambda: now[0])
    assert state.as_status() == ("starting", {"stage": "starting", "elapsed [s]": "0.0", "share": "0.000"})
    state.update({"stage": SEARCHING, "starts": 8})
    now[0] = 105.0
    assert state.as_status()[0] == "searching: no model yet"
    state.update({"cost": 12.345, "size": 7, "ended": 3, "share": 0.25})
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
