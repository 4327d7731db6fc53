import os
from pathlib import Path

import numpy as np
import pytest

from ces_cli.bags import import_
from ces_cli.terminal import terminal
from ces_data.bags.reader import read_recording
from ces_data.logs import csv
from ces_data.logs.log_import import import_log
from ces_data.signals_file import load_signals

ROOT = Path(__file__).parents[3]
DATA = Path(os.environ.get("CES_DATA", ROOT.parent / "shared" / "data"))
MAPPING = "rate: 100\nposition: {column: x, scale: 0.001}\ncurrent: {constant: 0.2}\nforce: {column: F}\n"
pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")


@pytest.fixture
def files(tmp_path):
    (tmp_path / "map.yaml").write_text(MAPPING)
    for name, top in (("a", 5), ("b", 7)):
        (tmp_path / f"{name}.csv").write_text("x,F\n" + "".join(f"{i},{-i}\n" for i in range(top)))
    return tmp_path


def run(*words):
    return terminal.run("import", import_.main, [str(word) for word in words])


def errors(capsys):
    return capsys.readouterr().err.splitlines()


def test_one_file_becomes_the_bag_out(files, capsys):
    assert run(files / "a.csv", "--mapping", files / "map.yaml", "--out", files / "deep" / "bag") == 0
    recording = read_recording(files / "deep" / "bag", load_signals())
    np.testing.assert_array_equal(recording.channel("position").values, 0.001 * np.arange(5))
    np.testing.assert_array_equal(recording.channel("current").values, 0.2)
    np.testing.assert_array_equal(recording.channel("force").stamps_ns, np.arange(5) * 10_000_000)
    assert "5 samples of position, current, force at 100.0 Hz" in capsys.readouterr().out


def test_several_files_become_a_bag_each(files):
    assert run(files / "a.csv", files / "b.csv", "--mapping", files / "map.yaml", "--out", files / "bags") == 0
    assert sorted(p.name for p in (files / "bags").iterdir()) == ["a", "b"]
    assert len(read_recording(files / "bags" / "b", load_signals()).channel("position")) == 7


def test_topics_are_those_of_the_signals_file(files):
    (files / "s.yaml").write_text("force: {topic: load, type: std_msgs/msg/Float32, field: data}\n")
    words = ("--mapping", files / "map.yaml", "--out", files / "bag", "--signals", files / "s.yaml")
    assert run(files / "a.csv", *words) == 0
    recording = read_recording(files / "bag", load_signals(files / "s.yaml"))
    np.testing.assert_array_equal(recording.channel("force").values, -np.arange(5.0))


def test_advice_about_a_scale_names_the_mapping(files, capsys):
    (files / "map.yaml").write_text("rate: 100\nposition: {column: x}\ncurrent: {constant: 0.2}\nforce: {column: F}\n")
    assert run(files / "a.csv", "--mapping", files / "map.yaml", "--out", files / "bag") == 0
    warnings = [line for line in errors(capsys) if "mm" in line]
    assert len(warnings) == 1
    assert f"in {files / 'map.yaml'}" in warnings[0]
    assert "signals file" not in warnings[0]


def test_existing_bag_needs_overwrite(files, capsys):
    words = (files / "a.csv", "--mapping", files / "map.yaml", "--out", files / "bag")
    assert run(*words) == 0
    assert run(*words) == 2
    assert "exists; choose another name for --out, or replace it with --overwrite" in errors(capsys)[-1]
    assert run(*words, "--overwrite") == 0


def test_recording_that_cannot_be_identified_is_imported_with_a_warning(files, capsys):
    (files / "a.csv").write_text("x,F\n1,2\n1,3\n")
    assert run(files / "a.csv", "--mapping", files / "map.yaml", "--out", files / "bag") == 0
    assert "position: constant at 0.001 m" in errors(capsys)[0]


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason=f"measured recordings are not in {DATA} (set CES_DATA)")
@pytest.mark.parametrize(
    ("name", "pattern"), [("dyke_mr", "ranran_50.csv"), ("utfsm_mr", "sine_5mm*.csv"), ("brfd_backlash", "1Hz*.json")]
)
def test_measured_logs_become_bags_without_loss(tmp_path, name, pattern):
    log = min((DATA / name).glob(pattern))
    mapping = ROOT / "config" / "import" / f"{name}.yaml"
    assert run(log, "--mapping", mapping, "--out", tmp_path / "bag") == 0
    expected = import_log(log, import_.load_dyno_mapping(mapping))
    recording = read_recording(tmp_path / "bag", load_signals())
    for signal, channel in expected.channels.items():
        np.testing.assert_array_equal(recording.channel(signal).values, channel.values)
        np.testing.assert_array_equal(recording.channel(signal).stamps_ns, channel.stamps_ns)


def test_a_signal_without_a_topic_is_left_out_with_a_warning(files, capsys):
    (files / "map.yaml").write_text(MAPPING + "temperature: {column: x, scale: 2.0}\n")
    assert run(files / "a.csv", "--mapping", files / "map.yaml", "--out", files / "bag") == 0
    out, err = capsys.readouterr()
    assert "5 samples of position, current, force" in out
    assert "temperature is left out; give it a topic in the signals file" in err


def test_a_speed_goes_into_the_message_of_the_position(files, capsys):
    (files / "map.yaml").write_text(MAPPING + "speed: {column: x, scale: 2.0}\n")
    joints = 'topic: joint_states, type: sensor_msgs/msg/JointState, field: "velocity[rear_damper]"'
    (files / "s.yaml").write_text(f"speed: {{{joints}}}\n")
    words = ("--mapping", files / "map.yaml", "--out", files / "bag", "--signals", files / "s.yaml")
    assert run(files / "a.csv", *words) == 0
    recording = read_recording(files / "bag", load_signals(files / "s.yaml"))
    np.testing.assert_array_equal(recording.channel("speed").values, 2.0 * np.arange(5))
    np.testing.assert_array_equal(recording.channel("speed").stamps_ns, recording.channel("position").stamps_ns)
    assert "left out" not in capsys.readouterr().err


def test_a_long_log_is_written_block_by_block(files, capsys, monkeypatch):
    """Two bags; a fault in a later block is said once, and an error there leaves nothing of either bag."""
    for name, size in (("MAX_ROWS", 100), ("SAMPLE", 50), ("BATCH", 10), ("FIRST_PART", 100), ("PART", 300)):
        monkeypatch.setattr(csv, name, size)
    rows = [f"{20 * np.sin(0.3 * i):.4f},{800 * np.cos(0.3 * i):.2f}" for i in range(1050)]
    rows[777] = f"nan,{rows[777].partition(',')[2]}"
    words = ("--mapping", files / "map.yaml", "--out", files / "bags")
    (files / "b.csv").write_text("\n".join(["x,F", *rows, ""]))
    assert run(files / "a.csv", files / "b.csv", *words) == 0
    out, err = capsys.readouterr()
    assert f"{files / 'bags' / 'b'}: 1050 samples of position, current, force at 100.0 Hz" in out
    assert err.count("warning:") == 1
    assert (
        "the first at 0.610 s; they are left out (in 1 of 10 parts of the log; the numbers are of that from 7.1" in err
    )
    whole = import_log(files / "b.csv", import_.load_dyno_mapping(files / "map.yaml"))
    recording = read_recording(files / "bags" / "b", load_signals())
    for name, channel in whole.channels.items():
        np.testing.assert_array_equal(recording.channel(name).stamps_ns, channel.stamps_ns)
        np.testing.assert_array_equal(recording.channel(name).values, channel.values)
    (files / "b.csv").write_text("\n".join(["x,F", *rows, "x,1", ""]))
    assert run(files / "a.csv", files / "b.csv", *words[:2], "--out", files / "more") == 2
    assert "b.csv:1052: column 'x' is 'x'; expected a number" in errors(capsys)[-1]
    assert not (files / "more").exists()
