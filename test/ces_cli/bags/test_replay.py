"""A replay of models with a delay: their estimates have topics of their own, with the stamps of their samples."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bands import BAND, lower_bounds
from damper_models import delayed_damper
from programs import ces, document_of
from small_recordings import write_columns

from ces_data.bags.reader import read_recording
from ces_data.recording import Channel
from ces_identify.simulations.simulate import sample_run
from ces_observer.signals import Signals

JOINT = "rear_damper"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    t = np.arange(3000) / 1000.0
    x = 0.02 * np.sin(4.0 * np.pi * t)
    write_columns(tmp_path / "one", t, {"position": x, "current": np.full(len(t), 0.5), "force": np.zeros(len(t))})


def read(topic: str, field: str) -> Channel:
    described = {"topic": topic, "type": "sensor_msgs/msg/JointState", "field": field}
    return read_recording(Path("out"), Signals.from_mapping({"sim_force": described}, "test")).channel("sim_force")


def test_the_delayed_estimates_are_the_batchs(capsys: pytest.CaptureFixture[str]) -> None:
    model = replace(delayed_damper(0.003), band=BAND)
    model.save("m.json")
    document = document_of(capsys, "replay", "m.json", "one", "--out", "out")
    recording = read_recording(Path("one"), Signals.from_mapping({}, "test"))
    run = sample_run(model, recording)
    known = np.isfinite(run.force)
    stamps = recording.channel("position").stamps_ns
    for values, topic, field in (
        (run.force, "/observer/estimate_delayed", f"effort[{JOINT}]"),
        (lower_bounds(run), "/observer/estimate_delayed_band", f"effort[{JOINT}_lower]"),
    ):
        found = read(topic, field)
        np.testing.assert_array_equal(found.stamps_ns, stamps[known])
        np.testing.assert_allclose(found.values, values[known], rtol=1e-9, atol=1e-9)
    assert document["estimates"] == known.sum() == 3000 - 100 - 3
    assert document["delay_s"] == 0.003
    assert ces("replay", "m.json", "one", "--out", "out", "--overwrite") == 0
    lines = capsys.readouterr().out.splitlines()
    assert "2897 forces estimated 3 ms late from 3000 position samples" in lines
