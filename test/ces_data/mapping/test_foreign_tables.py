"""Text tables as other programs write them: headers, comments, clocks and spellings that `ces import` finds."""

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
        "% " + NAMES.replace(",", "\t") + TABLE.replace(",", "\t"),
        "time,position,current,force\nRT,LVDT,Clamp,HBM\n[s],[mm],[A],[N]\n" + TABLE,
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
    ids=[
        "comments",
        "named",
        "percent",
        "lines",
        "above",
        "pandas",
        "waveform",
        "labview",
        "dspace",
        "express",
        "inside",
        "state",
        "remark",
        "groups",
        "line_breaks",
    ],
)
def test_headers_and_comments_of_other_programs(tmp_path, text):
    assert_recording(read(tmp_path, text), slow=False)


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be", "utf-16"])
def test_utf16_with_and_without_its_mark(tmp_path, encoding):
    assert_recording(read(tmp_path, NAMES + TABLE, encoding=encoding), slow=False)


@pytest.mark.parametrize(
    ("cells", "start"),
    [
        (clock("%m/%d/%Y %I:%M:%S.%f %p"), NOON),
        ([cell.replace("05/01", "5/13") for cell in clock("%m/%d/%Y %H:%M:%S.%f")], NOON.replace(day=13)),
        ([cell.replace("01/05", "13/5") for cell in clock("%d/%m/%Y %H:%M:%S.%f")], NOON.replace(day=13)),
        (clock("%Y/%m/%d %H:%M:%S.%f"), NOON),
        (clock("%I:%M:%S.%f %p"), NOON.replace(year=1970, month=1, day=1)),
        (clock("0 days %H:%M:%S.%f"), NOON.replace(year=1970, month=1, day=1)),
        (clock("%M:%S.%f"), datetime(1970, 1, 1, 0, 59, 57, tzinfo=UTC)),
        (clock("%d-%b-%Y %H:%M:%S.%f"), NOON),
        ([cell.replace("May", "Mai") for cell in clock("%d. %B %Y %H:%M:%S.%f")], NOON),
        ([f"{cell[:-7]}:{cell[-6:-3]}" for cell in clock("%H:%M:%S.%f")], NOON.replace(year=1970, month=1, day=1)),
    ],
    ids=[
        *("american", "month_first", "day_first", "year_first", "clock", "timedelta", "minutes"),
        *("matlab", "german_month", "controller"),
    ],
)
def test_clocks_and_dates(tmp_path, cells, start):
    recording = read(tmp_path, with_times(cells))
    assert_recording(recording, start_ns=round(start.timestamp() * 1e9), slow=False)


@pytest.mark.parametrize(
    ("count_per_s", "zero", "text"),
    [
        (1 / 86_400, 25_569, "days since 30 December 1899, as Excel counts"),
        (1 / 86_400, 719_529, "days since the year 0, as MATLAB counts"),
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


def test_a_date_beside_a_time_of_day_leaves_the_time_of_day(tmp_path):
    cells = [f"2024-05-01,{cell}" for cell in clock("%H:%M:%S.%f")]
    recording = read(tmp_path, with_times(cells, "Date,Time"))
    assert_recording(recording, start_ns=(12 * 3600 + 59 * 60 + 57) * 10**9, slow=False)


@pytest.mark.parametrize("spelling", ["NA", "#N/A", "-", "---", "null", "1.#QNAN", "#DIV/0!", "n/a", "#WERT!"])
def test_a_missing_number_in_any_spelling_is_a_missing_sample_and_counted(tmp_path, spelling):
    cells = CELLS[500].split(",")
    proposal = propose(
        tmp_path, NAMES + "\n".join([*CELLS[:500], ",".join([*cells[:3], spelling]), *CELLS[501:]]) + "\n"
    )
    recording = to_recording(proposal.log, proposal.mapping)
    assert len(recording.channel("force")) == len(T) - 1 and len(recording.channel("position")) == len(T)
    assert "blank cells are missing samples (1 of force)" in proposal.found


def semicolons(*columns):
    """Return a table with decimal commas from columns of cells."""
    return NAMES.replace(",", ";") + "\n".join(";".join(row) for row in zip(*columns, strict=True)) + "\n"


def commas(values):
    return [f"{value:.6f}".replace(".", ",") for value in values]


def thousands(values, mark):
    return [f"{round(10 * value):,}".replace(",", mark) for value in values]


def whole(values):
    return [str(round(1e3 * value)) for value in values]


@pytest.mark.parametrize(
    ("table", "mark"),
    [
        (semicolons(*map(commas, SIGNALS[:3]), thousands(F, ".")), "."),
        (semicolons(*map(whole, SIGNALS[:3]), thousands(F, ".")).replace("time_s", "time_ms"), "."),
        (semicolons(*map(whole, SIGNALS[:3]), thousands(F, ",")).replace("time_s", "time_ms"), ","),
    ],
    ids=["decimal_commas", "points", "commas"],
)
def test_thousands_separators_are_no_decimal_marks(tmp_path, table, mark):
    assert max(np.abs(F)) > 100.0  # or else nothing is separated
    proposal = propose(tmp_path, table)
    first = next(cell for cell in thousands(F, mark) if mark in cell)
    assert f"is {first!r}; expected a number without thousands separators" in proposal.doubts[0]
    assert proposal.doubts[0] in proposal.faults


def test_decimal_points_in_one_column_among_commas_are_refused(tmp_path):
    proposal = propose(tmp_path, semicolons(*map(commas, SIGNALS[:3]), [f"{force:.1f}" for force in F]))
    assert "expected decimals by ',' as elsewhere" in proposal.doubts[0]


def interleave(later_s):
    columns = (T, 1e3 * X, T + later_s, CURRENT, T + later_s, F)
    rows = ("\n".join(",".join(map(repr, row)) for row in np.column_stack(columns).tolist())) + "\n"
    return "t_x [s],x [mm],t_i [s],i [A],t_F [s],F [N]\n" + rows


def test_signals_with_times_of_their_own_are_refused_if_these_differ(tmp_path):
    assert_recording(read(tmp_path, interleave(0.0)), slow=False)
    doubts = propose(tmp_path, interleave(0.0007)).doubts
    assert "columns 't_x [s]' and 't_i [s]' are both times and differ" in doubts[0]


def test_a_position_too_slow_for_its_motion_is_named(tmp_path):
    rows = [row.split(",") for row in CELLS]
    text = "\n".join(",".join([t, x if k % 60 == 0 else "", i, f]) for k, (t, x, i, f) in enumerate(rows))
    doubts = propose(tmp_path, NAMES + text + "\n").doubts
    assert doubts[0].startswith("position: 'position_mm' is named like it, but jumps like noise from sample to sample")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (NAMES + TABLE + "9.5,1.0,0.3,oops\n", "force: line 1202: column 'force_N' is 'oops'; expected a number"),
        (
            NAMES + TABLE + '9.5,1.0,0.3,"1,234.5"\n',
            "line 1202: column 'force_N' is '1,234.5'; expected a number without thousands",
        ),
        (NAMES + TABLE + NAMES, "position: line 1202: column 'position_mm' is 'position_mm'; expected a number"),
        (NAMES + TABLE + "END OF DATA\n", "line 1202: column 'position_mm' is missing; the line has 1 cells"),
        (
            with_times(clock("%m/%d/%Y %H:%M:%S.%f")),
            "may be month/day or day/month; set date: '%m/%d/%Y %H:%M:%S.%f' or",
        ),
        (with_times(clock("%Y-%m-%d %H:%M:%S")), "different times in 1200 rows, too coarse"),
        (with_times([f"{0.004 * (k // 2):.3f}" for k in range(len(T))]), "only 600 different times in 1200 rows"),
        (with_times(clock("%H h %M min %S.%f")), "column 'Time' is '12 h 59 min 57.000000'; expected a number"),
        (with_times([f"{t / 86_400 + 0.5:.12f}" for t in T]), "its steps are 2.3"),
        (NAMES + "\n".join(CELLS[::-1]) + "\n", "the rows are in descending order of time; sort them by time"),
        ("Dear reader,\nthis is a letter.\n", "no cell from line 2 on is a number; expected rows of numbers"),
    ],
    ids=[
        "word",
        "thousands",
        "header_again",
        "footer",
        "ambiguous",
        "coarse",
        "pairs",
        "odd",
        "days",
        "descending",
        "letter",
    ],
)
def test_what_cannot_be_read_is_named_and_nothing_is_written(tmp_path, capsys, text, message):
    (tmp_path / "log.csv").write_text(text)
    assert main(["import", str(tmp_path / "log.csv"), "--out", str(tmp_path / "bag")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "bag").exists()


def test_a_column_that_occurs_twice_is_named_with_its_number(tmp_path):
    rows = [f"{row},{row.rsplit(',', 1)[1]}" for row in CELLS]
    proposal = propose(tmp_path, NAMES.strip() + ",force_N\n" + "\n".join(rows) + "\n")
    assert proposal.doubts == ("force: the same motion as column 4 (force): take the one that is measured",)


def test_rows_that_begin_with_blank_cells_keep_their_header(tmp_path):
    cells = [row.split(",") for row in CELLS]
    rows = [f"{t},,{i}," if k < 3 else f"{t},{x},{i},{f}" for k, (t, x, i, f) in enumerate(cells)]
    proposal = propose(tmp_path, NAMES + "\n".join(rows) + "\n")
    assert proposal.log.names == ("time_s", "position_mm", "current_A", "force_N")
    assert "blank cells are missing samples (3 of position, 3 of force)" in proposal.found
