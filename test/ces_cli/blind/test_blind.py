"""`ces blind`: cases are created and sealed; right answers score fully, wrong ones not at all."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from ces_cli.blind.diagnosing import AUGMENTED, MODEL
from ces_cli.blind.program import main
from ces_cli.terminal.terminal import run as run_program
from ces_gap import pipeline
from ces_gap.effects.library import library
from ces_rig.blind.cases import open_arrays, open_seal
from ces_rig.blind.scoring import DECISION, GAP, REPLAY, ROW

CASES, SECONDS = 6, "3"
SETTINGS = {"simulation": "run", "references": 2}
QUICK = ("friction", "force_scale", "inertia", "leakage")


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cases") / "dev"
    words = ["make", "--out", str(folder), "--seed", "5", "--cases", str(CASES), "--seconds", SECONDS, "--jobs", "1"]
    assert main([*words, "--gap-to-noise", "3", "--plants", "bouc_wen", "--effects", *QUICK]) == 0
    return folder


def test_a_case_with_a_recording_twice_fails_by_name(cases, tmp_path, capsys):
    planted = tmp_path / "planted"
    shutil.copytree(cases, planted)
    first = planted / "cases" / "0001"
    shutil.rmtree(first / "reference" / "f1")
    shutil.copytree(first / "real" / "r1", first / "reference" / "f1")
    words = ["run", str(planted), "--out", str(tmp_path / "results"), "--limit", "1", "--jobs", "1"]
    assert run_program("blind", main, [*words, "--simulation", "run", "--references", "2"]) == 2
    row = json.loads((tmp_path / "results" / "run_2" / "0001" / ROW).read_text())
    assert row["status"] == "failed" and "r1 and f1: the same recording, under --real and --reference" in row["reason"]


def make_gap(label, knows):
    """Return the gap.json of a diagnosis that knows the label, or names a wrong effect with certainty."""
    truth = [effect["name"] for effect in label["effects"]]
    named = truth if knows else ["bump_stop"]
    verdict = {"none": "no_gap", "outside": "unknown"}.get(label["kind"], "named") if knows else "named"
    found = named if verdict == "named" else []
    causes = [
        {"effect": name, "probability": float(i == 0 and bool(found))} for i, name in enumerate([*named, "backlash"])
    ]
    return {
        "schema": "ces-gap/1",
        "verdict": verdict,
        "where": [{"axis": "direction", "from": a, "to": a + 1, "share_of_energy": 0.5} for a in (-1.0, 0.0)],
        "causes": causes,
        "composition": {"effects": found, "shrink": None},
        "indistinguishable": [],
        "probabilities": {"none": float(verdict == "no_gap"), "unknown": float(verdict == "unknown")},
    }


def write_results(folder: Path, results: Path, knows: bool):
    """Write results of the default mode as `run` does, with answers from the opened seal; return their folder."""
    results = results / "run_2"
    results.mkdir(parents=True)
    published = (folder / "cases" / "seal.sha256").read_text().strip()
    (results / "run.json").write_text(json.dumps({**SETTINGS, "seal": published}))
    for label in open_seal(folder)[1]:
        mine = results / label["case"]
        mine.mkdir()
        arrays, gap = open_arrays(folder, label), make_gap(label, knows)
        true, effect, simulated = (arrays[f"h1_{key}"] for key in ("force_N", "effect_N", "baseline_N"))
        corrected = true - effect if knows else simulated
        augmented = true if knows else simulated
        claimed = 1.0 if knows else 0.9
        gap["composition"]["shrink"] = claimed
        (mine / GAP).write_text(json.dumps(gap))
        (mine / DECISION).write_text(json.dumps({"baselines": {"bic": gap["causes"][0]["effect"]}, "figures": None}))
        np.savez_compressed(mine / REPLAY, h1_simulated_N=simulated, h1_augmented_N=augmented, h1_corrected_N=corrected)
        (mine / ROW).write_text(json.dumps({"case": label["case"], "status": "done", "seconds": 1.0}))
    return results


def figures(text):
    """Return the values of the headline table by the figure's name."""
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| ")
    ]
    return {row[0]: row[1] for row in rows if len(row) == 5}


def test_the_sealed_cases_match_the_request(cases):
    about, labels = open_seal(cases)
    assert about["seed"] == 5
    assert [label["case"] for label in labels] == [f"{i:04d}" for i in range(1, CASES + 1)]
    assert sorted(label["kind"] for label in labels) == ["effect", "effect", "effect", "none", "outside", "pair"]
    assert all(label["gap_N"] == pytest.approx(24.0, rel=0.11) for label in labels if label["kind"] != "none")


def test_perfect_scores_for_right_answers(cases, tmp_path, capsys):
    results = write_results(cases, tmp_path / "results", knows=True)
    assert main(["score", str(cases), str(results), "--out", str(tmp_path / "report.md")]) == 0
    printed = capsys.readouterr().out
    assert (tmp_path / "report.md").read_text().strip() == printed.strip()
    got = figures(printed)
    full = ("top-1", "top-3", "verdict names exactly the effect", "outside called `unknown`", "both of a pair")
    assert [got[name] for name in full] == ["100.0 %"] * 5
    assert [got[name] for name in ("confidently wrong", "false alarms", "library called `unknown`")] == ["0.0 %"] * 3
    assert got["closure / oracle, median"] == "1.000"
    assert got["abs(claimed − true shrink), median"] == "0.000"
    assert got["ECE of the first candidate"] == got["Brier score"] == "0.000"
    assert "not met" not in printed
    assert main(["score", str(cases), str(results), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    shares = {row["figure"]: row["value"] for row in document["modes"]["run_2"]["all"]}
    assert document["schema"] == "ces-blind-score/1"
    assert [shares[name] for name in full] == [1.0] * 5 and shares["Brier score"] == pytest.approx(0.0)


def test_zero_scores_for_wrong_answers(cases, tmp_path, capsys):
    assert main(["score", str(cases), str(write_results(cases, tmp_path / "results", knows=False))]) == 0
    got = figures(capsys.readouterr().out)
    assert [got[name] for name in ("top-1", "top-3", "outside called `unknown`", "both of a pair")] == ["0.0 %"] * 4
    assert [got[name] for name in ("confidently wrong", "false alarms")] == ["100.0 %"] * 2
    assert got["closure, median"] == "0.0 %"
    assert got["abs(claimed − true shrink), median"] == "0.900"
    assert got["ECE of the first candidate"] == "1.000"


def test_the_diagnosis_itself(cases, tmp_path, capsys, monkeypatch):
    """One case from the recordings alone, with a model in place of the simulation; a second run has nothing to do."""
    monkeypatch.setattr(pipeline, "library", lambda: tuple(form for form in library() if form.name in QUICK))
    blind, results = tmp_path / "blind", tmp_path / "results"
    shutil.copytree(cases / "cases", blind / "cases")
    words = ["run", str(blind), "--out", str(results), "--limit", "1", "--jobs", "1"]
    words += ["--simulation", "identified", "--references", "0", "1"]  # the first is impossible
    assert main(words) == 0
    made = results / "identified_1" / "0001"
    assert {path.name for path in made.iterdir()} == {GAP, AUGMENTED, DECISION, REPLAY, ROW, MODEL}
    assert json.loads((made / GAP).read_text())["simulation"].endswith(MODEL)
    before = (made / ROW).stat().st_mtime_ns
    capsys.readouterr()
    assert main([*words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["modes"], document["diagnoses"], document["failed"]) == (["identified_1"], 1, [])
    assert (made / ROW).stat().st_mtime_ns == before
    (blind / "cases" / "seal.sha256").write_text("another")
    assert run_program("blind", main, words) == 2
    assert "identified_1: holds results of other cases; choose another folder" in capsys.readouterr().err
    assert main(["score", str(cases), str(results)]) == 0
    printed = capsys.readouterr().out
    assert f"1 of {CASES} sealed cases" in printed and "| `identified_1` | 1 |" in printed
    assert "model identified from the references as simulation, one reference;" in printed


def test_results_of_other_cases_are_refused(cases, tmp_path, capsys):
    results = write_results(cases, tmp_path / "results", knows=True)
    (results / "run.json").write_text(json.dumps({**SETTINGS, "seal": "another"}))
    assert run_program("blind", main, ["score", str(cases), str(results)]) == 2
    assert "holds results of other cases" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["make", "--out", "x", "--seed", "1", "--effects", "magic"],
            "--effects: invalid choice: 'magic'",
        ),
        (
            ["make", "--out", "x", "--seed", "1", "--kind", "odd"],
            "--kind: invalid choice: 'odd'",
        ),
        (
            ["make", "--out", ".", "--seed", "1", "--cases", "1"],
            ".: exists; choose another name for --out, or replace it with --overwrite",
        ),
        (["run", "x", "--out", "y", "--simulation", "identified", "--references", "0"], "add --references 1 or 2"),
        (["run", "nowhere", "--out", "y"], "nowhere: contains no cases/NNNN/case.json"),
        (["score", "nowhere", "y"], "nowhere: not a sealed blind test"),
        ([], "the following arguments are required: make|run|score"),
    ],
)
def test_mistakes(words, message, capsys, tmp_path, monkeypatch):
    (tmp_path / "here").write_text("")
    monkeypatch.chdir(tmp_path)
    try:
        status = run_program("blind", main, words)
    except SystemExit as leaving:
        status = leaving.code
    assert status == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
