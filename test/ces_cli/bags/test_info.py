import json

import numpy as np
import pytest
from damper_models import plain_damper

from ces_cli.bags import info
from ces_cli.terminal import terminal
from ces_data.bags.writer import TopicData, recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_observer.errors import CesError
from ces_observer.signals import Signals

DEFAULT = Signals.from_mapping({}, "defaults")
N = 4000


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch):
    monkeypatch.setattr(terminal.out, "width", 120)


def bag(path, more=(), **changed):
    t = np.arange(N) / 1000
    values = {"position": 0.02 * np.sin(6 * t), "current": 0.3 + 0.1 * (t > 2), "force": 900.0 * np.cos(6 * t)}
    stamps = 10**9 + np.arange(N) * 1_000_000
    channels = {k: Channel(k, "", stamps, v) for k, v in {**values, **changed}.items()}
    write_bag(path, [*recording_topics(Recording("run", channels), DEFAULT), *more])
    return str(path)


def test_report_lists_the_contents_of_the_bag(tmp_path, capsys):
    extra = TopicData("/imu_count", "std_msgs/msg/Int32", np.arange(1, 6), {"data": np.zeros(5)})
    assert info.main([bag(tmp_path / "run", [extra])]) == 0
    text = capsys.readouterr().out
    assert "position: /joint_states position[rear_damper] (sensor_msgs/msg/JointState)" in text
    assert "other topics: /imu_count (std_msgs/msg/Int32, 5)" in text
    rows = {line.split()[0]: line.split() for line in text.splitlines() if line.split()[1:2] in (["m"], ["A"], ["N"])}
    assert rows["position"] == ["position", "m", "4000", "4.00", "1000.0", "0.000", "1.000", "0", "-0.02", "0.02"]
    assert rows["current"][-2:] == ["0.3", "0.4"]
    assert "no header" not in text  # the bag is our own: the log times are the samples' stamps
    assert info.main([str(tmp_path / "run" / "run.mcap")]) == 0  # without the metadata that say so
    assert "warning: current: std_msgs/msg/Float64 on /valve_current has no header" in capsys.readouterr().out
    assert "non-causal" in text


def test_map_shows_both_currents_and_the_range_of_speed(tmp_path, capsys):
    info.main([bag(tmp_path / "run")])
    lines = capsys.readouterr().out.splitlines()
    filled = [line.split()[0] for line in lines if "┤" in line and line.partition("┤")[2].strip()]
    assert filled == ["0.394", "0.306"]
    assert any("-0.12" in line and "+0.12 m/s" in line for line in lines)


def test_a_model_is_shown_with_its_ranges_and_its_proof(tmp_path, capsys):
    path = tmp_path / "model.json"
    plain_damper(max_gap_s=0.3).save(path)
    assert info.main([str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{path}  (sha256 ")
    assert "  model: polynomial_narx, " in lines[1] and "bridges lost samples for 0.3 s" in lines[2]
    assert lines[-1].endswith("; stability: proved for every input")
    path.write_text('{"schema": "ces-gap/1"}')
    with pytest.raises(CesError, match="model"):
        info.main([str(path)])
    with pytest.raises(CesError, match="omit --json"):
        info.main([str(path), "--json"])


def test_json_for_other_programs(tmp_path, capsys):
    bag(tmp_path / "a")
    info.main([str(tmp_path / "a" / "a.mcap"), bag(tmp_path / "b", current=np.zeros(N)), "--json"])
    text = json.loads(capsys.readouterr().out)
    assert text["schema"] == "ces-info/1"
    first = text["recordings"][0]
    assert (first["name"], len(first["sha256"])) == ("a", 64)
    assert first["channels"]["position"]["rate_Hz"] == pytest.approx(1000.0)
    assert first["findings"][0]["severity"] == "warning"
    assert np.sum(text["coverage"]["share"]) == pytest.approx(1.0)


def test_constant_signal_and_own_signals_file(tmp_path, capsys):
    (tmp_path / "signals.yaml").write_text("current: {constant: 0.5}\nposition: {scale: 2.0}\n")
    assert info.main([bag(tmp_path / "run"), "--signals", str(tmp_path / "signals.yaml")]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["current", "A", "0.5", "0.5"] in rows
    assert any(row[:2] == ["position", "m"] and row[-2:] == ["-0.04", "0.04"] for row in rows)
