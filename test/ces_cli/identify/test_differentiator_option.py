"""`ces identify --differentiator`: the recorded signals choose, the option overrides, and replay follows the model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from programs import NO_SHORT_FITS, ces, error_line

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
QUICK = ("--terms=3", "--time=600", "--starts=1", "--threads=1", "--method=gauss-newton")
START_NS = 10**18


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a bag of 8 s, in which the force follows the measured speed, and signals files."""
    where, dice = tmp_path_factory.mktemp("bags"), np.random.default_rng(1)
    time = np.arange(8000) * 1e-3
    omegas, phases = 2.0 * np.pi * np.array([[1.1], [2.7], [5.9]]), np.array([[0.0], [1.0], [2.0]])
    sizes, angle = np.array([[0.02], [0.008], [0.003]]), 2.0 * np.pi * np.array([[1.1], [2.7], [5.9]]) * time + phases
    speed = (sizes * omegas * np.cos(angle)).sum(axis=0)
    columns = {
        "position": ("m", (sizes * np.sin(angle)).sum(axis=0) + dice.normal(0.0, 15e-6, len(time))),
        "speed": ("m/s", speed),
        "acceleration": ("m/s2", -(sizes * omegas**2 * np.sin(angle)).sum(axis=0)),
        "current": ("A", 0.5 + 0.2 * np.sin(0.7 * time)),
        "force": ("N", 1500.0 * speed + dice.normal(0.0, 5.0, len(time))),
    }
    stamps = START_NS + np.arange(len(time)) * 1_000_000
    channels = {name: Channel(name, unit, stamps, values) for name, (unit, values) in columns.items()}
    (where / "all.yaml").write_text(SIGNALS)
    (where / "acceleration.yaml").write_text(ACCELERATION_ONLY)
    (where / "none.yaml").write_text("position: {scale: 1.0}\n")
    signals: Signals = load_signals(where / "all.yaml")
    write_bag(where / "bag", recording_topics(Recording("bag", channels), signals))
    return where


@pytest.mark.parametrize(
    ("signals", "option", "kind"),
    [
        ("all.yaml", "auto", "measured"),
        ("acceleration.yaml", "auto", "fused"),
        ("none.yaml", "auto", "kalman"),
        ("none.yaml", "adaptive", "adaptive"),
    ],
)
def test_the_model_says_where_its_speed_comes_from_and_replay_follows(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, signals: str, option: str, kind: str
) -> None:
    monkeypatch.setattr(*NO_SHORT_FITS)
    words = (folder / "bag", "--signals", folder / signals)
    assert ces("identify", *words, "--out", tmp_path / "m.json", *QUICK, "--differentiator", option) == 0
    model = load_model(tmp_path / "m.json")
    assert model.sampling.differentiator == kind
    assert all(row["J"] < 6.0 for row in model.provenance["cost_J_percent"])
    assert ces("replay", tmp_path / "m.json", *words, "--out", tmp_path / "replayed") == 0
    expected = sample_force(model, read_recording(folder / "bag", load_signals(folder / signals)))
    estimate = {"topic": "/observer/estimate", "type": "sensor_msgs/msg/JointState", "field": "effort[0]"}
    replayed = read_recording(
        tmp_path / "replayed", Signals.from_mapping({"sim_force": estimate}, "test"), ["sim_force"]
    ).channel("sim_force")
    np.testing.assert_allclose(replayed.values, expected[np.isfinite(expected)], rtol=1e-9, atol=1e-9)


def test_a_signal_that_was_not_recorded_ends_with_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (folder / "bag", "--signals", folder / "none.yaml", "--out", tmp_path / "m.json", *QUICK)
    line = error_line(capsys, "identify", *words, "--differentiator", "measured")
    assert "bag: no 'speed' channel, which the differentiator 'measured' needs; describe 'speed'" in line
