"""A certified model on a stroke beyond its data: its force is held at its envelope, and the programs say so."""

import numpy as np
import pytest
from model_examples import make_model
from programs import ces, document_of
from small_recordings import write_columns

from ces_observer.structures.terms import Factor, Term

TERMS = (Term(0.9, (Factor("force", 1),)), Term(150.0, (Factor("speed", 0, 1.0),)))
TELLS = "warning: servo: the force was held at its envelope (-100 to 120 N) for "


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Work where `servo` is a bag whose stroke is four times as long after 4 s, with the model `m.json`."""
    monkeypatch.chdir(tmp_path)
    t = np.arange(8000) / 1000.0
    x = np.where(t < 4.0, 0.003, 0.012) * np.sin(2 * np.pi * 3.0 * t)
    force = 1500.0 * np.gradient(x, t) + np.random.default_rng(1).normal(0.0, 1.0, len(t))
    write_columns(tmp_path / "servo", t, {"position": x, "current": np.full(len(t), 0.5), "force": force})
    model = make_model(TERMS, force_envelope_N=(-100.0, 120.0))
    assert model.certify().holds and model.certify().drive_N > 120.0
    model.save("m.json")


def warning_of(capsys):
    """Return the share of the time [%] of the one line that tells of a held force, and the text behind it."""
    (line,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith(TELLS))
    share, rest = line.removeprefix(TELLS).split(" % ", 1)
    assert rest == "of the time, first at 4.00 s: the model does not fit this recording"
    return float(share)


def test_simulate_writes_every_force_and_says_how_long_it_was_held(capsys):
    assert ces("simulate", "--sim", "m.json", "servo", "--out", "f.csv") == 0
    share = warning_of(capsys)
    force = np.genfromtxt("f.csv", delimiter=",", names=True)["force_N"]
    known = force[500:]  # after the warm-up
    assert np.isfinite(known).all() and (known.min(), known.max()) == (-100.0, 120.0)
    held = np.isin(known, (-100.0, 120.0))
    assert share == pytest.approx(100.0 * held.mean(), abs=0.1) and 20.0 < share < 60.0
    document = document_of(capsys, "simulate", "--sim", "m.json", "servo", "--out", "f.csv", "--overwrite")
    assert (document["rows_held"], document["rows_without_force"]) == (held.sum(), np.isnan(force).sum())
    assert ces("replay", "m.json", "servo", "--out", "replayed") == 0
    assert warning_of(capsys) == share


def test_validate_counts_the_held_ticks_in_j_and_in_the_table(capsys):
    assert ces("validate", "m.json", "servo") == 0
    out, err = capsys.readouterr()
    (line,) = (line for line in err.splitlines() if line.startswith(TELLS))
    (row,) = (row.split() for row in out.splitlines() if row.split()[:2] == ["servo", "test"])
    (document,) = document_of(capsys, "validate", "m.json", "servo")["recordings"]
    assert 20.0 < document["J_percent"] < 80.0 and f"{document['J_percent']:.2f}" in row
    assert f"{100.0 * document['force_held']:.3g} % of the time" in line
    assert f"{100.0 * document['outside_envelope']:.1f}" == row[-1]
    assert document["outside_envelope"] >= document["force_held"] > 0.2
