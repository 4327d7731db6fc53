"""`ces blind`: cases are created and sealed; right answers score fully, wrong ones not at all."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from programs import ces, error_line, only_effects, run_here, text_of

from ces_cli.blind_case import AUGMENTED, MODEL
from ces_rig.blind.cases import CaseLabel, open_arrays, open_seal
from ces_rig.blind.scoring import DECISION, GAP, REPLAY, ROW

pytestmark = pytest.mark.slow
CASES, SECONDS = 6, 3
SETTINGS = {"simulation": "run", "references": 2}
QUICK = ("friction", "force_scale", "inertia", "leakage")


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of six sealed cases; diagnoses run in this process, with the few effects that were withheld."""
    folder = tmp_path_factory.mktemp("cases") / "dev"
    words = ("--out", folder, "--seed", 5, "--cases", CASES, "--seconds", SECONDS, "--jobs", 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ces_cli.blind.run_in_processes", run_here)
        patch.setattr("ces_cli.blind_case.physical_structures", lambda: ("hydraulic",))
        patch.setattr(*only_effects(*QUICK))
        assert ces("blind", "make", *words, "--gap-to-noise", 3, "--plants", "bouc_wen", "--effects", *QUICK) == 0
        yield folder


def test_a_case_with_a_recording_twice_fails_by_name(
    cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    planted = tmp_path / "planted"
    shutil.copytree(cases, planted)
    first = planted / "cases" / "0001"
    shutil.rmtree(first / "reference" / "f1")
    shutil.copytree(first / "real" / "r1", first / "reference" / "f1")
    words = ("blind", "run", planted, "--out", tmp_path / "results", "--limit", 1, "--jobs", 1)
    assert ces(*words, "--simulation", "run", "--references", 2) == 2
    row = json.loads((tmp_path / "results" / "run_2" / "0001" / ROW).read_text())
    assert row["status"] == "failed" and "r1 and f1: the same recording, under real and reference" in row["reason"]


def make_gap(label: CaseLabel, knows: bool) -> dict[str, Any]:
    """Return the gap.json of a diagnosis that knows the label, or names a wrong effect with certainty."""
    truth = [effect.name for effect in label.effects]
    named = truth if knows else ["bump_stop"]
    verdict = {"none": "no_gap", "outside": "unknown"}.get(label.kind, "named") if knows else "named"
    found = named if verdict == "named" else []
    causes = [
        {"effect": name, "probability": float(i == 0 and bool(found))} for i, name in enumerate([*named, "backlash"])
    ]
    return {
        "schema": "ces-gap/1",
        "verdict": verdict,
        "causes": causes,
        "composition": {"effects": found, "shrink": None, "probability": float(bool(found))},
        "indistinguishable": [],
        "probabilities": {"none": float(verdict == "no_gap"), "unknown": float(verdict == "unknown")},
    }


def write_results(folder: Path, results: Path, knows: bool) -> Path:
    """Write results of the default mode as `run` does, with answers from the opened seal; return their folder."""
    results = results / "run_2"
    results.mkdir(parents=True)
    published = (folder / "cases" / "seal.sha256").read_text().strip()
    (results / "run.json").write_text(json.dumps({**SETTINGS, "seal": published}))
    for label in open_seal(folder).labels:
        mine = results / label.case
        mine.mkdir()
        arrays, gap = open_arrays(folder, label), make_gap(label, knows)
        true, simulated = (arrays[f"h1_{key}"] for key in ("force_N", "baseline_N"))
        augmented = true if knows else simulated
        claimed = 1.0 if knows else 0.9
        gap["composition"]["shrink"] = claimed
        (mine / GAP).write_text(json.dumps(gap))
        np.savez_compressed(mine / REPLAY, h1_simulated_N=simulated, h1_augmented_N=augmented)
        (mine / ROW).write_text(json.dumps({"case": label.case, "status": "done", "seconds": 1.0}))
    return results


def figures(text: str) -> dict[str, str]:
    """Return the values of the first table's only row by the figure's name."""
    head, _, row = text.splitlines()[:3]
    names, values = ([cell.strip() for cell in line.strip("|").split("|")] for line in (head, row))
    return {name: value.split(" (")[0] for name, value in zip(names, values, strict=True)}


def test_the_sealed_cases_match_the_request(cases: Path) -> None:
    sealed = open_seal(cases)
    labels = sealed.labels
    assert sealed.about["seed"] == 5
    assert [label.case for label in labels] == [f"{i:04d}" for i in range(1, CASES + 1)]
    assert sorted(label.kind for label in labels) == ["effect", "effect", "effect", "none", "outside", "pair"]
    assert all(label.gap_N == pytest.approx(24.0, rel=0.11) for label in labels if label.kind != "none")


def test_perfect_scores_for_right_answers(cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("blind", "score", cases, write_results(cases, tmp_path / "results", knows=True))
    printed = text_of(capsys, *words, "--out", tmp_path / "report.md")
    assert (tmp_path / "report.md").read_text().strip() == printed.strip()
    got = figures(printed)
    full = ("first", "among the first three", "outside unknown", "pairs (both found)", "true shrink, median")
    assert [got[name] for name in full] == ["100.0 %"] * 5
    assert [got[name] for name in ("named wrong", "false alarms")] == ["0.0 %"] * 2
    assert got["abs(claimed − true shrink), median"] == got["calibration error"] == "0.000"
    assert "not met" not in printed
    document = json.loads(text_of(capsys, *words, "--json"))
    shares = {row["figure"]: row["value"] for row in document["modes"]["run_2"]["figures"]}
    assert document["schema"] == "ces-blind-score/1"
    assert [shares[name] for name in full] == [1.0] * 5 and shares["calibration error"] == pytest.approx(0.0)


def test_zero_scores_for_wrong_answers(cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    got = figures(text_of(capsys, "blind", "score", cases, write_results(cases, tmp_path / "results", knows=False)))
    none = ("first", "among the first three", "outside unknown", "pairs (both found)", "true shrink, median")
    assert [got[name] for name in none] == ["0.0 %"] * 5
    assert [got[name] for name in ("named wrong", "false alarms")] == ["100.0 %"] * 2
    assert got["abs(claimed − true shrink), median"] == "0.900"
    assert got["calibration error"] == "1.000"


def test_a_recording_teaches_a_plant_and_a_case_may_name_a_function(
    cases: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = cases / "cases" / "0001" / "reference" / "f1"
    words = ("--out", tmp_path / "own", "--seed", 5, "--cases", 1, "--seconds", 3, "--jobs", 1, "--kind", "effect")
    words += ("--plants", "bouc_wen", "--recording", bag, "--effects", "force_offset", "--simulation-error", 0)
    assert ces("blind", "make", *words) == 0
    sealed = open_seal(tmp_path / "own")
    assert sealed.about["plants"] == ["bouc_wen", "map"] and sealed.labels[0].plant in sealed.about["plants"]
    described = tmp_path / "own" / "cases" / "0001" / "case.json"
    path = str(described.with_name("baseline.yaml"))
    own = f"from ces_rig.experiments.virtual import load_rig\n\nforce = load_rig({path!r})\n"
    (tmp_path / "my_damper.py").write_text(own)
    monkeypatch.syspath_prepend(tmp_path)
    described.write_text(json.dumps({**json.loads(described.read_text()), "simulation": "my_damper:force"}))
    assert ces("blind", "run", tmp_path / "own", "--out", tmp_path / "results", "--jobs", 1) == 0
    gap = json.loads((tmp_path / "results" / "run_2" / "0001" / GAP).read_text())
    assert gap["simulation"] == "my_damper:force"
    described.write_text(json.dumps({**json.loads(described.read_text()), "reference": []}))
    assert ces("blind", "run", tmp_path / "own", "--out", tmp_path / "few", "--jobs", 1) == 2
    row = json.loads((tmp_path / "few" / "run_2" / "0001" / ROW).read_text())
    assert "0001: has 0 references; expected 2 for run_2" in row["reason"]


def test_the_diagnosis_itself(cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One case from the recordings alone, with a model in place of the simulation; a second run has nothing to do."""
    blind, results = tmp_path / "blind", tmp_path / "results"
    shutil.copytree(cases / "cases", blind / "cases")
    words = ("blind", "run", blind, "--out", results, "--limit", 1, "--jobs", 1)
    words += ("--simulation", "identified", "--references", 0, 1)  # the first is impossible
    assert ces(*words) == 0
    made = results / "identified_1" / "0001"
    assert {path.name for path in made.iterdir()} == {GAP, AUGMENTED, DECISION, REPLAY, ROW, MODEL}
    assert json.loads((made / GAP).read_text())["simulation"].endswith(MODEL)
    before = (made / ROW).stat().st_mtime_ns
    document = json.loads(text_of(capsys, *words, "--json"))
    assert (document["modes"], document["diagnoses"], document["failed"]) == (["identified_1"], 1, [])
    assert (made / ROW).stat().st_mtime_ns == before
    (blind / "cases" / "seal.sha256").write_text("another")
    assert "identified_1: holds results of other cases; choose another folder" in error_line(capsys, *words)
    printed = text_of(capsys, "blind", "score", cases, results)
    assert f"1 of {CASES} sealed cases" in printed and "|identified_1|1|" in printed


def test_results_of_other_cases_are_refused(cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results = write_results(cases, tmp_path / "results", knows=True)
    (results / "run.json").write_text(json.dumps({**SETTINGS, "seal": "another"}))
    assert "holds results of other cases" in error_line(capsys, "blind", "score", cases, results)
