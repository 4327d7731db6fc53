"""Text tables as other programs write them: headers, comments, clocks and spellings that `ces import` finds."""

import json
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from log_examples import CURRENT, F, T, X, assert_recording

from ces_cli.main import main
from ces_data.logs.log_import import to_recording
from ces_data.mapping.proposals import propose_mapping

NAMES = "time_s,position_mm,current_A,force_N\n"
SIGNALS = (T, 1e3 * X, CURRENT, F)
CELLS = [f"{t!r},{1e3 * x!r},{i!r},{f!r}" for t, x, i, f in zip(*(a.tolist() for a in (T, X, CURRENT, F)), strict=True)]
TABLE = "\n".join(CELLS) + "\n"
NOON = datetime(2024, 5, 1, 12, 59, 57, tzinfo=UTC)  # the clock passes 1 PM


def propose(tmp_path, text, name="log.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return propose_mapping(path)


def read(tmp_path, text, **options):
    proposal = propose(tmp_path, text, **options)
    assert proposal.doubts == ()
    return to_recording(proposal.log, proposal.mapping)


def with_times(cells, name="Time"):
    rows = [f"{time},{row.split(',', 1)[1]}" for time, row in zip(cells, CELLS, strict=True)]
    return f"{name},position_mm,current_A,force_N\n" + "\n".join(rows) + "\n"


def clock(form):
    return [(NOON + timedelta(seconds=t)).strftime(form) for t in T]


@pytest.mark.parametrize(
    "text",
    [
        "# damper 17\n# " + NAMES + NAMES + TABLE,
        "# damper 17\n# " + NAMES.replace(",", " ") + TABLE.replace(",", " "),
        "time,position,current,force\nRT,LVDT,Clamp,HBM\n[s],[mm],[A],[N]\n" + TABLE,
        '"path","","Time","Root/Stroke","Root/Current","Root/Force"\n"descr","","t","x","i","F"\n"unit","","s","mm","A","N"\n'
        + '"values"\n'
        + "".join(f",,{row}\n" for row in CELLS),
        "Writer_Version,2\n***End_of_Header***,\nY_Unit_Label,mm,A,N,\nX0,0,0,0,\n***End_of_Header***,,,,\n"
        "X_Value,Position,Current,Force,Comment\n" + TABLE,
        "Model,X1\nVertical Units,mm,A,N\ntime_s,position,current,force\n" + TABLE,
        "s,mm,A,N\ntime,position,current,force\n" + TABLE,
        ",position,current,force\n,mm,A,N\ntime,,,\n" + TABLE,
        "waveform,[0],[1],[2]\nt0,1.5.2024 12:00:00,,\ndelta t,0.1,0.1,0.1\n" + NAMES + TABLE,
        "Writer_Version,2\n***End_of_Header***,\nSamples,9,9,9,\nY_Unit_Label,mm,A,N,\nX0,0,0,0,\n***End_of_Header***,,,,\n"
        "X_Value,Position [mm],Current,Force,Comment\n" + TABLE,
        '"XAxis","Model Root/Stroke [mm]/Out1","Model Root/Valve Current [A]/Out1","Model Root/Force [N]/Out1"\n'
        + TABLE,
        "Log\nTime (s) - Voltage_0,Displacement (mm) - Voltage_0,Current (A) - Amp,Force (N) - Bridge\n" + TABLE,
        NAMES + "\n".join([*CELLS[:500], "# marker: bump", *CELLS[500:]]) + "\n",
        "Operator,Meier,,,\nSerial,12345,,,\nState," + NAMES + "\n".join("RUN," + row for row in CELLS) + "\n",
        NAMES.strip() + ",Remark\n" + "\n".join([f"{CELLS[0]},warm", *(row + "," for row in CELLS[1:])]) + "\n",
        "Rig,Damper,Damper,Damper\n" + NAMES + TABLE,
        '"Time\n[s]","Position\n[mm]","Current\n[A]","Force\n[N]"\n' + TABLE,
    ],
)
def test_headers_and_comments_of_other_programs(tmp_path, text):
    assert_recording(read(tmp_path, text), slow=False)
    for encoding in ("utf-16", "utf-16-be"):  # with and without its mark
        assert_recording(read(tmp_path, text, encoding=encoding), slow=False)


@pytest.mark.parametrize(
    ("cells", "start"),
    [
        (clock("%m/%d/%Y %I:%M:%S.%f %p"), NOON),
        ([cell.replace("05/01", "5/13") for cell in clock("%m/%d/%Y %H:%M:%S.%f")], NOON.replace(day=13)),
        ([cell.replace("01/05", "13/5") for cell in clock("%d/%m/%Y %H:%M:%S.%f")], NOON.replace(day=13)),
        (clock("%I:%M:%S.%f %p"), NOON.replace(year=1970, month=1, day=1)),
        (clock("0 days %H:%M:%S.%f"), NOON.replace(year=1970, month=1, day=1)),
        (clock("%M:%S.%f"), datetime(1970, 1, 1, 0, 59, 57, tzinfo=UTC)),
        (clock("%Y/%m/%d %H:%M:%S.%f"), NOON),
        (clock("%d-%b-%Y %H:%M:%S.%f"), NOON),
        (clock("%Y-%m-%dT%H:%M:%S.%fZ"), NOON),
        (clock("1.5.2024 %H:%M:%S.%f"), NOON),
        (clock("01.05.24 %H:%M:%S.%f"), NOON),
        ([cell.replace("May", "Mai") for cell in clock("%d. %B %Y %H:%M:%S.%f")], NOON),
        ([f"{cell[:-7]}:{cell[-6:-3]}" for cell in clock("%H:%M:%S.%f")], NOON.replace(year=1970, month=1, day=1)),
    ],
)
def test_clocks_and_dates(tmp_path, cells, start):
    recording = read(tmp_path, with_times(cells))
    assert_recording(recording, start_ns=round(start.timestamp() * 1e9), slow=False)


@pytest.mark.parametrize(
    ("count_per_s", "zero", "text"),
    [
        (1 / 86_400, 25_569, "days since 30 December 1899, as Excel counts"),
        (1, 2_082_844_800, "s since 1904, as LabVIEW counts"),
    ],
)
def test_numbers_that_count_from_a_date_and_the_file_that_says_so(tmp_path, count_per_s, zero, text):
    numbers = zero + (NOON.timestamp() + T) * count_per_s
    proposal = propose(tmp_path, with_times([f"{number:.12f}" for number in numbers]))
    recording = to_recording(proposal.log, proposal.mapping)  # whose mapping is parsed from the proposed text
    stamps = recording.channel("force").stamps_ns - round(NOON.timestamp() * 1e9)
    np.testing.assert_allclose(stamps, T * 1e9, atol=20_000)  # a number of this size resolves 10 us
    assert f"time from 'Time' [{text}]" in proposal.found


def test_missing_numbers_in_any_spelling_are_missing_samples_and_counted(tmp_path):
    rows = list(CELLS)
    for at, spelling in ((500, "NA"), (600, "---"), (700, "1.#QNAN"), (800, "#DIV/0!")):
        rows[at] = f"{rows[at].rpartition(',')[0]},{spelling}"
    proposal = propose(tmp_path, NAMES + "\n".join(rows) + "\n")
    recording = to_recording(proposal.log, proposal.mapping)
    assert len(recording.channel("force")) == len(T) - 4 and len(recording.channel("position")) == len(T)
    assert "blank cells are missing samples (4 of force)" in proposal.found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (NAMES + TABLE + "9.5,1.0,0.3,oops\n", "force: line 1202: column 'force_N' is 'oops'; expected a number"),
        (NAMES + TABLE + "Mean,1.0,0.3,5.0\n", "'time_s' is 'Mean'; expected a number (a line that is no row, as of a"),
        (NAMES + TABLE + "END OF DATA\n", "log.csv:1202: the line has 1 cells, others have 4; write"),
        (with_times(clock("%m/%d/%Y %H:%M:%S.%f")), "month/day or day/month; set date: '%m/%d/%Y %H:%M:%S.%f' or"),
        (with_times(clock("%Y-%m-%d %H:%M:%S")), "different times in 1200 rows, too coarse"),
        (with_times([f"{0.004 * (k // 2):.3f}" for k in range(len(T))]), "only 600 different times in 1200 rows"),
        (with_times(clock("%H h %M min %S.%f")), "column 'Time' is '12 h 59 min 57.000000'; expected a number"),
        (with_times([f"{t / 86_400 + 0.5:.12f}" for t in T]), "its steps are 2.3"),
        (NAMES + "\n".join(CELLS[::-1]) + "\n", "the newest row is first; reverse the rows"),
        (NAMES + CELLS[0] + "\n", "position: 'position_mm' holds too few numbers (1 in 1 rows; expected at least 3)"),
        ("\0\1\2" * 99, "not a text table, but binary data"),
        ("PK\3\4\0\0" * 99, "but an Excel workbook or a zip archive; save the sheet as CSV"),
        ("Dear reader,\nthis is a letter.\n", "a number, as 'this is a letter.' is none; expected rows of"),
        (
            "Time,Stroke\n" + "2024-05-01 12:00:00,1.5mm\n" * 99,
            "no cell from line 2 on is a number, as '1.5mm' is none",
        ),
        (with_times([round((64.5 + t) % 65.536, 6) for t in T], "t_s"), "counter of 16 bits began again at zero"),
        (
            with_times([f"2024-10-27 02:59:{58 + t:06.3f}" if t < 2 else f"2024-10-27 02:00:{t - 2:06.3f}" for t in T]),
            "as where summer time ends; give --rate 500 (in a mapping, rate: in place of time), or cut it before",
        ),
        (with_times(clock("%Y-%jT%H:%M:%S.%f")), "or a date in a known form (a mapping gives another: date: '%Y-%jT"),
    ],
)
def test_what_cannot_be_read_is_named_and_nothing_is_written(tmp_path, capsys, text, message):
    (tmp_path / "log.csv").write_text(text)
    assert main(["import", str(tmp_path / "log.csv"), "--out", str(tmp_path / "bag")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "bag").exists()


def test_rows_that_begin_with_blank_cells_keep_their_header(tmp_path):
    cells = [row.split(",") for row in CELLS]
    rows = [f"{t},,{i}," if k < 3 else f"{t},{x},{i},{f}" for k, (t, x, i, f) in enumerate(cells)]
    proposal = propose(tmp_path, NAMES + "\n".join(rows) + "\n")
    assert proposal.log.names == ("time_s", "position_mm", "current_A", "force_N")
    assert "blank cells are missing samples (3 of position, 3 of force)" in proposal.found


def test_a_header_whose_lines_begin_with_names_above_rows_that_begin_blank(tmp_path):
    """LabVIEW's LVM without X columns."""
    head = "Channels,3,,,\nY_Unit_Label,mm,A,N,\nX0,0.0,0.0,0.0,\nX_Value,Position,Current,Force,Comment\n"
    (tmp_path / "log.lvm").write_text(head + "\n".join("," + row.split(",", 1)[1] for row in CELLS) + "\n")
    proposal = propose_mapping(tmp_path / "log.lvm", rate=500.0)
    assert proposal.doubts == ()
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False)


def table(*columns):
    """Return a table of these cells, separated by semicolons."""
    return NAMES.replace(",", ";") + "\n".join(";".join(row) for row in zip(*columns, strict=True)) + "\n"


COMMAS = [[f"{value:.6f}".replace(".", ",") for value in column] for column in SIGNALS[:3]]
WHOLE = [[str(round(1e3 * value)) for value in column] for column in SIGNALS[:3]]
THOUSANDS = [f"{round(10 * value):,}" for value in F]
SLOW = [
    ",".join([c if k % 60 == 0 or n != 1 else "" for n, c in enumerate(row.split(","))]) for k, row in enumerate(CELLS)
]


def two_times(later_s):
    """Return a table whose position has times of its own, earlier than those of the others."""
    cells = zip(*(values.tolist() for values in SIGNALS), strict=True)
    rows = "\n".join(f"{t},{x},{t + later_s},{i},{f}" for t, x, i, f in cells)
    return f"t_x [s],x [mm],t_i [s],i [A],F [N]\n{rows}\n"


DOUBTS = {
    "without thousands separators": table(*COMMAS, [cell.replace(",", ".") for cell in THOUSANDS]),
    "a number without thousands separators": table(*WHOLE, THOUSANDS).replace("time_s", "time_ms"),
    "expected decimals by ',' as elsewhere": table(*COMMAS, [f"{force:.1f}" for force in F]),
    "columns 't_x [s]' and 't_i [s]' are both times and differ": two_times(0.0007),
    "'position_mm' is named like it, but jumps like noise from sample to sample": NAMES + "\n".join(SLOW) + "\n",
    "force: the same motion as column 4 (force): take the one that is measured": NAMES.strip()
    + ",force_N\n"
    + "\n".join(f"{row},{row.rsplit(',', 1)[1]}" for row in CELLS),
}


@pytest.mark.parametrize("doubt", DOUBTS)
def test_what_is_doubtful_is_named(tmp_path, doubt):
    assert doubt in propose(tmp_path, DOUBTS[doubt]).doubts[0]


def test_the_same_time_may_be_there_twice(tmp_path):
    assert_recording(read(tmp_path, two_times(0.0)), slow=False)


def test_a_time_cut_to_seconds_is_no_other_time(tmp_path):
    rows = [f"{9.0 + t!r},{int(9.0 + t)},{row.split(',', 1)[1]}" for t, row in zip(T.tolist(), CELLS, strict=True)]
    text = "Time,header.stamp.secs,position_mm,current_A,force_N\n" + "\n".join(rows) + "\n"
    assert_recording(read(tmp_path, text), start_ns=9_000_000_000, slow=False)


@pytest.mark.parametrize(("name", "per_s"), [("time_min", 1 / 60), ("t_h", 1 / 3600)])
def test_minutes_and_hours_in_a_name_of_a_time(tmp_path, name, per_s):
    assert_recording(read(tmp_path, with_times([f"{t * per_s:.12f}" for t in T], name)), slow=False)


@pytest.mark.parametrize("coarse", [clock("%H:%M:%S"), [str(int(9 + t)) for t in T]])
def test_a_time_in_seconds_does_not_hide_a_finer_one(tmp_path, coarse):
    rows = [f"{c},{1e3 * t:.0f},{row.split(',', 1)[1]}" for c, t, row in zip(coarse, T, CELLS, strict=True)]
    text = "timestamp,ms,position_mm,current_A,force_N\n" + "\n".join(rows) + "\n"
    assert_recording(read(tmp_path, text), slow=False)


DATES = clock("%Y-%m-%dT%H:%M:%S.%fZ")
KEYS = ("time", "position_mm", "current_A", "force_N")
LISTS = dict(zip(KEYS, (DATES, *(values.tolist() for values in SIGNALS[1:])), strict=True))


@pytest.mark.parametrize(
    "tree", [LISTS, [dict(zip(KEYS, row, strict=True)) for row in zip(*LISTS.values(), strict=True)]]
)
def test_dates_in_json(tmp_path, tree):
    recording = read(tmp_path, json.dumps(tree), name="log.json")
    assert_recording(recording, start_ns=round(NOON.timestamp() * 1e9), slow=False)


def test_names_beside_a_matrix_of_json(tmp_path):
    rows = np.stack(SIGNALS, axis=1).tolist()
    text = json.dumps({"columns": ["time_s", *KEYS[1:]], "index": list(range(len(T))), "data": rows})
    assert_recording(read(tmp_path, text, name="log.json"), slow=False)


def test_a_cell_of_json_that_is_no_date_is_named(tmp_path):
    tree = {**LISTS, "time": [*DATES[:7], "noon", *DATES[8:]]}
    assert "row 7: column 'time' is 'noon'; expected a number, or a date like" in str(
        propose(tmp_path, json.dumps(tree), name="log.json").doubts[0]
    )
