"""`--json`: one document on standard output whose numbers are those of the table, not rounded.

The documents of campaign, iterate, diagnose and blind are tested with these programs.
"""

from __future__ import annotations

import json
import math
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from programs import NO_SHORT_FITS, ces, document_of, text_of
from small_recordings import RULES, make_columns, write_columns, write_small_csv

from bench.reference.programs import parser_of
from ces_cli.main import PROGRAMS
from ces_cli.terminal.options import list_actions
from ces_cli.terminal.outputs import as_plain, print_document, without_text
from ces_observer import __version__
from ces_report.typesetting import format_within

pytestmark = pytest.mark.slow
WITHOUT_TABLES = {
    "export-data": "writes the tables themselves",
    "serve": "shows pages",
}


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two bags, a CSV file and a model."""
    folder = tmp_path_factory.mktemp("documents")
    (folder / "rules.yaml").write_text(RULES)
    for seed, name in enumerate(("one", "two"), start=1):
        write_columns(folder / name, *make_columns(8.0, seed, 250.0))
    write_small_csv(folder / "log.csv", seconds=4.0)
    (folder / "map.yaml").write_text(
        "time: {column: time_s}\nposition: {column: position_m}\n"
        "current: {column: current_A}\nforce: {column: force_N}\n"
    )
    return folder


@pytest.fixture(scope="module")
def identified(work: Path) -> tuple[dict[str, Any], Path]:
    """The document of an identification with folds, and its model."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(work)
        patch.setattr(*NO_SHORT_FITS)
        words = ("identify", "one", "--validate", "two", "--out", "model.json", "--candidates", "rules.yaml")
        with (work / "document").open("w") as out, redirect_stdout(out):
            assert ces(*words, "--terms", 4, "--starts", 1, "--threads", 1, "--folds", 2, "--json") == 0
    return json.loads((work / "document").read_text()), work / "model.json"


def test_every_program_with_tables_has_the_option() -> None:
    for name in PROGRAMS:
        options = {option for action in list_actions(parser_of(name)) for option in action.option_strings}
        assert ("--json" in options) != (name in WITHOUT_TABLES), name


def test_validate(work: Path, identified: object, capsys: pytest.CaptureFixture[str]) -> None:
    bags, more = (work / "two", work / "one"), ("--certificate", "--weight", "zero_crossing=3")
    words = ("validate", work / "model.json", *bags, *more)
    document, text = document_of(capsys, *words), text_of(capsys, *words)
    assert document["ces_observer"] == __version__
    for row in document["recordings"]:
        low, high = row["ci95_percent"]
        cost, ends = format_within(row["J_percent"], low, high)
        cells = (cost, *ends.split(" to "), f"{row['weighted_J_percent']:.2f}")
        cells += (f"{row['rms_N']:.1f}", f"{100 * row['outside_envelope']:.1f}", f"{100 * row['inside_band']:.1f}")
        line = next(line for line in text.splitlines() if line.strip().startswith(row["recording"]))
        assert all(cell in line.split() for cell in cells), (cells, line)
        assert row["J_percent"] != round(row["J_percent"], 6)
    assert document["certificate"]["proved"] and document["model"]["proved_stable"]
    assert set(document["residuals"]) == {"one", "two"}


def test_identify(identified: tuple[dict[str, Any], Path]) -> None:
    document, model = identified
    assert document["schema"] == "ces-identify/1"
    stored = json.loads(model.read_text())["provenance"]
    assert {row["recording"]: round(row["J_percent"], 4) for row in document["recordings"]} == {
        row["recording"]: row["J"] for row in stored["cost_J_percent"]
    }
    assert document["search"]["best_seed"] == stored["selection"]["best_seed"]
    folds = document["folds"]
    assert folds["mean_J_percent"] == pytest.approx(np.mean([row["J_percent"] for row in folds["rows"]]))
    assert [round(row["J_percent"], 4) for row in folds["rows"]] == [r["J_percent"] for r in stored["cross_validation"]]
    assert document["teacher"] is None and document["report"] is None


def test_info(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document, text = document_of(capsys, "info", work / "one"), text_of(capsys, "info", work / "one")
    for name, channel in document["recordings"][0]["channels"].items():
        line = next(line for line in text.splitlines() if line.strip().startswith(f"{name} {channel['unit']}"))
        assert f"{channel['low']:.4g}" in line and f"{channel['rate_Hz']:.1f}" in line


def test_replay_and_simulate(
    work: Path, identified: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (work / "model.json", work / "two", "--overwrite", "--out", tmp_path / "bag")
    replayed, text = document_of(capsys, "replay", *words), text_of(capsys, "replay", *words)
    assert f"{replayed['estimates']} forces estimated from {replayed['position_samples']} position samples" in text
    assert all(f"withheld {count}: {reason}" in text for reason, count in replayed["withheld"].items())
    out = tmp_path / "force.csv"
    simulated = document_of(capsys, "simulate", "--sim", work / "model.json", work / "two", "--out", out)
    force = np.genfromtxt(out, delimiter=",", names=True)["force_N"]
    assert (simulated["rows"], simulated["rows_without_force"]) == (len(force), int(np.isnan(force).sum()))
    assert simulated["force_N"] == [np.nanmin(force), np.nanmax(force)] == pytest.approx(replayed["force_N"])


def test_import_rig_and_export(
    work: Path, identified: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imported = document_of(
        capsys, "import", work / "log.csv", "--mapping", work / "map.yaml", "--out", tmp_path / "log"
    )
    assert imported["bags"][0]["samples"] == 2000 and imported["bags"][0]["rate_Hz"] == pytest.approx(500.0)
    (tmp_path / "short.yaml").write_text(
        "duration_s: 1\nstroke: {kind: rest}\ncurrent: {kind: constant, current_A: 0.4}\n"
    )
    recorded = document_of(capsys, "rig", tmp_path / "short.yaml", "--out", tmp_path / "short")
    assert recorded["channels"]["position"]["samples"] == 1000 and recorded["experiment"] == "short"
    listed, text = document_of(capsys, "rig", "--list"), text_of(capsys, "rig", "--list")
    assert [line.split()[0] for line in text.splitlines()] == [row["name"] for row in listed["experiments"]]
    exported = document_of(capsys, "export", work / "model.json", "--out", tmp_path / "damper.c")
    assert exported["proved_stable"] and Path(exported["written"]).is_file()


def test_a_mistake_prints_no_document(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ces("validate", work / "nothing.json", work / "two", "--json") == 2
    printed = capsys.readouterr()
    assert printed.out == "" and len(printed.err.splitlines()) == 1


def test_numbers_and_other_values_become_plain() -> None:
    given = {
        "a": np.array([1.0, np.nan]),
        "b": np.float32(0.5),
        "c": Path("x"),
        1: (math.inf, {3, 2}),
        "d": np.bool_(True),
    }
    assert as_plain(given) == {"a": [1.0, None], "b": 0.5, "c": "x", "1": [None, [2, 3]], "d": True}
    with pytest.raises(TypeError, match="complex has no form in JSON"):
        as_plain(1j)


def test_text_is_discarded_only_where_wanted(capsys: pytest.CaptureFixture[str]) -> None:
    with without_text(False):
        print("seen")
    with without_text(True):
        print("unseen")
    print_document("test", {"x": -math.inf})
    assert capsys.readouterr().out.startswith('seen\n{\n "schema": "ces-test/1"')
