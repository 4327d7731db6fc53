"""The programs from end to end on small bags: what one writes, the others read, and their numbers agree."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from programs import NO_SHORT_FITS, ces, text_of
from shared_results import SharedResults
from small_recordings import make_columns, write_columns

from ces_cli.main import PROGRAMS
from ces_data.bags.reader import read_recording
from ces_identify.prepare.series import prepare
from ces_identify.validation.evaluate import VALIDATION, evaluate
from ces_observer.model import load_model
from ces_observer.signals import Signals


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
    printed = text_of(capsys, "validate", "model.json", "two", "--report", "v.html")
    assert f"{expected:.2f}" in printed
    assert "band %" in printed and "meant to hold 90 % of the measured forces" in printed
    share = float(next(line for line in printed.splitlines() if "test" in line and "two" in line).split()[-1])
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
