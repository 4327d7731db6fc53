"""Probabilities fitted to blind cases: the fit finds what separates them, and writes only the modes that were run."""

import json

import numpy as np
import pytest

from bench.gaps import calibrate
from ces_gap.inference.judgement import VerdictFigures
from ces_rig.blind.cases import CaseLabel, WithheldLabel, write_seal

KINDS = ("effect", "effect", "pair", "outside", "none")


def figures(kind, rng):
    """Return figures of a clear case: no energy without a gap, most of it unexplained outside the library."""
    energy = 0.0 if kind == "none" else 8.0 + rng.normal()
    unexplained = 0.6 + 0.1 * rng.normal() if kind == "outside" else 0.05 + 0.01 * rng.normal()
    z = 0.5 if kind == "none" else 15.0
    return VerdictFigures(energy, z, z, unexplained, unexplained, 0).__dict__


@pytest.fixture
def results(tmp_path):
    """Sealed labels of clear cases, and their diagnoses without references."""
    rng, labels = np.random.default_rng(1), []
    out = tmp_path / "results" / "run_0"
    for i in range(100):
        kind = KINDS[i % len(KINDS)]
        names = {"effect": ["friction"], "pair": ["friction", "inertia"], "outside": ["mains_hum"]}.get(kind, [])
        withheld = tuple(map(WithheldLabel, names))
        label = CaseLabel(f"{i:04d}", kind, "calibration", baseline_ratio=0.5 * (i % 2), effects=withheld)
        labels.append(label)
        (out / label.case).mkdir(parents=True)
        causes = [{"effect": "friction", "gain": 0.9}, {"effect": "inertia", "gain": 0.2}]
        (out / label.case / "gap.json").write_text(json.dumps({"causes": causes, "composition": {"effects": names}}))
        (out / label.case / "decision.json").write_text(json.dumps({"figures": figures(kind, rng)}))
    (tmp_path / "cases").mkdir()
    published = write_seal(tmp_path, {"seed": 1}, labels)
    (out / "run.json").write_text(json.dumps({"simulation": "run", "references": 0, "seal": published}))
    return tmp_path, out.parent


def test_only_the_modes_that_were_run_get_new_weights(results, tmp_path, monkeypatch, capsys):
    out, before = tmp_path / "calibration.json", json.loads(calibrate.OUT.read_text())
    out.write_text(json.dumps(before))
    monkeypatch.setattr(calibrate, "OUT", out)
    monkeypatch.setattr("sys.argv", ["calibrate", *map(str, results)])
    calibrate.main()
    after = json.loads(out.read_text())
    assert after.keys() == before.keys()
    assert {name for name in after if after[name] != before[name]} == {"no_references"}
    assert json.loads(capsys.readouterr().out).keys() == {"no_references"}
    weights = after["no_references"]
    assert weights["made_on"].startswith("90 blind cases")  # a wrong simulation alone is a gap or none: both right
    assert weights["sharpness"] > 5.0 and 0.3 <= weights["least_known"] <= 0.8
    assert weights["gap"][1] > 0.0 and weights["unknown"][1] > 0.0
