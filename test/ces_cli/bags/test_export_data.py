"""Recordings as tables, and back: what was exported and imported again is the same recording."""

from pathlib import Path

import numpy as np
import pytest

from ces_cli.bags import export_data
from ces_cli.terminal import terminal
from ces_data.bags.reader import read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_data.signals_file import load_signals
from ces_observer.model import load_model

ROOT = Path(__file__).parents[3]
pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")
START = 1_700_000_000_123_456_789
SIGNALS = ("position", "current", "force")


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Position at 1 kHz with jitter, current at 100 Hz, force at 500 Hz with a gap."""
    random = np.random.default_rng(5)
    n = 1500
    fast = START + np.arange(n) * 1_000_000 + random.integers(0, 9000, n)
    t = (fast - START) * 1e-9
    x = 0.02 * np.sin(2 * np.pi * 2 * t)
    slow = START + 333 + np.arange(n // 10) * 10_000_000
    middle = START + 777_777 + np.arange(n // 2) * 2_000_000
    middle = middle[(middle < START + 600_000_000) | (middle > START + 700_000_000)]
    force = 4000 * 0.04 * np.pi * np.cos(2 * np.pi * 2 * (middle - START) * 1e-9) + random.normal(0, 1, len(middle))
    channels = {
        "position": Channel("position", "m", fast, x),
        "current": Channel("current", "A", slow, 0.3 + 0.1 * (np.arange(n // 10) // 25)),
        "force": Channel("force", "N", middle, force),
    }
    path = tmp_path_factory.mktemp("bags") / "run"
    write_bag(path, recording_topics(Recording("run", channels), load_signals()))
    return path


def run(*words):
    return terminal.run("export-data", export_data.main, [str(word) for word in words])


def columns(path):
    names = path.read_text().splitlines()[0].split(",")
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    return dict(zip(names, table.T, strict=True))


def test_the_position_gives_the_rows_and_names_say_what_was_held(bag, tmp_path):
    assert run(bag, "--out", tmp_path / "run.csv") == 0
    table, recording = columns(tmp_path / "run.csv"), read_recording(bag, load_signals())
    assert list(table) == ["stamp_ns", "time_s", "position_m", "current_held_A", "force_interp_N"]
    position, current, force = (recording.channel(name) for name in SIGNALS)
    np.testing.assert_array_equal(table["position_m"], position.values)
    newest = np.searchsorted(current.stamps_ns, position.stamps_ns, side="right") - 1
    held = np.where(newest >= 0, current.values[newest], np.nan)
    np.testing.assert_array_equal(table["current_held_A"], held)
    gap = (table["time_s"] > 0.602) & (table["time_s"] < 0.698)
    assert np.isnan(table["force_interp_N"][gap]).all()
    inside = ~np.isnan(table["force_interp_N"])
    expected = np.interp(position.stamps_ns - START, force.stamps_ns - START, force.values)
    np.testing.assert_allclose(table["force_interp_N"][inside], expected[inside], rtol=1e-9)
    assert inside.mean() > 0.9


def test_parquet_states_units_and_origin(bag, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    assert run(bag, "--out", tmp_path / "run.parquet") == 0
    table = parquet.read_table(tmp_path / "run.parquet")
    units = {field.name: field.metadata[b"unit"].decode() for field in table.schema}
    assert units == {"stamp_ns": "ns", "time_s": "s", "position_m": "m", "current_held_A": "A", "force_interp_N": "N"}
    assert table.schema.metadata[b"recording"] == b"run"
    assert len(table.schema.metadata[b"source_sha256"]) == 64
    assert table.column("force_interp_N").null_count > 40
    assert (
        table.column("stamp_ns").to_numpy()[0] == read_recording(bag, load_signals()).channel("position").stamps_ns[0]
    )


def test_a_model_adds_its_estimates(tmp_path):
    model = ROOT / "config" / "models" / "sample.json"
    recording = read_recording(ROOT / "bags" / "sine_4hz", load_signals())
    part = recording.share(0.0, 0.1)
    write_bag(tmp_path / "short", recording_topics(part, load_signals()))
    assert run(tmp_path / "short", "--model", model, "--out", tmp_path / "short.csv") == 0
    table = columns(tmp_path / "short.csv")
    assert {"estimated_speed_m_s", "estimated_force_N"} < set(table)
    there = ~np.isnan(table["estimated_force_N"])
    assert 0.5 < there.mean() < 1.0  # none while the estimator warms up
    speed = np.gradient(table["position_m"], table["time_s"])
    assert np.corrcoef(speed[there], table["estimated_speed_m_s"][there])[0, 1] > 0.9
    assert ("estimated_force_lower_N" in table) == (load_model(model).band is not None)
