"""`ces iterate`: a whole run from a plan file with its page; bad plans are one line and status 2."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from ces_cli.main import main
from ces_rig.dampers.stepper import KINDS

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
    assert main(["iterate", str(tmp_path / "plan.yaml")]) == 0
    output = capsys.readouterr().out
    assert "experiment_02: 3.0 s recorded (6.0 s in all); J " in output
    assert "stopped: budget spent" in output
    out = tmp_path / "plan"
    assert {"model.json", "plan.yaml", "report.html", "iterations.jsonl"} <= {path.name for path in out.iterdir()}
    page = ElementTree.parse(out / "report.html")
    names = [e.text for e in page.iter("{http://www.w3.org/1999/xhtml}h3")]
    assert names == ["experiment 02", "experiment 01"]
    assert main(["iterate", str(tmp_path / "plan.yaml")]) == 0
    assert "experiment_02" not in capsys.readouterr().out  # nothing was left to do
    assert main(["iterate", str(tmp_path / "plan.yaml"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "ces-iterate/1" and document["stopped"].startswith("budget spent")
    second = document["iterations"][1]
    assert f"J {second['fresh_J']:.2f} % on it before it was used, {second['fit_J']:.2f} % after the fit" in output
    (tmp_path / "plan.yaml").write_text(yaml.safe_dump(PLAN | {"seed": 7}))
    assert main(["iterate", str(tmp_path / "plan.yaml")]) == 2
    assert "began with another 'seed'" in capsys.readouterr().err
