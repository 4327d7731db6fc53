"""Mappings proposed from the columns of logs as users have them, and logs that are imported without a mapping."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import proposal_bags as bags
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ces_cli.bags import import_
from ces_cli.terminal import terminal
from ces_data.bags.reader import read_recording
from ces_data.logs.log_import import import_log, to_recording
from ces_data.logs.log_mapping import load_dyno_mapping, parse_dyno_mapping
from ces_data.mapping.proposals import propose_mapping
from ces_data.signals_file import load_signals
from ces_observer.errors import CesError

ROOT = Path(__file__).parents[3]
DATA = Path(os.environ.get("CES_DATA", ROOT.parent / "shared" / "data"))
measured = pytest.mark.skipif(not DATA.is_dir(), reason=f"measured recordings are not in {DATA} (set CES_DATA)")
pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")
T, X, CURRENT, F = bags.motion(samples=1500)
PLAIN = {"time_s": T, "position_mm": 1000 * X, "current_A": CURRENT, "force_N": F}


def write(path, columns, delimiter=",", decimal=".", head=(), number=repr):
    rows = [delimiter.join(columns), *head]
    rows += [
        delimiter.join(c if isinstance(c, str) else number(c).replace(".", decimal) for c in row)
        for row in zip(*(np.asarray(c).tolist() for c in columns.values()), strict=True)
    ]
    path.write_text("\n".join(rows) + "\n")
    return path


def recording_of(proposal):
    assert proposal.doubts == ()
    return to_recording(proposal.log, proposal.mapping)


def assert_reads(recording, x=X, i=CURRENT, f=F):
    for name, values in (("position", x), ("current", i), ("force", f)):
        np.testing.assert_allclose(recording.channel(name).values, values, rtol=1e-9, atol=1e-12)


def run(*words):
    return terminal.run("import", import_.main, [str(word) for word in words])


def test_obvious_columns_need_no_mapping(tmp_path, capsys):
    path = write(tmp_path / "log.csv", PLAIN)
    assert run(path, "--propose") == 0
    (tmp_path / "my.yaml").write_text(capsys.readouterr().out)
    assert_reads(import_log(path, load_dyno_mapping(tmp_path / "my.yaml")))
    assert run(path, "--out", tmp_path / "bag") == 0
    out = capsys.readouterr().out
    assert "time from 'time_s' [s], position from 'position_mm' [mm to SI], current from 'current_A' [A]" in out
    recording = read_recording(tmp_path / "bag", load_signals())
    assert_reads(recording)
    np.testing.assert_array_equal(recording.channel("force").stamps_ns, np.rint(T * 1e9).astype(np.int64))


@pytest.mark.parametrize(("delimiter", "decimal"), [(";", ","), ("\t", "."), ("|", "."), (" ", ",")])
def test_delimiter_and_decimal_are_found_and_said(tmp_path, delimiter, decimal):
    proposal = propose_mapping(write(tmp_path / "log.csv", PLAIN, delimiter, decimal))
    assert_reads(recording_of(proposal))
    assert proposal.log.notes[0].startswith("cells are separated by")
    assert ("decimals by ','" in proposal.log.notes) == (decimal == ",")


def test_german_names_with_a_row_of_units_and_a_turned_force(tmp_path):
    columns = {"Zeit": 1000 * T, "Weg": 1000 * X, "Strom": 1000 * CURRENT, "Kraft": -F / 1000, "Temp": 30.0 + T}
    path = write(tmp_path / "log.txt", columns, ";", ",", head=["[ms];[mm];[mA];[kN];[°C]"])
    path.write_text("Prüfstand 7\n" + path.read_text())
    proposal = propose_mapping(path)
    recording = recording_of(proposal)
    assert_reads(recording)
    assert int(recording.channel("force").stamps_ns[1]) == bags.PERIOD_NS
    assert "sign turned" in proposal.text
    assert "# temperature:" in proposal.text


def test_units_in_the_header_count_for_a_mapping_without_units(tmp_path):
    path = write(tmp_path / "log.csv", {"t": T, "x": 1000 * X, "i": CURRENT, "F": F / 1000}, head=["s,mm,A,kN"])
    text = "time: {column: t}\nposition: {column: x}\ncurrent: {column: i}\nforce: {column: F}"
    assert_reads(import_log(path, parse_dyno_mapping(text, "map.yaml")))


def test_a_log_without_time_needs_the_rate(tmp_path, capsys):
    path = write(tmp_path / "log.csv", {key: PLAIN[key] for key in ("position_mm", "current_A", "force_N")})
    assert run(path, "--out", tmp_path / "bag") == 2
    assert "no column is named like a time and goes forward; give --rate HZ" in capsys.readouterr().err
    assert run(path, "--out", tmp_path / "bag", "--rate", 500) == 0
    assert_reads(read_recording(tmp_path / "bag", load_signals()))


@pytest.mark.parametrize(("name", "factor"), [("time", 1e-9), ("timestamp", 1e-6), ("t_ns", 1.0)])
def test_times_since_1970_are_read_in_the_unit_of_their_size(tmp_path, name, factor):
    exact = 1_714_564_800_000_000_000 + np.rint(T * 1e9).astype(np.int64)
    times = exact if factor == 1.0 else [round(stamp * factor, 3) for stamp in exact.tolist()]
    if factor == 1e-6:
        times = [stamp // 1_000_000 for stamp in exact.tolist()]  # whole milliseconds
    path = write(tmp_path / "log.csv", {name: times, **{k: PLAIN[k] for k in list(PLAIN)[1:]}})
    stamps = recording_of(propose_mapping(path)).channel("position").stamps_ns
    np.testing.assert_allclose(stamps - exact[0], exact - exact[0], atol=1_000_000)
    assert (stamps == exact).all() or factor != 1.0


def test_a_time_in_steps_of_one_is_not_taken_for_seconds(tmp_path):
    path = write(tmp_path / "log.csv", {"time": np.arange(len(T)), **{k: PLAIN[k] for k in list(PLAIN)[1:]}})
    (doubt,) = propose_mapping(path).doubts
    assert doubt == "time: column 'time' states no unit; in seconds its steps are 1 s (is it in ms, or a number?)"


def test_a_table_without_names_is_read_by_its_numbers_and_not_taken_as_certain(tmp_path):
    path = write(tmp_path / "log.csv", dict(zip("abcd", (T, X, CURRENT, F), strict=True)))
    path.write_text(path.read_text().partition("\n")[2])
    proposal = propose_mapping(path)
    assert any("time: column 0 by its numbers alone" in doubt for doubt in proposal.doubts)
    assert_reads(to_recording(proposal.log, proposal.mapping))


def test_a_sign_that_cannot_be_checked_is_taken_as_logged_with_a_warning(tmp_path, capsys):
    path = write(tmp_path / "log.csv", {**PLAIN, "force_N": 1e5 * X})
    assert run(path, "--out", tmp_path / "bag") == 0
    assert "the sign could not be checked: force and speed hardly correlate" in capsys.readouterr().err


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8-sig"])
def test_encodings_of_windows(tmp_path, encoding):
    columns = {"Zeit [s]": T, "Weg [mm]": 1000 * X, "Strom [A]": CURRENT, "Kraft [N]": F, "T_Öl [°C]": 40 + np.sin(T)}
    path = write(tmp_path / "log.csv", columns, ";", ",")
    path.write_bytes(path.read_text(encoding="utf-8").encode(encoding))
    assert_reads(recording_of(propose_mapping(path)))


def test_blank_cells_are_samples_that_were_not_taken(tmp_path):
    slow = [repr(value) if k % 5 == 0 else "" for k, value in enumerate(CURRENT.tolist())]
    path = write(tmp_path / "log.csv", {**PLAIN, "current_A": slow})
    proposal = propose_mapping(path)
    recording = recording_of(proposal)
    assert "blank: missing  # blank cells (1200 of current)" in proposal.text
    np.testing.assert_array_equal(recording.channel("current").values, CURRENT[::5])
    np.testing.assert_array_equal(recording.channel("current").stamps_ns, recording.channel("force").stamps_ns[::5])


def test_a_guess_that_is_not_certain_is_refused_with_the_way_out(tmp_path, capsys):
    path = write(tmp_path / "log.csv", {"t": T, "x": 1000 * X, "i": CURRENT, "F": F})
    assert run(path, "--out", tmp_path / "bag") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "position: perhaps mm, because its span of" in line
    assert f"'ces import {path} --propose > my.yaml' writes a mapping to correct" in line
    assert not (tmp_path / "bag").exists()


def test_a_current_in_the_name_of_the_file(tmp_path):
    path = write(tmp_path / "sine_0.75A.csv", {key: PLAIN[key] for key in ("time_s", "position_mm", "force_N")})
    proposal = propose_mapping(path)
    assert set(recording_of(proposal).channel("current").values) == {0.75}
    assert "current: {from_name:" in proposal.text


@pytest.mark.parametrize(
    "other", [{"xcmd_mm": 1000 * np.roll(X, 3)}, {"v": np.gradient(X, T)}], ids=["command", "speed"]
)
def test_a_commanded_stroke_is_not_the_position_and_a_speed_not_the_force(tmp_path, other):
    path = write(tmp_path / "log.csv", {"t_s": T, **other, "x_mm": 1000 * X, "i_A": CURRENT, "F": F})
    assert_reads(recording_of(propose_mapping(path)))


@measured
def test_a_measured_log_is_read_as_by_its_mapping():
    path = DATA / "utfsm_mr" / "sine_25mm0x5Hz_0.00A.csv"
    expected = import_log(path, load_dyno_mapping(ROOT / "config" / "import" / "utfsm_mr.yaml"))
    found = recording_of(propose_mapping(path))
    for signal, channel in expected.channels.items():
        np.testing.assert_array_equal(found.channel(signal).values, channel.values)
        np.testing.assert_array_equal(found.channel(signal).stamps_ns, channel.stamps_ns)


@measured
def test_a_measured_log_without_names_is_not_guessed():
    proposal = propose_mapping(DATA / "brfd_backlash" / "1Hz30lbtension1amplitude.json")  # the speed is in it
    assert proposal.mapping is None and 'rows: "data"' in proposal.text
    assert "# force: {column: 4}" in proposal.text and "# current: {column" not in proposal.text  # the bands' forces


def test_one_of_several_dampers_in_a_log_is_selected_as_the_message_says(tmp_path, capsys):
    both = {f"{side}_{name}": column for side in ("vl", "vr") for name, column in list(PLAIN.items())[1:]}
    path = write(tmp_path / "log.csv", {"time_s": T, **both, "vr_force_N": 0.5 * F})
    assert run(path, "--out", tmp_path / "bag") == 2
    assert f"several dampers (vl, vr); select one with '{path}#vl'" in capsys.readouterr().err
    assert run(f"{path}#vl", f"{path}#vr", "--out", tmp_path / "both") == 0
    for name, factor in (("log_vl", 1.0), ("log_vr", 0.5)):
        assert_reads(read_recording(tmp_path / "both" / name, load_signals()), f=factor * F)
    assert run(f"{path}#hl", "--out", tmp_path / "bag") == 2
    assert "log.csv: no damper 'hl'; found: vl, vr" in capsys.readouterr().err
    proposal = propose_mapping(write(tmp_path / "one.csv", {**dict(list(PLAIN.items())[:2]), "taut": F}))
    assert "current: {column" not in proposal.text  # what goes with the speed is a force


def test_a_sign_is_turned_only_with_a_reason(tmp_path):
    """The larger peak of a force is that in rebound; a symmetric force says nothing of which signal is reversed."""
    alike = 1000.0 * np.tanh(F / 300.0)
    found = {}
    for name, columns in {
        "force": {**PLAIN, "force_N": -F},
        "position": {**PLAIN, "position_mm": -1000 * X},
        "unknown": {**PLAIN, "force_N": -alike},
    }.items():
        found[name] = propose_mapping(write(tmp_path / f"{name}.csv", columns))
    assert not found["force"].doubts and found["force"].mapping.signals["force"].scale < 0.0
    assert not found["position"].doubts and found["position"].mapping.signals["position"].scale < 0.0
    assert not found["unknown"].doubts
    assert "force and position have opposite signs; one of them is positive in rebound" in found["unknown"].remarks[0]


# ----------------------------------------- Tables of any content: a proposal either reads, or ends in one clear line.


CELLS = st.one_of(
    st.sampled_from(
        ["", "0", "1", "2", "-1.5", "1e400", "nan", "inf", "1,5", "2024-05-01 12:00:00", "12:00:01.5", "ok"]
    ),
    st.integers(-3, 10**20).map(str),
)
NAMES = st.sampled_from(
    ["t", "time_s", "x_mm", "x", "x", "force_N", "F", "current_A", "stamp_ns", "[mm]", "", "0", "é"]
)
TABLES = st.integers(1, 5).flatmap(
    lambda width: st.lists(st.lists(CELLS, min_size=width, max_size=width), min_size=1, max_size=8)
)
NUMBERS = st.one_of(st.integers(-(10**30), 10**30), st.floats(), st.none(), st.booleans(), st.text(max_size=3))
TREES = st.recursive(
    NUMBERS,
    lambda inner: st.one_of(st.lists(inner, max_size=5), st.dictionaries(st.sampled_from(["t", "x", "F", "a"]), inner)),
    max_leaves=20,
)
settings.register_profile("proposals", deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
FEW = settings(settings.get_profile("proposals"), max_examples=40, derandomize=True)


def propose(path):
    """Propose a mapping and use it; a CesError has to be one line."""
    try:
        proposal = propose_mapping(path)
        if proposal.mapping is not None:
            to_recording(proposal.log, proposal.mapping)
    except CesError as error:
        assert "\n" not in str(error)


@FEW
@given(names=st.lists(NAMES, max_size=5), rows=TABLES, mark=st.sampled_from([",", ";", "\t", "|", " "]))
def test_text_tables(tmp_path, names, rows, mark):
    path = tmp_path / "log.csv"
    path.write_text("\n".join(mark.join(row) for row in [names, *rows]), encoding="utf-8")
    propose(path)


@FEW
@given(tree=TREES)
def test_json_trees(tmp_path, tree):
    path = tmp_path / "log.json"
    path.write_text(json.dumps(tree))
    propose(path)
