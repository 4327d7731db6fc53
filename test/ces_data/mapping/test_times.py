"""The time of a log: names of other languages and programs, numbers alone, times of day, pauses, what is not known."""

import numpy as np
import pytest
import scipy.io
from log_examples import CURRENT, F, T, X, assert_recording

from ces_cli.main import main
from ces_data.bags.reader import read_recording
from ces_data.findings import rate_between_pauses
from ces_data.logs.log_import import import_log, to_recording
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.mapping.proposals import propose_mapping
from ces_data.signals_file import load_signals

ROWS = [f",{1e3 * x!r},{i!r},{f!r}\n" for x, i, f in zip(X.tolist(), CURRENT.tolist(), F.tolist(), strict=True)]
SIGNALS = "position_mm,current_A,force_N"


def write(folder, name, times):
    path = folder / "log.csv"
    rows = "".join(f"{time}{row}" for time, row in zip(times, ROWS, strict=True))
    path.write_text(f"{name},{SIGNALS}\n{rows}", encoding="utf-8")
    return path


WORDS = "Temps Tid tiempo Tijd ZAMAN czas tempo 时间 tout Tout Zeit Elapsed Uptime LapTime"


@pytest.mark.parametrize("name", WORDS.split())
def test_times_are_known_by_their_names_in_other_languages(tmp_path, name):
    proposal = propose_mapping(write(tmp_path, name, T.tolist()))
    assert proposal.doubts == ()
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False)


@pytest.mark.parametrize(("name", "per_s"), [("Millis", 1e3), ("usec", 1e6), ("Micros", 1e6), ("Elapsed_ms", 1e3)])
def test_units_of_times_are_in_their_names(tmp_path, name, per_s):
    proposal = propose_mapping(write(tmp_path, name, np.rint(T * per_s).astype(int).tolist()))
    assert proposal.doubts == ()
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False)


@pytest.mark.parametrize(
    ("name", "per_s", "doubt"),
    [
        ("SysTime", 1e3, "states no unit; taken as ms, because in seconds its steps would be 2 s"),
        ("kanal_7", 1.0, "by its numbers alone, which rise evenly; taken as s"),
        ("kanal_7", 1e3, "by its numbers alone, which rise evenly; taken as ms"),
        ("kanal_7", 1e6, "by its numbers alone, which rise evenly; taken as us"),
    ],
)
def test_what_the_numbers_alone_say_is_proposed_and_to_be_checked(tmp_path, name, per_s, doubt):
    """Its proposal, once confirmed, imports the right times."""
    path = write(tmp_path, name, (np.rint(T * 1e6) * per_s / 1e6).tolist())
    proposal = propose_mapping(path)
    (said,) = proposal.doubts
    assert doubt in said
    (tmp_path / "map.yaml").write_text(proposal.text)
    assert_recording(import_log(path, load_dyno_mapping(tmp_path / "map.yaml")), slow=False)


@pytest.mark.parametrize("times", [range(len(T)), [7] * len(T)])
def test_a_rate_is_never_invented(tmp_path, capsys, times):
    """Numbers of rows are no time, and without a time no rate is printed."""
    path = write(tmp_path, "n", times)
    assert main(["import", str(path), "--out", str(tmp_path / "bag")]) == 2
    assert "time: no column is named like a time and goes forward; give --rate HZ" in capsys.readouterr().err
    assert main(["import", str(path), "--propose"]) == 0
    assert "1000 Hz" not in "".join(capsys.readouterr())


def test_hours_minutes_and_seconds_in_one_number(tmp_path):
    """In a satellite receiver's time of day, 12:59:59.5 is followed by 13:00:00.5, a step of 4041."""
    seconds = 12 * 3600 + 59 * 60 + 58 + T
    digits = [f"{int(s // 3600) * 10000 + int(s // 60) % 60 * 100 + s % 60:.4f}" for s in seconds]
    path = write(tmp_path, "UTC", digits)
    proposal = propose_mapping(path)
    assert "time from 'UTC' [HHMMSS]" in proposal.found
    recording = to_recording(proposal.log, proposal.mapping)
    np.testing.assert_allclose(recording.channel("force").stamps_ns * 1e-9, seconds, atol=1e-4)


def test_the_rate_is_that_between_pauses(tmp_path, capsys):
    times = T + 60.0 * (np.arange(len(T)) >= 700) + 8.0 * (np.arange(len(T)) >= 900)
    path = write(tmp_path, "time_s", times.tolist())
    assert main(["import", str(path), "--out", str(tmp_path / "bag"), "--json"]) == 0
    rate = 1.0 / (T[1] - T[0])
    assert f'"rate_Hz": {rate:g}' in capsys.readouterr().out
    assert rate_between_pauses(read_recording(tmp_path / "bag", load_signals()).channel("force").stamps_ns) == rate


def test_batches_are_no_pauses():
    """Ten samples within 1 ms each 20 ms are at 500 Hz."""
    stamps = (np.arange(200)[:, None] * 20_000_000 + np.arange(10) * 100_000).ravel()
    assert rate_between_pauses(stamps) == pytest.approx(500.0, rel=0.01)


@pytest.mark.parametrize("others", [{}, {"Ts": 0.002}, {"t": np.arange(3.0)}])
def test_a_scalar_or_another_length_is_no_time_of_the_rows(tmp_path, others):
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {**others, "Tout": T, "stroke_mm": 1e3 * X, "current_A": CURRENT, "force_N": F})
    proposal = propose_mapping(path)
    assert proposal.doubts == ()
    assert 'time: {column: "Tout"}' in proposal.text
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False)


def test_a_sampling_time_is_the_rate(tmp_path):
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"Ts": T[1] - T[0], "stroke_mm": 1e3 * X, "current_A": CURRENT, "force_N": F})
    proposal = propose_mapping(path)
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False)


def test_racecapture_names_hold_units(tmp_path):
    rows = "".join(f"{1e3 * t:.0f}{row}" for t, row in zip(T, ROWS, strict=True))
    head = '"Interval"|"ms"|0|0|1,"Damper"|"mm"|0.0|200.0|500,"Coil"|"A"|0.0|2.0|50,"Load"|"N"|-5000.0|5000.0|500\n'
    (tmp_path / "log.csv").write_text(head + rows)
    proposal = propose_mapping(tmp_path / "log.csv")
    assert (proposal.doubts, proposal.remarks) == ((), ())
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False)


def test_a_unit_known_by_its_range_alone_is_said(tmp_path, capsys):
    path = write(tmp_path, "time_s", T.tolist())
    path.write_text(path.read_text().replace("force_N", "Load", 1))
    assert main(["import", str(path), "--out", str(tmp_path / "bag")]) == 0
    assert "force: no unit is stated; taken as N" in capsys.readouterr().err
    assert "# CHECK: no unit is stated; taken as N" in propose_mapping(path).text


@pytest.mark.parametrize("line", ["Sample Rate: {} Hz", "# Abtastrate [Hz];{}", "Scan rate (Hz)\t{}"])
def test_a_rate_that_the_header_states_is_compared_or_taken(tmp_path, line):
    path = write(tmp_path, "time_s", T.tolist())
    path.write_text(f"{line.format('1000.0')}\n{path.read_text()}")
    (doubt,) = propose_mapping(path).doubts
    assert doubt == "time: 'time_s' gives 500 Hz, and the header states 1000 Hz; which is right?"
    path.write_text(f"{line.format('500')}\n{SIGNALS}\n" + "".join(row[1:] for row in ROWS))
    proposal = propose_mapping(path)
    assert "rate 500 Hz" in proposal.found
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False)


def test_a_unit_of_another_system_than_the_strokes_is_said(tmp_path):
    path = write(tmp_path, "time_s", T.tolist())
    path.write_text(path.read_text().replace("force_N", "force_lbf", 1))
    assert propose_mapping(path).remarks == ("force: stated in lbf, the position in mm: is that so?",)
    path.write_text(path.read_text().replace("position_mm", "position [in]", 1))
    assert propose_mapping(path).remarks == ()
