"""`ces identify --method thesis`: its candidates, and what the programs say of a model that cannot be proved stable."""

from pathlib import Path

import pytest
from programs import ces, error_line, text_of

from ces_identify.polynomial.candidates import built_in_rules
from ces_observer.model import load_model

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.slow
NOISE, PUBLISHED = ROOT / "bags" / "noise", ROOT / "config" / "thesis" / "noise.yaml"


def identify(*words):
    limits = ("--starts", "1", "--threads", "1", "--time", "20")
    return ces("identify", NOISE, "--method", "thesis", *limits, *words)


def test_its_candidates_are_shown(capsys):
    first, _, rules = text_of(capsys, "identify", "--method", "thesis", "--show-candidates").partition("\n")
    assert first.endswith("candidates.json") and rules == built_in_rules("thesis")


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


def test_a_model_with_a_certificate_says_so(tmp_path, capsys):
    """A past force alone decays slowly and can be proved stable."""
    rules = tmp_path / "rules.yaml"
    rules.write_text("initial: [[{signal: force, lag: 1}], [{signal: speed}]]\n")
    assert identify("--candidates", rules, "--out", tmp_path / "model.json") == 0
    assert "stable: contraction" in capsys.readouterr().out
    assert load_model(tmp_path / "model.json").certificate["gain"] < 1.0


def test_initial_terms_that_diverge_are_refused_in_one_line(tmp_path, capsys):
    sweep = ROOT / "config" / "thesis" / "sweep.yaml"
    words = ("identify", ROOT / "bags" / "sweep", "--method", "thesis", "--candidates", sweep)
    error = error_line(capsys, *words, "--out", tmp_path / "model.json")
    assert error.startswith("ces identify: error: no model below 100 %: the free run of the initial model diverges")
    assert not (tmp_path / "model.json").exists()
