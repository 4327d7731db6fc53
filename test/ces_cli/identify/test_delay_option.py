"""`ces identify --delay`, and the signal that the speed is measured by: what the file says, other programs follow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from programs import NO_SHORT_FITS, ces, document_of, error_line, text_of

from ces_data.bags.reader import read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_data.signals_file import load_signals
from ces_identify.simulations.simulate import sample_force
from ces_observer.model import load_model
from ces_observer.signals import Signals

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")]
SIGNALS = """\
speed: {topic: joint_states, type: sensor_msgs/msg/JointState, field: "velocity[rear_damper]"}
acceleration: {topic: imu, type: sensor_msgs/msg/Imu, field: linear_acceleration.z}
"""
ACCELERATION_ONLY = SIGNALS.splitlines()[1] + "\n"
QUICK = ("--terms=3", "--time=600", "--starts=1", "--threads=1")
START_NS = 10**18


def write_ride(path: Path, signals: Signals, seed: int) -> None:
    """Write a bag of 8 s whose force follows the speed at once; 30 um of noise hide the speed from the position."""
    dice, time = np.random.default_rng(seed), np.arange(8000) * 1e-3
    omegas = 2.0 * np.pi * dice.uniform(1.0, 14.0, (12, 1))
    sizes, angle = 0.06 / omegas, omegas * time + dice.uniform(0.0, 6.0, (12, 1))
    speed = (sizes * omegas * np.cos(angle)).sum(axis=0)
    columns = {
        "position": ("m", (sizes * np.sin(angle)).sum(axis=0) + dice.normal(0.0, 30e-6, len(time))),
        "speed": ("m/s", speed),
        "acceleration": ("m/s2", -(sizes * omegas**2 * np.sin(angle)).sum(axis=0)),
        "current": ("A", 0.5 + 0.2 * np.sin(0.7 * time + seed)),
        "force": ("N", 1500.0 * speed + dice.normal(0.0, 5.0, len(time))),
    }
    stamps = START_NS * seed + np.arange(len(time)) * 1_000_000
    channels = {name: Channel(name, unit, stamps, values) for name, (unit, values) in columns.items()}
    write_bag(path, recording_topics(Recording(path.name, channels), signals))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the working folder: two bags, signals files, and models with and without a delay and without a motion."""
    where = tmp_path_factory.mktemp("bags")
    (where / "all.yaml").write_text(SIGNALS)
    (where / "acceleration.yaml").write_text(ACCELERATION_ONLY)
    (where / "none.yaml").write_text("position: {scale: 1.0}\n")
    for seed, name in enumerate(("one", "road"), 1):
        write_ride(where / name, load_signals(where / "all.yaml"), seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(where)
        patch.setattr(*NO_SHORT_FITS)
        words = ("one", "--validate", "road", "--signals", "none.yaml", *QUICK)
        assert ces("identify", *words, "--out", "now.json") == 0
        assert ces("identify", *words, "--report", "late.html", "--out", "late.json", "--delay", 0.003) == 0
        yield where


@pytest.mark.parametrize(("signals", "motion"), [("all", "speed"), ("acceleration", "acceleration"), ("none", "")])
def test_the_model_says_where_its_speed_comes_from_and_replay_follows(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, signals: str, motion: str
) -> None:
    monkeypatch.setattr(*NO_SHORT_FITS)
    words = (folder / "one", "--signals", folder / f"{signals}.yaml")
    assert ces("identify", *words, "--out", tmp_path / "m.json", *QUICK) == 0
    model = load_model(tmp_path / "m.json")
    assert model.sampling.motion == motion
    assert all(row["J"] < 12.0 for row in model.provenance["cost_J_percent"])
    assert ces("replay", tmp_path / "m.json", *words, "--out", tmp_path / "replayed") == 0
    expected = sample_force(model, read_recording(folder / "one", load_signals(folder / f"{signals}.yaml")))
    estimate = {"topic": "/observer/estimate", "type": "sensor_msgs/msg/JointState", "field": "effort[0]"}
    replayed = read_recording(
        tmp_path / "replayed", Signals.from_mapping({"sim_force": estimate}, "test"), ["sim_force"]
    ).channel("sim_force")
    np.testing.assert_allclose(replayed.values, expected[np.isfinite(expected)], rtol=1e-9, atol=1e-9)


def test_with_a_delay_the_speed_is_known_better(folder: Path) -> None:
    now, late = (load_model(folder / f"{name}.json") for name in ("now", "late"))
    assert late.sampling == replace(now.sampling, delay_s=0.003) and late.certificate is not None
    costs = [{row["recording"]: row["J"] for row in one.provenance["cost_J_percent"]} for one in (now, late)]
    assert all(costs[1][name] < 0.75 * costs[0][name] for name in ("one", "road"))
    page = (folder / "late.html").read_text(encoding="utf-8")
    assert f"Validation, 3 ms later: cost J = {costs[1]['road']:.3g} % (road)" in page and "<dt>Delay</dt>" in page


def test_validate_and_compare_name_the_delay(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("validate", "late.json", "road", "--certificate", "--signals", "none.yaml")
    document, text = document_of(capsys, *words), text_of(capsys, *words)
    (stored,) = [
        row["J"] for row in load_model(folder / "late.json").provenance["cost_J_percent"] if row["recording"] == "road"
    ]
    assert [row["J_percent"] for row in document["recordings"]] == pytest.approx([stored], abs=1e-4)
    assert document["certificate"]["proved"] and document["model"]["delay_s"] == 0.003
    assert "terms (3 ms later)" in text
    files = ("now.json", "late.json", "road", "--signals", "none.yaml")
    compared = document_of(capsys, "compare", *files)
    assert [(m["name"], m["delay_s"]) for m in compared["models"]] == [("now", 0.0), ("late", 0.003)]
    assert ces("compare", *files, "--report", tmp_path / "c.html") == 0
    assert "Delay [ms]" in (tmp_path / "c.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--delay 0.0105", "--delay 0.0105: expected whole ticks of 0.001 s (the model's rate is 1000 Hz)"),
        ("--delay 0.021", "argument --delay: found '0.021'; expected a number from 0 to 0.02 s"),
    ],
)
def test_mistakes_end_with_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str, message: str
) -> None:
    line = error_line(capsys, "identify", "one", "--out", tmp_path / "m.json", *QUICK, *words.split())
    assert message in line and not (tmp_path / "m.json").exists()
