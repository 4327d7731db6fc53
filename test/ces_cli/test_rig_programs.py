"""`ces rig` writes what the virtual rig's sensors log, `ces iterate` a model and a page."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from ces_cli.main import main as ces
from ces_cli.rig import main
from ces_cli.terminal.terminal import run as run_program
from ces_data.bags.reader import read_recording
from ces_data.signals_file import load_signals
from ces_rig.dampers.stepper import KINDS
from ces_rig.experiments.virtual import load_experiment, run

SHORT = """\
duration_s: 1.0
stroke: {kind: sine, amplitude_m: 0.01, frequency_Hz: 4}
current: {kind: stroke_following}
"""


@pytest.fixture
def experiment(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return path


def test_the_bag_holds_the_run(experiment, tmp_path, capsys):
    bag = tmp_path / "bag"
    assert main([str(experiment), "--out", str(bag)]) == 0
    assert "1000 position, 501 current, 1000 force samples" in capsys.readouterr().out
    read, expected = read_recording(bag, load_signals()), run(load_experiment(experiment))
    for name in ("position", "current", "force"):
        assert np.array_equal(read.channel(name).values, expected.channel(name).values)
        assert np.array_equal(read.channel(name).stamps_ns, expected.channel(name).stamps_ns)


def test_seed_and_overwrite(experiment, tmp_path):
    bag = str(tmp_path / "bag")
    main([str(experiment), "--out", bag])
    assert run_program("rig", main, [str(experiment), "--out", bag]) == 2
    first = read_recording(tmp_path / "bag", load_signals()).channel("force").values
    assert main([str(experiment), "--out", bag, "--overwrite", "--seed", "9"]) == 0
    assert not np.array_equal(read_recording(tmp_path / "bag", load_signals()).channel("force").values, first)


def test_signals_file_sets_the_topics(experiment, tmp_path):
    signals = tmp_path / "signals.yaml"
    signals.write_text(
        "current: {topic: amps, type: std_msgs/msg/Float32, field: data, scale: 0.001}\n"
        "position: {topic: pot, type: std_msgs/msg/Float64, field: data, scale: -1.0, offset: 0.1}\n"
    )
    main([str(experiment), "--out", str(tmp_path / "bag"), "--signals", str(signals)])
    read, expected = read_recording(tmp_path / "bag", load_signals(signals)), run(load_experiment(experiment))
    assert read.channel("current").values == pytest.approx(expected.channel("current").values, abs=1e-6)
    assert read.channel("position").values == pytest.approx(expected.channel("position").values, abs=1e-12)


PLAN = {
    "limits": {"stroke_m": 0.02, "speed_m_s": 0.7, "acceleration_m_s2": 60, "low_A": 0.2, "high_A": 1.6},
    "rig": {"kind": "virtual", "damper": "damper.yaml"},
    "experiments": {"duration_s": 3},
    "stop": {"budget_s": 6},
    "identify": {"structure": "polynomial", "terms": 4, "starts": 1, "threads": 1},
}


@pytest.mark.slow
def test_a_plan_gives_a_model_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "damper.yaml").write_text(yaml.safe_dump(KINDS["bouc_wen"].design.description()))
    (tmp_path / "plan.yaml").write_text(yaml.safe_dump(PLAN))
    assert ces(["iterate", str(tmp_path / "plan.yaml")]) == 0
    output = capsys.readouterr().out
    assert "experiment_02: 3.0 s recorded (6.0 s in all); J " in output
    assert "stopped: budget spent" in output
    out = tmp_path / "plan"
    assert {"model.json", "plan.yaml", "report.html", "iterations.jsonl"} <= {path.name for path in out.iterdir()}
    page = ElementTree.parse(out / "report.html")
    names = [e.text for e in page.iter("{http://www.w3.org/1999/xhtml}h3")]
    assert names == ["experiment 02", "experiment 01"]
    assert ces(["iterate", str(tmp_path / "plan.yaml")]) == 0
    assert "experiment_02" not in capsys.readouterr().out  # nothing was left to do
    assert ces(["iterate", str(tmp_path / "plan.yaml"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "ces-iterate/1" and document["stopped"].startswith("budget spent")
    second = document["iterations"][1]
    assert f"J {second['fresh_J']:.2f} % on it before it was used, {second['fit_J']:.2f} % after the fit" in output
    (tmp_path / "plan.yaml").write_text(yaml.safe_dump(PLAN | {"seed": 7}))
    assert ces(["iterate", str(tmp_path / "plan.yaml")]) == 2
    assert "began with another 'seed'" in capsys.readouterr().err
