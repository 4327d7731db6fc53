"""What programs promise together: the same costs and forces, bands, held forces, functions as simulations."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from model_examples import make_model
from numpy.typing import NDArray
from programs import NO_SHORT_FITS, ces, document_of, text_of
from shared_results import SharedResults
from small_recordings import make_columns, write_columns

from ces_cli.main import PROGRAMS
from ces_data.bags.reader import read_recording
from ces_identify.prepare.series import prepare
from ces_identify.validation.evaluate import VALIDATION, evaluate
from ces_observer.model import load_model
from ces_observer.signals import Signals
from ces_observer.structures.polynomial import Factor, Term
from ces_report.typesetting import format_within


@pytest.fixture(scope="module")
def work(shared_model: SharedResults, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A working folder with the bags `one` and `two`, and the model of the first."""
    folder = tmp_path_factory.mktemp("work")
    for name in ("one", "two", "model.json", "report.html", "rules.yaml"):
        (folder / name).symlink_to(shared_model.folder / name)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        patch.setattr(*NO_SHORT_FITS)
        yield folder


def forces_in(table: str, column: str = "force_N") -> NDArray[np.float64]:
    return np.array([float(row[column]) for row in csv.DictReader(Path(table).open())])


def read_effort(bag: str, topic: str, joint: str) -> NDArray[np.float64]:
    """Return the efforts of a joint in a replayed bag."""
    described = {"topic": topic, "type": "sensor_msgs/msg/JointState", "field": f"effort[{joint}]"}
    return read_recording(Path(bag), Signals.from_mapping({"sim_force": described}, "test")).channel("sim_force").values


@pytest.mark.slow
def test_validate_and_identify_agree_on_the_cost(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = json.loads(Path("model.json").read_text())["provenance"]["cost_J_percent"]
    expected = next(row["J"] for row in rows if row["role"] == "validation")
    (document,) = document_of(capsys, "validate", "model.json", "two")["recordings"]
    assert document["J_percent"] == pytest.approx(expected, abs=1e-4)
    printed = text_of(capsys, "validate", "model.json", "two", "--report", "v.html")
    assert format_within(expected, *document["ci95_percent"])[0] in printed.split()
    assert "band %" in printed and "meant to hold 90 % of the measured forces" in printed
    share = float(next(line for line in printed.splitlines() if "validation" in line and "two" in line).split()[-1])
    model = load_model("model.json")
    series = prepare(read_recording(Path("two"), Signals.from_mapping({}, "defaults")), model.sampling)
    assert share == pytest.approx(100.0 * evaluate(model, [series], VALIDATION)[0].coverage, abs=0.06)
    assert 80.0 < share < 99.0


@pytest.mark.slow
def test_replay_and_simulate_agree(work: Path) -> None:
    assert ces("replay", "model.json", "two", "--out", "replayed") == 0
    assert ces("simulate", "--sim", "model.json", "two", "--out", "two.csv") == 0
    described = {"topic": "/observer/estimate", "type": "sensor_msgs/msg/JointState", "field": "effort[rear_damper]"}
    replayed = read_recording(Path("replayed"), Signals.from_mapping({"sim_force": described}, "test"))
    position, estimate = replayed.channel("position"), replayed.channel("sim_force")
    time_s, force = forces_in("two.csv", "time_s"), forces_in("two.csv")
    assert (len(time_s), time_s[0]) == (len(position), 0.0)
    there = np.isfinite(force)
    np.testing.assert_array_equal(estimate.stamps_ns - position.stamps_ns[0], np.rint(time_s[there] * 1e9))
    np.testing.assert_allclose(estimate.values, force[there], rtol=1e-9, atol=1e-6)
    lower, upper = (read_effort("replayed", "/observer/estimate_band", f"rear_damper_{s}") for s in ("lower", "upper"))
    assert (lower < force[there]).all() and (force[there] < upper).all()
    assert ces("simulate", "--sim", "topic:/observer/estimate", "replayed", "--out", "p.csv") == 0
    assert np.isfinite(forces_in("p.csv")).mean() > 0.9  # predictions in a bag are a simulation


@pytest.mark.slow
def test_a_model_without_a_band_is_used_as_before(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replace(load_model("model.json"), band=None).save("plain.json")
    text = text_of(capsys, "validate", "plain.json", "two", "--report", "n.html")
    assert "band" not in text + text_of(capsys, "replay", "plain.json", "two", "--out", "plain")


@pytest.mark.slow
def test_a_function_is_a_simulation_and_a_teacher(work: Path) -> None:
    Path("passive.py").write_text("def force(time_s, position_m, current_A):\n    return 1e4 * position_m + 1.0\n")
    assert ces("simulate", "--sim", "passive:force", "one", "--out", "f.csv") == 0
    Path("spring.yaml").write_text("position: {lags: [0], powers: [1]}\nproducts: [[], [position]]\n")
    words = ("--teacher", "passive:force", "--candidates", "spring.yaml", "--out", "taught.json", "--starts", 1)
    assert ces("identify", "one", *words, "--no-band") == 0
    taught = load_model("taught.json")
    terms = {len(t.factors): t.coefficient for t in taught.body.terms}
    assert terms[1] == pytest.approx(1e4, rel=0.01) and taught.band is None


@pytest.mark.parametrize("name", PROGRAMS)
def test_help_reads_like_a_manual_page(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    printed = text_of(capsys, name, "--help")
    assert printed.startswith(f"usage: ces {name}")
    assert "example" in printed


def test_a_few_bad_samples_are_left_out_with_a_warning(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t, columns = make_columns(8.0, 1, 250.0)
    columns["position"][700] = np.inf
    write_columns(work / "spoiled", t, columns)
    assert ces("validate", "model.json", "spoiled") == 0
    assert "warning: spoiled: " in capsys.readouterr().err


TERMS = (Term(0.9, (Factor("force", 1),)), Term(150.0, (Factor("speed", 0, 1.0),)))
TELLS = "warning: servo: the force was held at its envelope (-100 to 120 N) for "


@pytest.fixture
def servo(tmp_path, monkeypatch):
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


@pytest.mark.usefixtures("servo")
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
    assert ces("simulate", "--sim", "m.json", "servo", "--part", "3", "5", "--out", "part.csv") == 0
    part = np.genfromtxt("part.csv", delimiter=",", names=True)["force_N"]
    np.testing.assert_allclose(part[1600:], force[4600:5000], atol=1.0)


@pytest.mark.usefixtures("servo")
def test_validate_counts_the_held_ticks_in_j_and_in_the_table(capsys):
    assert ces("validate", "m.json", "servo") == 0
    out, err = capsys.readouterr()
    (line,) = (line for line in err.splitlines() if line.startswith(TELLS))
    (row,) = (row.split() for row in out.splitlines() if row.split()[:2] == ["servo", "validation"])
    (document,) = document_of(capsys, "validate", "m.json", "servo")["recordings"]
    assert 20.0 < document["J_percent"] < 80.0
    assert format_within(document["J_percent"], *document["ci95_percent"])[0] in row
    assert f"{100.0 * document['force_held']:.3g} % of the time" in line
    assert f"{100.0 * document['outside_envelope']:.1f}" == row[-1]
    assert document["outside_envelope"] >= document["force_held"] > 0.2
