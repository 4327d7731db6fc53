import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from ces_data.logs import csv
from ces_data.logs.log_file import open_log
from ces_data.logs.log_import import import_log, read_blocks
from ces_data.logs.log_mapping import TEMPLATE, DynoMapping, LogColumn, MappingError, load_dyno_mapping
from ces_data.recording import Recording
from ces_observer.errors import CesError

ROOT = Path(__file__).parents[3]

SIGNALS = "position: {column: x}\ncurrent: {column: i}\nforce: {column: F}\n"
TIME = "time: {column: t}\n"
MAPPED = TIME + SIGNALS
NUMBERED = "time: {column: 0}\nposition: {column: 1}\ncurrent: {column: 2}\nforce: {column: 3}\n"


def mapping(tmp_path, text):
    (tmp_path / "map.yaml").write_text(text)
    return load_dyno_mapping(tmp_path / "map.yaml")


def log(tmp_path, text, map_text=MAPPED, name="log_0.75A.csv"):
    path = tmp_path / name
    path.write_text(text)
    return import_log(path, mapping(tmp_path, map_text))


def columns(recording):
    return {name: channel.values.tolist() for name, channel in recording.channels.items()}


WANTED = {"position": [0.1, 0.2, 0.3], "current": [1.0, 1.0, 2.0], "force": [-5.0, 0.0, 5e3]}


@pytest.mark.parametrize(
    ("text", "map_text"),
    [
        ('"t", "x", "i", "F",\n0,0.1,1,-5,\n0.5,.2,1,0,\n1,0.3,2,5e3,\n\n', MAPPED),
        ("\ufefft;x;i;F\r\n0;0,1;1;-5\r\n0,5;0,2;1;0\r\n1;0,3;2;5e3\r\n", 'delimiter: ";"\ndecimal: ","\n' + MAPPED),
        ("0 0.1  1 -5\n0.5 .2 1 0\n1 0.3 2 5e3\n", 'delimiter: " "\n' + NUMBERED),
        ("Rig 7\nt,s\n\nt,x,i,F\n0,0.1,1,-5\n0.5,.2,1,0\n1,0.3,2,5e3\n", "header_lines: 4\n" + MAPPED),
        ("a\tb\n0\t0.1\t1\t-5\n0.5\t.2\t1\t0\n1\t0.3\t2\t5e3\n", 'delimiter: "\\t"\nnames: [t, x, i, F]\n' + MAPPED),
    ],
)
def test_csv_as_dynos_write_it(tmp_path, text, map_text):
    recording = log(tmp_path, text, map_text)
    assert columns(recording) == WANTED
    assert recording.channel("force").stamps_ns.tolist() == [0, 500_000_000, 1_000_000_000]
    assert (recording.name, recording.source) == ("log_0.75A", str(tmp_path / "log_0.75A.csv"))


TABLE = [[0, 0.1, 1, -5], [0.5, 0.2, 1, 0], [1, 0.3, 2, 5e3]]
NAMED = {"t": [0, 0.5, 1], "x": [0.1, 0.2, 0.3], "i": [1, 1, 2], "F": [-5, 0, 5e3]}
TREES = {
    "rows": ({"a": {"data": TABLE}}, "rows: a.data\nnames: [t, x, i, F]\n" + MAPPED),
    "rows by number": (TABLE, NUMBERED),
    "mappings": ([dict(zip("txiF", row, strict=True)) for row in TABLE], MAPPED),
    "columns": (NAMED, MAPPED),
    "columns deeper": ({"run": {"log": NAMED}}, "rows: run.log\n" + MAPPED),
}


@pytest.mark.parametrize("tree", TREES)
def test_json_and_mat(tmp_path, tree):
    content, map_text = TREES[tree]
    assert columns(log(tmp_path, json.dumps(content), map_text, name="log.json")) == WANTED
    if isinstance(content, dict):
        arrays = {"a": {"data": np.array(TABLE)}} if tree == "rows" else content
        scipy.io.savemat(tmp_path / "log.mat", arrays, oned_as="column")
        assert columns(import_log(tmp_path / "log.mat", mapping(tmp_path, map_text))) == WANTED


def test_scale_offset_constant_and_number_in_the_name(tmp_path):
    text = (
        "time: {column: t, scale: 0.001}\nposition: {column: x, scale: -0.01, offset: 0.5}\n"
        'current: {from_name: "_([0-9.]+)A", scale: 2}\nforce: {constant: 3}\n'
    )
    recording = log(tmp_path, "t,x\n0,1\n2,3\n", text)
    assert columns(recording) == {"position": [0.49, 0.47], "current": [1.5, 1.5], "force": [3.0, 3.0]}
    assert recording.channel("position").stamps_ns.tolist() == [0, 2_000_000]


@pytest.mark.parametrize("rate", ["250", "{column: fs, scale: 1}"])
def test_rate_instead_of_time(tmp_path, rate):
    recording = log(tmp_path, "x,i,F,fs\n1,0,0,250\n2,0,0,\n3,0,0,\n", f"rate: {rate}\n{SIGNALS}")
    assert recording.channel("position").stamps_ns.tolist() == [0, 4_000_000, 8_000_000]


CELLS = ("0.1", "-3", "1e-310", "123456789012345678", "2.5e3", "7.0000000000000011", " 4", "NA", "", "x", "1_0", "+5")


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("marks", [",.", ";,", "\t."])
def test_plain_lines_at_once_are_what_they_are_cell_by_cell(tmp_path, monkeypatch, seed, marks):
    rng = np.random.default_rng(seed)
    ends = rng.choice(["\n", "\n", "\n", "\r\n", "\n\n", "\n# note\n"], 200)
    cells = rng.choice(CELLS, (200, 2), p=[0.14] * 6 + [0.1] + [0.012] * 5)
    lines = (
        f"{n}{marks[0]}{marks[0].join(row).replace('.', marks[1])}{end}"
        for n, (row, end) in enumerate(zip(cells, ends, strict=True))
    )
    (tmp_path / "log.csv").write_bytes(f"t{marks[0]}x{marks[0]}F\n{''.join(lines)}".encode())
    marked = {"delimiter": marks[0], "decimal": marks[1], "header_lines": 1}
    layout = DynoMapping(source="map.yaml", signals={}, blank="missing", **marked)
    found = {}
    for sample in (1, 1000):  # rows that are read cell by cell
        monkeypatch.setattr(csv, "SAMPLE", sample)
        for name, size in (("BATCH", 7), ("FIRST_PART", 20), ("PART", 100), ("MAX_ROWS", 50)):
            monkeypatch.setattr(csv, name, size)
        blocks = list(csv.open_log(tmp_path / "log.csv", layout, lambda share: None).blocks([]))
        numbers = [np.concatenate([np.array(b._columns[i].numbers) for b in blocks]).tobytes() for i in range(3)]
        bad = [
            next(((b.place(c.bad[0]), c.bad[1]) for b in blocks if (c := b._columns[i]).bad), None) for i in range(3)
        ]
        found[sample] = numbers, bad, [b.place(row) for b in blocks for row in range(len(b._lines))], blocks[0].notes
        assert len(blocks) >= 4
    assert found[1] == found[1000]


@pytest.mark.parametrize("times", ["{0}", "23:59:{0:02}.5", "{1}", "05/13/2024 00:00:{0:02}"])
def test_a_long_table_is_the_same_in_blocks(tmp_path, monkeypatch, times):
    """Times go on over midnight, the rate and long numbers over the edge of a block; the whole can be read again."""
    if times.startswith("23"):
        clocks = [f"23:59:{n}.5" if n < 60 else f"00:00:{n - 60:02}.5" for n in range(50, 75)]
    else:
        clocks = [times.format(n, 1_700_000_000_000_000_000 + n) for n in range(25)]
    text = "t,x,i,F\n" + "".join(f"{clock},{n},2,{-n}\n" for n, clock in enumerate(clocks))
    map_text = MAPPED.replace("{column: t}", "{column: t, unit: ns}") if times == "{1}" else MAPPED
    whole = log(tmp_path, text, map_text, "log.csv")
    monkeypatch.setattr(csv, "MAX_ROWS", 4)
    monkeypatch.setattr(csv, "BATCH", 2)
    table, wanted = open_log(tmp_path / "log.csv", mapping(tmp_path, map_text)), mapping(tmp_path, map_text)
    for _ in range(2):
        blocks = list(read_blocks(table, wanted))
        assert [len(b.channel("force")) for b in blocks] == [5, 4, 4, 4, 4, 4]
        joined = Recording.join(blocks)
        for name, channel in whole.channels.items():
            np.testing.assert_array_equal(joined.channel(name).stamps_ns, channel.stamps_ns)
            np.testing.assert_array_equal(joined.channel(name).values, channel.values)
    rows = text.splitlines()
    swapped = "\n".join([*rows[:10], rows[10].replace(clocks[9], clocks[5], 1), *rows[11:]])
    if not times.startswith("23"):
        assert "log.csv: line 11: time runs backwards" in failure(tmp_path, swapped, map_text)


def test_the_share_that_is_read_grows_to_the_whole_table(tmp_path, monkeypatch):
    monkeypatch.setattr(csv, "PART", 20_000)
    (tmp_path / "log.csv").write_text("t,x,i,F\n" + "".join(f"{n},1,2,3\n" for n in range(20_000)))
    shares = []
    open_log(tmp_path / "log.csv", mapping(tmp_path, MAPPED), shares.append)
    assert len(shares) > 20
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < 0.5 < shares[-1] <= 1.0


def failure(tmp_path, text, map_text=MAPPED, name="log.csv"):
    with pytest.raises(CesError) as caught:
        log(tmp_path, text, map_text, name)
    assert isinstance(caught.value, MappingError if str(caught.value).startswith(str(tmp_path / "map")) else CesError)
    assert "\n" not in str(caught.value)
    return str(caught.value).replace(f"{tmp_path}{os.sep}", "")


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        ("t,x,i,F\n0,1,0,0\n\n1,--,0,0\n", "log.csv:4: column 'x' is '--'; expected a number"),
        ("t,x,i,F\n0,1,0,0\n1,1_000,0,0\n", "log.csv:3: column 'x' is '1_000'; expected a number"),
        ("t,x,i,F\n25:61:61,1,0,0\n", "log.csv:2: column 't' is '25:61:61'; expected a date that exists"),
        ("t,x,i,F\n0,1,0,0\n1,2,0\n", "log.csv:3: the line has 3 cells, others have 4; write ',' for each blank cell"),
        ("t,x,i,N\n0,1,0,0\n", "log.csv: no column 'F'; the table has t, x, i, N"),
        ("0,1,0,0\n1,1,0,0\n", "log.csv: no column 'x'; the table has columns 0 to 3 without names"),
        ("", "log.csv: the file is empty; expected a header and rows of numbers"),
        ("t,x,i,F\n", "log.csv: no rows of numbers after 1 header lines"),
        ("t,x,i,F\n0,1,0,0\n1,,0,0\n", "(if a blank is a missing sample, set blank: missing in map.yaml)"),
        ("t,x,i,F\n0,1,0,0\nnan,1,0,0\n", "log.csv: line 3: the time is nan; expected seconds"),
    ],
)
def test_bad_csv_is_one_clear_line(tmp_path, text, phrase):
    assert phrase in failure(tmp_path, text)


TICKS = np.arange(40) / 100.0
SET_BACK = TICKS - (TICKS > 0.295) * 0.2
BACKWARDS = {  # times of rows, and what is said of them
    "newest first": (TICKS[::-1], "the newest row is first; reverse the rows"),
    "loop": (np.tile(TICKS, 2), "line 42: time runs backwards, from 0.39 s to 0 s: it begins again"),
    "set back": (SET_BACK, "If the sampling went on evenly, give --rate 100 ("),
    "uneven": (SET_BACK[[*range(25), *range(28, 40)]], "was the clock set back? Then cut it before line 29"),
    "swapped": (TICKS[[0, 2, 1, *range(3, 40)]], "rows are out of order, and no time is missing; sort the rows"),
}


@pytest.mark.parametrize("kind", BACKWARDS)
def test_a_time_that_runs_backwards_has_advice(tmp_path, kind):
    times, phrase = BACKWARDS[kind]
    rows = "\n".join(f"{t:.2f},{t},0,0" for t in times)
    assert phrase in failure(tmp_path, f"t,x,i,F\n{rows}")
    if kind != "swapped":  # a few late samples are sorted, as those in bags
        series = json.dumps({name: {"time": list(times), "data": list(times)} for name in "xiF"})
        said = "the newest row" if kind == "newest first" else "cut it before 'x', sample "
        assert said in failure(tmp_path, series, SIGNALS, "log.json")


def test_a_column_in_a_unit_of_force_is_no_current(tmp_path):
    text = SIGNALS.replace("column: i", 'column: "Band 1 (lb)"')
    assert "is in 'lbf', which is not a unit of a current" in failure(
        tmp_path, "t,x,Band 1 (lb),F\n0,1,2,3\n1,1,2,3\n", "time: {column: t}\n" + text
    )


def test_volts_are_a_current_only_with_a_scale(tmp_path):
    """They were taken, and printed as A."""
    text = "t,x,i,F\n0,1,2,3\n1,1,2,3\n"
    volts = MAPPED.replace("column: i", "column: i, unit: V")
    assert "current: unit is 'V', no current; give its scale in A per V" in failure(tmp_path, text, volts)
    scaled = log(tmp_path, text, MAPPED.replace("column: i", "column: i, scale: 0.5"))
    assert scaled.channel("current").values.tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    ("content", "map_text", "phrase"),
    [
        ('{"t": 0}\n{"t":\n 1}\n', MAPPED, "make one list of several: jq -s . "),
        ("{", MAPPED, "log.json: not a json file: Expecting property name"),
        ("3", MAPPED, "log.json: '' is a int; expected a table"),
        ("[]", MAPPED, "log.json: 'the file' is empty"),
        ('{"run": {"t": []}}', "rows: run.data\n" + MAPPED, "no 'data' in the path 'run.data'; expected one of t"),
        ('{"t": [0]}', MAPPED, "log.json: no 'x' in the path 'x'; expected one of t"),
        ("[[0, 1, 2]]", NUMBERED, "no column 3; the table has columns 0 to 2 without names"),
        ('[[0, 1, 0, 0], [1, 2, 0, "x"]]', NUMBERED, "row 1: column 3 is 'x'; expected a number"),
        ('{"t": [0, 1], "x": [0, 1], "i": [0], "F": [0, 1]}', MAPPED, "different lengths (position 2, current 1"),
        ('{"t": [0], "x": [0, 1], "i": [0, 1], "F": [0, 1]}', MAPPED, "1 times for 2 values"),
        ('{"x": [0], "i": [0], "F": [0], "fs": 0}', "rate: {column: fs}\n" + SIGNALS, "column 'fs' is 0 Hz"),
    ],
)
def test_bad_json_is_one_clear_line(tmp_path, content, map_text, phrase):
    assert phrase in failure(tmp_path, content, map_text, name="log.json")


def test_a_bad_cell_among_long_nanoseconds_is_named_with_its_line(tmp_path):
    rows = f"t,x,i,F\n{10**18},1,1,1\noops,1,1,2\n"
    phrase = f":3: column 't' is 'oops'; expected a time like the first one, '{10**18}'"
    assert phrase in failure(tmp_path, rows, "time: {column: t, unit: ns}\n" + SIGNALS)


def test_name_without_the_number_and_other_data(tmp_path):
    text = TIME + 'position: {column: x}\ncurrent: {from_name: "_([0-9.]+)A"}\nforce: {column: F}\n'
    assert failure(tmp_path, "t,x,F\n0,1,2\n", text) == "map.yaml: from_name '_([0-9.]+)A' finds no number in 'log.csv'"
    assert "log.mat: not a mat file" in failure(tmp_path, "x,y\n" * 200, name="log.mat")


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        ("tme: {column: t}\n" + SIGNALS, "unknown key 'tme'; did you mean 'time'"),
        (SIGNALS, "give one of 'time' and 'rate'"),
        (MAPPED + "rate: 5\n", "give one of 'time' and 'rate'"),
        (
            TIME + "position: {column: x}\ncurrent: {column: i}\n",
            "key 'force' is missing; expected a mapping with one of column",
        ),
        ("rate: -5\n" + SIGNALS, "rate is -5; expected a rate above 0 Hz"),
        ("rate: fast\n" + SIGNALS, "rate is 'fast'; expected a rate above 0 Hz, or {column: NAME}"),
        ("time: t\n" + SIGNALS, "time is 't'; expected a mapping with its column"),
        ("time: {column: -1}\n" + SIGNALS, "time: column is -1; expected a name, or a number from 0"),
        ("delimiter: ';;'\n" + MAPPED, "delimiter: found ';;'; expected one character"),
        ("decimal: 3\n" + MAPPED, "decimal is 3; expected one of ., ,"),
        ("header_lines: -1\n" + MAPPED, "header_lines is -1; expected a whole number from 0"),
        ("format: xls\n" + MAPPED, "format is 'xls'; expected one of csv, json, mat"),
        ("names: x\n" + MAPPED, "names is 'x'; expected a list of texts"),
        ("rows: 3\n" + MAPPED, "rows is 3; expected a path"),
        (MAPPED + "temperature: {}\n", "expected a mapping with one of column, constant and from_name"),
        (MAPPED + "temperature: {column: T, scale: 0}\n", "scale is 0; expected the factor from the logged unit to SI"),
        (MAPPED + "temperature: {constant: hot}\n", "temperature: constant is 'hot'; expected a number"),
        (MAPPED + "temperature: {from_name: '['}\n", "expected a regular expression ("),
        (MAPPED + "temperature: {from_name: 'A'}\n", "expected a regular expression with a group"),
        ("position: {constant: 0}\ncurrent: {constant: 0}\nforce: {constant: 0}\n" + TIME, "no signal has a column"),
    ],
)
def test_bad_mapping_is_one_clear_line(tmp_path, text, phrase):
    message = failure(tmp_path, "t,x,i,F,T\n0,1,2,3,4\n", text)
    assert phrase in message
    assert message.startswith("map.yaml")


def test_template_is_a_mapping_and_so_is_all_that_it_comments_out(tmp_path):
    plain = mapping(tmp_path, TEMPLATE)
    assert plain.signals["position"] == LogColumn("x_mm", given_scale=0.001)
    keys = set(re.findall(r"^# ?([a-z_]+): ", TEMPLATE, flags=re.MULTILINE))
    layout = {"format", "delimiter", "decimal", "header_lines", "names", "blank", "rows", "dbc", "time", "rate"}
    assert keys == layout | {"position", "current", "temperature", "speed", "acceleration"}
    for line in re.findall(r"^# ((?:[a-z_]+): .*)$", TEMPLATE, flags=re.MULTILINE):
        key = line.partition(":")[0]
        out = (f"{key}:", "time:" if key == "rate" else "#")
        mapping(tmp_path, "\n".join([*(row for row in TEMPLATE.splitlines() if not row.startswith(out)), line]))
