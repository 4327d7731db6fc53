"""`ces compare` from end to end: tables, JSON, page, training data, and mistakes."""

import json
import shutil
from pathlib import Path

import programs
import pytest
from browser import find_faults, open_page

from ces_data.reading import read_recording
from ces_gap.augmented import save_augmented
from ces_gap.effects.effect import Composition
from ces_observer.model import load_model

ROOT = Path(__file__).parents[2]
SAMPLE, ROAD, SINE = ROOT / "config/models/sample.json", ROOT / "bags/road", ROOT / "bags/sine_4hz"


def ces(*words):
    return programs.ces("compare", *words)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two equal models in files of the same name, the second without provenance, and a function."""
    folder = tmp_path_factory.mktemp("compare")
    for name in ("ours", "theirs"):
        (folder / name).mkdir()
    shutil.copy(SAMPLE, folder / "ours/model.json")
    text = json.loads(SAMPLE.read_text())
    text["provenance"] = {}
    (folder / "theirs/model.json").write_text(json.dumps(text))
    (folder / "rig_like.py").write_text(
        "import numpy as np\ndef force(t, x, i):\n    return 2000.0 * np.gradient(x, t) * (0.5 + i)\n"
    )
    return folder


@pytest.fixture(scope="module")
def compared(folder):
    """The page of three simulations on two recordings."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        words = ("ours/model.json", "theirs/model.json", "rig_like:force", ROAD, SINE)
        assert ces(*words, "--report", "page.html") == 0
    return folder / "page.html"


def test_tables(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert ces("ours/model.json", ROAD, "rig_like:force", SINE) == 0  # in any order
    shown = capsys.readouterr().out
    assert "model is better than rig_like:force" in shown
    assert "identified on" in shown and "model was identified on road; its cost there is not a test" in shown
    assert "no file says what rig_like:force was identified on" in shown


def test_json_holds_the_numbers_of_validate(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert ces("ours/model.json", "theirs/model.json", SINE, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "ces-compare/1"
    assert [model["name"] for model in document["models"]] == ["ours/model", "theirs/model"]
    first, second = (model["costs"][0] for model in document["models"])
    recorded = next(
        row["J"] for row in load_model(SAMPLE).provenance["cost_J_percent"] if row["recording"] == "sine_4hz"
    )
    assert first["J_percent"] == pytest.approx(recorded, abs=0.05)
    assert (first["use"], second["use"]) == ("test", "not known")
    (pair,) = document["pairs"]
    assert pair["verdict"] == "cannot be told apart" and pair["better"] is None
    assert pair["pooled"]["first_minus_second_percent"] == 0.0


def test_a_comparison_on_training_data_has_no_verdict(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert ces("ours/model.json", "rig_like:force", ROAD, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["test_recordings"] == []
    assert document["pairs"][0]["verdict"] == "not a test" and document["pairs"][0]["p_value"] is None
    assert ces("ours/model.json", "rig_like:force", ROAD) == 0
    shown = capsys.readouterr().out
    assert "no test: model or rig_like:force was identified on each recording." in shown
    assert "is better" not in shown


def test_recordings_of_a_diagnosis_are_no_test_for_its_simulation(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    rows = [{"recording": "sine_4hz", "sha256": read_recording(SINE).sha256}]
    save_augmented(folder / "augmented.json", "ours/model.json", Composition(()), provenance={"real": rows})
    assert ces("augmented.json", "ours/model.json", SINE, ROAD, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    uses = [[cost["use"] for cost in model["costs"]] for model in document["models"]]
    assert uses == [["identified on", "identified on"], ["test", "identified on"]]
    assert document["pairs"][0]["verdict"] == "not a test"


def test_the_page_names_everything(compared):
    text = compared.read_text(encoding="utf-8")
    for word in ("ours/model", "theirs/model", "rig_like:force", "identified on road; its cost there is not a test"):
        assert word in text
    assert len(text) < 3_000_000


@pytest.mark.slow
def test_the_page_is_legible_on_screen_in_print_and_by_keys(compared):
    assert find_faults(compared) == []


@pytest.mark.slow
def test_the_page_reads_forces(compared):
    with open_page(compared) as page:
        assert page.locator("#costs .models tbody tr").count() == 3
        frame = page.locator("#time0-plot .plot-frame")
        frame.hover()
        assert "ours/model" in page.locator("#time0-plot .plot-readout").inner_text()
