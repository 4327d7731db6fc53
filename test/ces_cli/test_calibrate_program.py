"""`ces calibrate`: a file that is a simulation again, a page, and one line for what is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft7Validator
from pages import assert_self_contained
from programs import ces, document_of, error_line, text_of

from bench.gaps.users_dampers import record
from ces_cli.schema import build_schema
from ces_cli.terminal.inputs import open_simulation
from ces_data.bags.writer import recording_topics, write_bag
from ces_observer.signals import Signals

MODULE = "from bench.gaps.users_dampers import knee as force\n"
TRUE = {"knee_m_s": 0.104, "gas_N_m": 2990.0}


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a user's simulator and three recordings of the true damper."""
    folder = tmp_path_factory.mktemp("calibrated")
    (folder / "own_damper.py").write_text(MODULE)
    for seed in (1, 2, 3):
        topics = recording_topics(record("knee", TRUE, seed, seconds=6.0), Signals.from_mapping({}, "defaults"))
        write_bag(folder / f"bag{seed}", topics)
    return folder


@pytest.fixture(autouse=True)
def _here(work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(work)
    monkeypatch.syspath_prepend(work)


WORDS = ("calibrate", "--sim", "own_damper:force", "--real", "bag1", "bag2", "--held-out", "bag3")


def test_the_result_is_a_simulation_that_carries_the_fitted_values(capsys: pytest.CaptureFixture[str]) -> None:
    printed = text_of(capsys, *WORDS, "--out", "fit")
    assert "knee_m_s is 0.10" in printed and "With both the gap shrinks from " in printed
    document = json.loads(Path("fit/calibrated.json").read_text())
    assert [e.message for e in Draft7Validator(json.loads(build_schema("calibrated"))).iter_errors(document)] == []
    assert document["parameters"]["gas_N_m"]["value"] == pytest.approx(2990.0, rel=0.02)
    assert document["gap"]["after_N"] < 0.2 * document["gap"]["before_N"]
    assert ces("simulate", "--sim", "fit/calibrated.json", "bag3", "--out", "fitted.csv") == 0
    values = {name: fitted["value"] for name, fitted in document["parameters"].items()}
    own = open_simulation("own_damper:force").with_values(values)
    recording = record("knee", TRUE, 3, seconds=6.0)
    forces = np.loadtxt("fitted.csv", delimiter=",", skiprows=1)[:, 1]
    np.testing.assert_allclose(forces, own.force(recording), atol=1e-6)
    page = Path("fit/report.html").read_text()
    assert_self_contained(page)
    assert "Parameters of own_damper:force from bag1" in page and "not determined" not in page
    again = document_of(capsys, "calibrate", "--sim", "fit/calibrated.json", "--real", "bag1", "--out", "again")
    assert again["parameters"]["gas_N_m"]["default"] == values["gas_N_m"]


def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--fit seal: own_damper:force has no such parameter" in error_line(
        capsys, *WORDS, "--fit", "seal", "--out", "x"
    )
    Path("ends.py").write_text("import sys\nsys.exit(1)\n")
    line = error_line(capsys, "calibrate", "--sim", "ends:force", "--real", "bag1", "--out", "x")
    assert "ends:force: cannot be imported (SystemExit: 1)" in line
    ces(*WORDS, "--fit", "gas_N_m", "--out", "old")
    text = Path("old/calibrated.json").read_text()
    Path("old/calibrated.json").write_text(text.replace('"gas_N_m": {', '"gas": {'))
    line = error_line(capsys, "simulate", "--sim", "old/calibrated.json", "bag1", "--out", "x.csv")
    assert "old/calibrated.json: own_damper:force has no parameter gas now" in line
