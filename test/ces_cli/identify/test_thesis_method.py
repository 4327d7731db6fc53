"""`ces identify --method thesis`: its candidates, and what the programs say of a model that cannot be proved stable."""

from pathlib import Path

import pytest
from programs import ces

from ces_observer.model import load_model

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.slow
NOISE, PUBLISHED = ROOT / "bags" / "noise", ROOT / "config" / "thesis" / "noise.yaml"


def identify(*words):
    limits = ("--starts", "1", "--threads", "1", "--time", "20")
    return ces("identify", NOISE, "--method", "thesis", *limits, *words)


def test_its_own_candidates_are_the_default_and_their_number_is_recorded(tmp_path):
    out = tmp_path / "model.json"
    assert identify("--out", out, "--terms", 3, "--target", 60) == 0
    selection = load_model(out).provenance["selection"]
    assert (selection["candidates"], selection["ended"]) == (1815, "target cost reached")


@pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")
def test_an_unproved_model_is_written_and_said_to_be_unproved(tmp_path, capsys):
    out = tmp_path / "model.json"
    assert identify("--candidates", PUBLISHED, "--out", out) == 0
    printed = capsys.readouterr()
    assert "stable:" not in printed.out
    lines = [line for line in printed.err.splitlines() if "not proved stable" in line]
    assert len(lines) == 1
    assert "the gains of the past forces may sum to" in lines[0]
    assert "the observer will refuse this model unless allow_uncertified is true" in lines[0]
    assert load_model(out).certificate is None
    assert ces("validate", out, "--certificate") == 1
    assert f"not proved: {out}: the gains of the past forces may sum to" in capsys.readouterr().out
