"""`ces learn-stroke`: from a plan to command, page and result; mistakes in one line."""

import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from mistaken_files import STROKE

from ces_cli.main import main
from ces_rig.drive.sequences import read_stroke_file
from ces_rig.experiment import load_experiment, simulate_truth

EXPERIMENT = """\
duration_s: 2.5
stroke: {kind: sine, amplitude_m: 0.01, frequency_Hz: 4}
current: {kind: constant, current_A: 0.5}
"""


def write_plan(folder, plan=STROKE, experiment=EXPERIMENT):
    (folder / "sine.yaml").write_text(experiment)
    (folder / "plan.yaml").write_text(plan)
    return str(folder / "plan.yaml")


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("learned")
    assert main(["learn-stroke", write_plan(folder), "--out", str(folder / "out")]) == 0
    return folder


def read_result(folder):
    return json.loads((folder / "out" / "result.json").read_text())


def test_the_result_says_what_was_reached(learned):
    result = read_result(learned)
    assert result["schema"] == "ces-learned-stroke/1"
    assert result["confirmed_error_m"] < 0.1 * result["first_error_m"]
    assert [run["kind"] for run in result["runs"]][:3] == ["first", "first", "learned"]
    assert result["runs"][-1]["kind"] == "repeated" and result["iterations"] <= 3
    assert 0.0 < result["filter"]["max_contraction"] < 1.0
    assert all(row["highest"] <= row["limit"] for row in result["limits"].values())


def test_the_page_is_well_formed_and_shows_all_figures(learned):
    text = (learned / "out" / "report.html").read_text()
    page = ElementTree.fromstring(text.removeprefix("<!DOCTYPE html>"))
    names = {
        node.findtext("{http://www.w3.org/2000/svg}title") for node in page.iter("{http://www.w3.org/2000/svg}svg")
    }
    assert names - {None} == {"Error over the runs", "Tracking before and after learning", "Condition of convergence"}
    shown = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert "nan" not in shown.lower().replace("repeatability", "")


def test_the_learned_experiment_runs_on_the_rig(learned):
    truth = simulate_truth(load_experiment(learned / "out" / "learned.yaml"))
    wanted = load_experiment(learned / "sine.yaml").stroke.samples(truth.time_s, np.random.default_rng(0))
    assert np.sqrt(np.mean((truth.stroke_m - wanted) ** 2)) < 60e-6
    _, command = read_stroke_file(learned / "out" / "command.csv")
    assert np.abs(command - wanted[::2]).max() > 1e-3


def test_the_document_is_that_of_the_result_file(learned, capsys):
    command = ["learn-stroke", str(learned / "plan.yaml"), "--out", str(learned / "out"), "--json"]
    assert main(command) == 2
    assert "result.json: exists; choose another --out" in capsys.readouterr().err
    (learned / "out" / "runs" / "run_01" / "log").mkdir(parents=True)
    assert main([*command, "--overwrite"]) == 0
    assert not (learned / "out" / "runs" / "run_01").exists()
    printed = capsys.readouterr()
    document, result = json.loads(printed.out), read_result(learned)
    assert document.pop("schema") == "ces-learn-stroke/1" and result.pop("schema")
    assert {key: document[key] for key in result} == result
    assert printed.err.count("µm RMS") == len(result["runs"])
