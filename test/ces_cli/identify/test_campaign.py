"""`ces identify --campaign` from end to end: tables and plot, a killed and an interrupted run, mistakes of the user."""

import csv
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ces_cli.identify.campaign import describe_cell, result_tables
from ces_cli.main import main
from ces_data.bags.writer import recording_topics, write_bag
from ces_identify.campaign.rows import CampaignRows, CellNames

ROOT = Path(__file__).parents[3]
from campaign_parts import CAMPAIGN, DEFAULT, furnish, made  # noqa: E402
from patience import PATIENCE_S, wait_until  # noqa: E402

CELLS = 12
FILES = ("results.jsonl", "results.csv", "campaign.html")


def ces(*words):
    return main([str(word) for word in words])


def error_line(capsys, *words):
    """Run a campaign that must fail; return its error line."""
    capsys.readouterr()
    assert ces("identify", *words) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1, lines
    return lines[0]


def lines_of(folder):
    path = folder / "results.jsonl"
    return path.read_bytes().splitlines(keepends=True) if path.exists() else []


def results_of(folder):
    """Results of a run without its duration: rows and models by key."""
    rows = [json.loads(line) for line in lines_of(folder)]
    models = {path.stem: path.read_text() for path in (folder / "models").glob("*.json")}
    measured = ("seconds", "tick_us")
    return {row["key"]: {k: v for k, v in row.items() if k not in measured} for row in rows}, models


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with bags, a campaign, and its results from an undisturbed run."""
    folder = tmp_path_factory.mktemp("campaign")
    assert ces("identify", "--campaign", furnish(folder), "--out", folder / "whole", "--jobs", 2) == 0
    return folder


RUN = """
import signal, sys
from ces_cli.main import main
from ces_identify.jobs import ResultsFolder

def add_and_wait(results, *found):
    add(results, *found)
    if len(results.rows) == {count}:
        signal.pause()  # until the test sends a signal

signal.signal(signal.SIGINT, signal.default_int_handler)
add, ResultsFolder.add = ResultsFolder.add, add_and_wait
sys.exit(main({words!r}))
"""


def start_run(work, out, count):
    """Start a run of the campaign in a process group of its own; it stands still once it has `count` results."""
    words = ["identify", "--campaign", "campaign.yaml", "--out", out, "--jobs", "1"]
    code = RUN.format(count=count, words=words)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=work,
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_until(lambda: len(lines_of(work / out)) == count or run.poll() is not None)
    return run


def test_everything_is_written(work):
    assert all((work / "whole" / name).stat().st_size > 0 for name in FILES)
    rows, models = results_of(work / "whole")
    assert len(rows) == len(models) == len(lines_of(work / "whole")) == CELLS
    assert {row["status"] for row in rows.values()} == {"done"}


def test_the_table_has_a_line_for_each_cell(work):
    rows, _ = results_of(work / "whole")
    table = list(csv.DictReader((work / "whole" / "results.csv").open()))
    assert {row["key"] for row in table} == set(rows)
    assert [row["mark"] for row in table if row["bags"] == "one"].count("recommended") == 1
    for row in table:
        costs = {c["recording"]: c["J"] for c in rows[row["key"]]["costs"] if c["set"] == "other"}
        assert row["J other: two"] == str(costs.get("two", ""))
        assert bool(costs) == (row["bags"] == "one")


def test_a_complete_run_computes_nothing(work, capsys, monkeypatch):
    monkeypatch.setattr("ces_cli.identify.campaign.run_jobs", lambda *arguments: pytest.fail)
    before = lines_of(work / "whole")
    assert ces("identify", "--campaign", work / "campaign.yaml", "--out", work / "whole") == 0
    assert lines_of(work / "whole") == before
    said = capsys.readouterr().out
    assert "identified on both (6 of 6 models done)" in said and "beside it decide nothing" in said


def test_cells_are_named_by_what_differs_and_counted_by_bags():
    row = {"key": "k", "bags": "noise", "structure": "polynomial", "terms": 5, "seed": 2, "status": "done"}
    row |= {"selection_J": 4.2, "parameters": 5, "seconds": 1.0, "gain": 0.5, "costs": [], "size": "5 terms"}
    rows = CampaignRows((row,), 9, CellNames(("terms", "seed"), True))
    assert describe_cell(rows, row) == "noise: polynomial, 5 terms, seed 2: selection J 4.20 %, 5 parameters, 1.0 s"
    (table,) = result_tables(rows, {"noise": 4, "both": 5}, 40)
    assert table.title == "identified on noise (1 of 4 models done); costs J in %"


def test_the_document_has_the_rows_of_the_results(work, capsys):
    assert ces("identify", "--campaign", work / "campaign.yaml", "--out", work / "whole", "--json") == 0
    document, (rows, _) = json.loads(capsys.readouterr().out), results_of(work / "whole")
    assert document["schema"] == "ces-campaign/1" and document["planned"] == CELLS
    assert {cell["key"]: cell["costs"] for cell in document["cells"]} == {k: r["costs"] for k, r in rows.items()}
    marked = {cell["key"] for cell in document["cells"] if cell["mark"] == "recommended"}
    assert {Path(path).stem for path in document["recommended"].values()} == marked
    assert all(Path(path).is_file() for path in document["recommended"].values())


def test_a_killed_run_continues_with_the_same_results(work, capsys):
    folder = work / "killed"
    run = start_run(work, "killed", 3)
    os.kill(run.pid, signal.SIGKILL)
    os.killpg(run.pid, signal.SIGTERM)  # its orphans, which would end by themselves some minutes later
    run.communicate()
    finished = lines_of(folder)
    assert len(finished) == 3
    with (folder / "results.jsonl").open("ab") as file:
        file.write(b'{"key": "torn')
    capsys.readouterr()
    assert ces("identify", "--campaign", work / "campaign.yaml", "--out", folder, "--jobs", 2) == 0
    assert f"{len(finished)} of {CELLS} cells are done from an earlier run" in capsys.readouterr().err
    lines = lines_of(folder)
    assert lines[: len(finished)] == finished
    assert len(lines) == len({json.loads(line)["key"] for line in lines}) == CELLS
    assert results_of(folder) == results_of(work / "whole")


def test_ctrl_c_writes_the_finished_cells(work):
    folder = work / "interrupted"
    run = start_run(work, "interrupted", 2)
    os.killpg(run.pid, signal.SIGINT)
    _, errors = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 130
    assert "Traceback" not in errors
    assert f"of {CELLS} cells; run the same command to continue" in errors
    rows, models = results_of(folder)
    assert 2 <= len(rows) < CELLS  # those that were found by then, too
    whole = results_of(work / "whole")
    assert all(rows[key] == whole[0][key] and models[key] == whole[1][key] for key in rows)
    assert len(list(csv.DictReader((folder / "results.csv").open()))) == len(rows)


def test_failed_cells_are_reported_and_not_tried_again(work, tmp_path, capsys):
    write_bag(work / "short", recording_topics(made(3, seconds=1.0, name="short"), DEFAULT))
    (work / "some.yaml").write_text(CAMPAIGN.replace("both: [one, two]", "short: short").replace("seed: [1, 2]", ""))
    for _ in range(2):
        assert ces("identify", "--campaign", work / "some.yaml", "--out", tmp_path / "out", "--jobs", 2) == 0
        assert capsys.readouterr().err.count("warning: short: polynomial, 2 terms: ") == 1
    assert [json.loads(line)["status"] for line in lines_of(tmp_path / "out")].count("failed") == 3
    page = (tmp_path / "out" / "campaign.html").read_text(encoding="utf-8")
    assert "short: polynomial, 2 terms" in page  # the name that the warning has
    assert len(lines_of(tmp_path / "out")) == 6
    (work / "none.yaml").write_text((work / "some.yaml").read_text().replace("  one: [one]\n", ""))
    assert ces("identify", "--campaign", work / "none.yaml", "--out", tmp_path / "none", "--jobs", 2) == 2
    assert "all 3 cells failed" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "none" / "results.csv").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--out", "o", "--terms", 9), "--terms has no effect with --campaign; set it in"),
        (("one", "--out", "o"), "BAG has no effect with --campaign"),
        ((), "add --out DIR"),
        (("--out", "o", "--dask", "here:1", "--jobs", 2), "--jobs applies to this machine"),
        (("--out", "campaign.yaml"), "campaign.yaml: is not a folder"),
    ],
)
def test_wrong_arguments(work, monkeypatch, capsys, words, expected):
    monkeypatch.chdir(work)
    assert expected in error_line(capsys, "--campaign", "campaign.yaml", *words)


def test_options_of_campaigns_need_one(capsys):
    assert "add --campaign FILE.yaml" in error_line(capsys, "one", "--jobs", 2)


def test_a_missing_bag_is_named_before_anything_is_computed(work, tmp_path, capsys):
    (work / "missing.yaml").write_text(CAMPAIGN.replace("other: two", "other: nowhere"))
    assert "nowhere: no such file" in error_line(capsys, "--campaign", work / "missing.yaml", "--out", tmp_path / "o")
    assert not (tmp_path / "o").exists()
