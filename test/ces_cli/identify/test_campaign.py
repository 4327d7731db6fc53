"""`ces identify --campaign` from end to end: tables and plot, and a run that was killed or interrupted.

The cells are computed in this process; test_workers runs them in others.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from campaign_parts import CAMPAIGN, RATE_HZ, furnish
from programs import ces, run_here
from small_recordings import make_columns, write_columns

from ces_cli.identify.campaign import describe_cell, result_tables
from ces_identify.campaign.cells import CampaignRows, CellNames
from ces_identify.jobs import JobResult, ResultsFolder

pytestmark = pytest.mark.slow
SMALL = CAMPAIGN.replace("seed: [1, 2]", "seed: 1").replace("terms: [2, 4]", "terms: [2, 3]")
CELLS = 6
Rows = dict[str, dict[str, Any]]


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The working folder, with bags, a campaign, and its results from an undisturbed run."""
    folder = tmp_path_factory.mktemp("campaign")
    furnish(folder, SMALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("ces_identify.jobs.run_in_processes", run_here)
        assert run("whole") == 0
        yield folder


def run(out: str, *words: str, campaign: str = "campaign.yaml") -> int:
    return ces("identify", "--campaign", campaign, "--out", out, "--jobs", 1, *words)


def lines_of(folder: str) -> list[bytes]:
    return Path(folder, "results.jsonl").read_bytes().splitlines(keepends=True)


def results_of(folder: str) -> tuple[Rows, dict[str, str]]:
    """Return the results of a run without its duration: rows and models by key."""
    rows = [json.loads(line) for line in lines_of(folder)]
    models = {path.stem: path.read_text() for path in Path(folder, "models").glob("*.json")}
    return {row["key"]: {k: v for k, v in row.items() if k != "seconds"} for row in rows}, models


def test_everything_is_written(work: Path) -> None:
    rows, models = results_of("whole")
    assert len(rows) == len(models) == len(lines_of("whole")) == CELLS
    assert {row["status"] for row in rows.values()} == {"done"}
    table = list(csv.DictReader((work / "whole" / "results.csv").open()))
    assert {row["key"] for row in table} == set(rows)
    assert [row["mark"] for row in table if row["bags"] == "one"].count("recommended") == 1
    for row in table:
        costs = {c["recording"]: c["J"] for c in rows[row["key"]]["costs"] if c["set"] == "other"}
        assert row["J other: two"] == str(costs.get("two", ""))
        assert bool(costs) == (row["bags"] == "one")


def test_a_complete_run_computes_nothing(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = lines_of("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ces_cli.identify.campaign.run_jobs", lambda *arguments: pytest.fail("computes"))
        assert run("whole") == 0
    said = capsys.readouterr().out
    assert lines_of("whole") == before
    assert "identified on both (3 of 3 models done)" in said and "beside it decide nothing" in said


def test_cells_are_named_by_what_differs_and_counted_by_bags() -> None:
    row = {"key": "k", "bags": "noise", "structure": "polynomial", "terms": 5, "seed": 2, "status": "done"}
    row |= {"selection_J": 4.2, "parameters": 5, "seconds": 1.0, "gain": 0.5, "costs": [], "size": "5 terms"}
    rows = CampaignRows((row,), 9, CellNames(("terms", "seed"), True))
    assert describe_cell(rows, row) == "noise: polynomial, 5 terms, seed 2: selection J 4.20 %, 5 parameters, 1.0 s"
    (table,) = result_tables(rows, {"noise": 4, "both": 5}, 40)
    assert table.title == "identified on noise (1 of 4 models done); costs J in %"


def test_the_document_has_the_rows_of_the_results(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("whole", "--json") == 0
    document, (rows, _) = json.loads(capsys.readouterr().out), results_of("whole")
    assert document["schema"] == "ces-campaign/1" and document["planned"] == CELLS
    assert {cell["key"]: cell["costs"] for cell in document["cells"]} == {k: r["costs"] for k, r in rows.items()}
    marked = {cell["key"] for cell in document["cells"] if cell["mark"] == "recommended"}
    assert {Path(path).stem for path in document["recommended"].values()} == marked
    assert all(Path(path).is_file() for path in document["recommended"].values())


def test_a_killed_run_continues_with_the_same_results(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A kill leaves whole rows, perhaps a torn one, and perhaps a model without its row."""
    finished = lines_of("whole")[:4]
    shutil.copytree("whole/models", "killed/models")
    Path("killed/results.jsonl").write_bytes(b"".join(finished) + b'{"key": "torn')
    capsys.readouterr()
    assert run("killed") == 0
    assert f"4 of {CELLS} cells are done from an earlier run" in capsys.readouterr().err
    assert lines_of("killed")[:4] == finished
    assert len(lines_of("killed")) == CELLS
    assert results_of("killed") == results_of("whole")


def test_ctrl_c_writes_the_finished_cells(
    work: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    add = ResultsFolder.add

    def add_and_interrupt(results: ResultsFolder, result: JobResult) -> None:
        add(results, result)
        if len(results.rows) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(ResultsFolder, "add", add_and_interrupt)
    assert run("interrupted") == 130
    assert f"interrupted after 2 of {CELLS} cells; run the same command to continue" in capsys.readouterr().err
    (rows, models), (all_rows, all_models) = results_of("interrupted"), results_of("whole")
    assert len(rows) == 2 and all(rows[key] == all_rows[key] and models[key] == all_models[key] for key in rows)
    assert len(list(csv.DictReader((work / "interrupted" / "results.csv").open()))) == 2


def test_failed_cells_are_reported_and_not_tried_again(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_columns(work / "short", *make_columns(1.0, 3, RATE_HZ))
    text = SMALL.replace("both: [one, two]", "short: short").replace("seed: 1", "").replace("terms: [2, 3]", "terms: 2")
    Path("some.yaml").write_text(text)
    for _ in range(2):
        assert run("some", campaign="some.yaml") == 0
        assert capsys.readouterr().err.count("warning: short: polynomial: ") == 1
    assert [json.loads(line)["status"] for line in lines_of("some")] == ["done", "done", "failed", "failed"]
    Path("none.yaml").write_text(text.replace("  one: [one]\n", ""))
    assert run("none", campaign="none.yaml") == 2
    assert "all 2 cells failed" in capsys.readouterr().err.splitlines()[-1]
    assert not (work / "none" / "results.csv").exists()
