"""A speed in a log: found, turned and scaled beside the position, or integrated where there is no position."""

import re

import numpy as np
import proposal_bags as bags
import pytest

from ces import Recording as DeskRecording
from ces_cli.bags import import_
from ces_cli.terminal import terminal
from ces_data.bags.reader import RecordingWarning, read_recording
from ces_data.checks.derivatives import compare_derivative
from ces_data.reading import read_log
from ces_data.signals_file import load_signals
from ces_identify.prepare.sampling import choose_motion
from ces_observer.errors import RecordingError

T, X, CURRENT, F = bags.motion(samples=8000)
V = np.gradient(X, T)
LOG = {"time_s": T, "position_mm": 1000 * X, "current_A": CURRENT, "force_N": F}


def write(path, **columns):
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    return path


def imported(tmp_path, **columns):
    words = [str(write(tmp_path / "log.csv", **columns)), "--out", str(tmp_path / "bag"), "--overwrite"]
    status = terminal.run("import", import_.main, words)
    return read_recording(tmp_path / "bag", load_signals()) if status == 0 else None


@pytest.mark.parametrize(
    ("name", "values"),
    [("speed_cm_s", 100 * V), ("velocity_in_s", V / 0.0254), ("vel", -1000 * V), ("V [m/s]", V)],
    ids=["cm/s", "in/s", "no unit, turned", "one letter"],
)
def test_a_speed_beside_the_position_is_imported_and_used_on_request_only(tmp_path, capsys, name, values):
    recording = imported(tmp_path, **LOG, **{name: values})
    assert re.search(r"speed: (1|1\.0\d|0\.99\d?) times the differentiated position", capsys.readouterr().out)
    np.testing.assert_allclose(recording.channel("speed").values, V, atol=1e-9)
    assert choose_motion([recording]) == choose_motion([recording], "position") == ""
    assert choose_motion([recording], "measured") == "speed"


def test_a_late_speed_is_found_with_its_lag(tmp_path, capsys):
    recording = imported(tmp_path, **LOG, speed=np.interp(T - 0.005, T, V))
    text = capsys.readouterr().err
    assert re.search(r"speed: logged (4.[89]|5.[01]) ms after the differentiated position; add 0.00.. to the key", text)
    assert compare_derivative(recording, "speed").late_s == pytest.approx(0.005, abs=3e-4)


def test_a_speed_of_the_vehicle_is_not_that_of_the_damper(tmp_path):
    assert "speed" not in imported(tmp_path, **LOG, vehicle_speed_m_s=15.0 + V)


def test_a_speed_alone_is_integrated_and_used(tmp_path, capsys):
    alone = {name: LOG[name] for name in ("time_s", "current_A", "force_N")}
    with pytest.warns(RecordingWarning, match="position: none was measured; it is the integral of the speed"):
        recording = imported(tmp_path, **alone, speed_cm_s=100 * V + 0.3)
    assert "position: none was measured" in capsys.readouterr().out
    error = recording.channel("position").values - X
    assert np.std(error) < 0.05 * np.std(X)
    assert choose_motion([recording]) == "speed"
    assert choose_motion([read_log(tmp_path / "log.csv")]) == "speed"


def test_a_force_against_a_speed_alone_is_named_with_a_remedy_that_works(tmp_path, capsys):
    path = write(tmp_path / "log.csv", time_s=T, speed_m_s=V, force_N=-F)
    mapping = tmp_path / "my.yaml"
    mapping.write_text(
        "time: {column: time_s}\nspeed: {column: speed_m_s}\nforce: {column: force_N}\ncurrent: {constant: 1.25}\n"
    )
    words = [str(path), "--mapping", str(mapping), "--out", str(tmp_path / "bag"), "--overwrite"]
    assert terminal.run("import", import_.main, words) == 0
    assert "multiply the scale of the one that is not by -1 in" in capsys.readouterr().err
    mapping.write_text(mapping.read_text().replace("force_N", "force_N, scale: -1"))
    assert terminal.run("import", import_.main, words) == 0
    assert "force: acts with the motion" not in capsys.readouterr().err


def test_a_measured_speed_that_is_not_there_is_refused():
    with pytest.raises(RecordingError, match="no measured speed; describe 'speed' in the signals file"):
        choose_motion([DeskRecording.from_arrays(T, X, CURRENT, F)], "measured")


def test_a_speed_or_acceleration_is_never_dropped_without_a_word(tmp_path):
    said, noise = [], np.random.default_rng(1).normal(0.0, 0.1, len(T))
    log = write(tmp_path / "log.csv", **LOG, speed_m_s=V, acceleration_m_s2=np.gradient(V, T), wheel_speed_m_s=noise)
    read_log(log, say=said.append)
    assert "speed from 'speed_m_s' [m/s] to check the position with" in said[0]
    assert "'acceleration_m_s2' (acceleration) not used" in said[0] and "'wheel_speed_m_s' (speed) not used" in said[0]
    alone = {name: LOG[name] for name in ("time_s", "current_A", "force_N")}
    said.clear()
    with pytest.warns(RecordingWarning, match="position: none was measured; it is the integral of the speed"):
        recording = read_log(write(tmp_path / "alone.csv", **alone, speed_m_s=V), say=said.append)
    assert "speed from 'speed_m_s' [m/s]" in said[0] and "not used" not in said[0]
    assert np.corrcoef(recording.channel("position").values, X)[0, 1] > 0.99
