"""Text tables of test benches and loggers: blocks with headers of their own, rows that number columns, ragged rows."""

import json

import numpy as np
import pytest
from log_examples import CURRENT, F, T, X, assert_recording

from ces_cli.main import main
from ces_data.logs import csv
from ces_data.logs.log_import import import_log, to_recording
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.mapping.proposals import propose_mapping
from ces_identify.prepare.sampling import longest_gap_s
from ces_observer.errors import RecordingError

NAMES, UNITS, SCALES = ("Time", "Displacement", "Force", "Current"), ("s", "mm", "kN", "A"), (1.0, 1e3, 1e-3, 1.0)
COLUMNS = dict(zip(NAMES, (T, X, F, CURRENT), strict=True))
PARTS = np.array_split(np.arange(len(T)), 3)


def bench(rows, times, units=UNITS, order=(0, 1, 2, 3), title="block"):
    """Return the text of a block as a bench's controller writes it, `times` [s] in its first column."""
    scales = [
        scale * {"kN": 1.0, "N": 1e3, "mm": 1.0, "m": 1e-3}.get(unit, 1.0)
        for scale, unit in zip(SCALES, units, strict=True)
    ]
    columns = [times, *(COLUMNS[name][rows] for name in NAMES[1:])]
    lines = [f"Data Header:\t\t\tTime:\t{times[0]:.3f}\t{title}", "Station Name: bench 2.cfg"]
    lines += ["\t".join(NAMES[i] for i in order), "\t".join(units[i] for i in order)]
    lines += ["\t".join(repr(float(scales[i] * columns[i][k])) for i in order) for k in range(len(rows))]
    return "\n\n" + "\n".join(lines) + "\n"


def write(folder, *blocks):
    (folder / "bench.dat").write_text("MTS793|BTW|ENU|1|0|.|/|:|1|0|0|A\n" + "".join(blocks))
    return folder / "bench.dat"


@pytest.mark.parametrize("chunk", [csv.MAX_ROWS, 100])
@pytest.mark.parametrize("sample", [csv.SAMPLE, 1])
def test_blocks_with_headers_are_one_recording_with_gaps(tmp_path, monkeypatch, chunk, sample):
    """The second block has other units, the third another order; the third begins again at zero."""
    monkeypatch.setattr(csv, "MAX_ROWS", chunk)
    monkeypatch.setattr(csv, "SAMPLE", sample)
    a, b, c = PARTS
    first, third = bench(a, T[a], title="one"), bench(c, T[c] - T[c][0], title="three", order=(0, 3, 1, 2))
    path = write(tmp_path, first, bench(b, T[b] + 5.0, ("s", "m", "N", "A"), title="two"), third)
    proposal = propose_mapping(path)
    assert proposal.doubts == ()
    recording = proposal.read()
    end, step = T[b][-1] + 5.0, T[1] - T[0]
    times = np.concatenate([T[a], T[b] + 5.0, T[c] - T[c][0] + end + 1.0])
    for name, wanted in (("position", X), ("current", CURRENT), ("force", F)):
        channel = recording.channel(name)
        np.testing.assert_allclose(channel.values, wanted, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(channel.stamps_ns, times * 1e9, atol=1000)
    steps = np.diff(recording.channel("position").stamps_ns) * 1e-9
    assert (steps > longest_gap_s(1.0 / step)).sum() == 2
    note = next(note for note in proposal.log.notes if "blocks" in note)
    assert note.startswith("3 blocks of rows with a header each, read as one recording with gaps between them (line ")
    assert "one'" in note
    assert "three'" in note


def test_one_block_is_taken_by_its_number(tmp_path):
    a, b, _ = PARTS
    path = write(tmp_path, bench(a, T[a], title="one"), bench(b, T[b], ("s", "m", "N", "A"), title="two"))
    for rows, part in (("block(1)", a), ("block(2)", b)):
        (tmp_path / "map.yaml").write_text(f"rows: {rows}\n{propose_mapping(path).text}")
        recording = import_log(path, load_dyno_mapping(tmp_path / "map.yaml"))
        np.testing.assert_allclose(recording.channel("position").values, X[part], rtol=1e-12, atol=1e-15)
    (tmp_path / "map.yaml").write_text(f"rows: block(3)\n{propose_mapping(path).text}")
    with pytest.raises(RecordingError, match=r"rows is 'block\(3\)'; expected block\(1\) to block\(2\)"):
        import_log(path, load_dyno_mapping(tmp_path / "map.yaml"))


def test_blocks_that_all_begin_at_zero_come_one_after_the_other(tmp_path, capsys):
    path = write(tmp_path, *(bench(part, T[part] - T[part][0]) for part in PARTS))
    assert main(["import", str(path), "--out", str(tmp_path / "bag")]) == 0
    assert "all signals pause" in capsys.readouterr().err
    at = propose_mapping(path).read().channel("position").stamps_ns
    assert (np.diff(at) >= 10**9).sum() == 2


@pytest.mark.parametrize("again", [False, True])
def test_where_the_names_alone_come_again_the_time_goes_on_if_it_does(tmp_path, again):
    names, blocks = "time_s,position_mm,current_A,force_N\n", []
    for part in PARTS:
        rows = zip(T[part] - again * T[part][0], 1e3 * X[part], CURRENT[part], F[part], strict=True)
        blocks.append(names + "".join(f"{t:.4f},{x:.9f},{i:.9f},{f:.9f}\n" for t, x, i, f in rows))
    (tmp_path / "log.csv").write_text("".join(blocks))
    steps = np.diff(propose_mapping(tmp_path / "log.csv").read().channel("force").stamps_ns)
    assert (steps >= 10**9).sum() == 2 * again
    assert again or steps.max() < 10**7


def test_other_blocks_are_refused_with_their_line(tmp_path):
    a, b, _ = PARTS
    other = bench(b, T[b]).replace("Current", "Pressure")
    with pytest.raises(RecordingError, match=r"bench.dat:\d+: the header of a block names Time, .*Pressure.*cut the"):
        propose_mapping(write(tmp_path, bench(a, T[a]), other))
    degrees = bench(b, T[b], ("s", "mm", "degC", "A"))
    with pytest.raises(RecordingError, match="'Force' is in 'degC', in the first block in 'kN'; cut the file"):
        propose_mapping(write(tmp_path, bench(a, T[a]), degrees))


HEAD = '"Time","Distance","Shock","Valve Curr","Load Cell"\n"s","km","mm","A","N"\n'


@pytest.mark.parametrize(
    "numbering", ['"1","2","3","4","5"\n\n', '"0","1","2","3","4"\n', '"200","200","200","200","200"\n']
)
def test_a_row_that_numbers_the_columns_is_no_data(tmp_path, numbering):
    rows = [
        f'"{t!r}","0.0","{1e3 * x!r}","{i!r}","{f!r}"'
        for t, x, i, f in zip(*map(list, (T, X, CURRENT, F)), strict=True)
    ]
    text = HEAD + numbering + "\n".join(rows).replace("np.float64(", "").replace(")", "") + "\n"
    (tmp_path / "aim.csv").write_text('"Format","AiM CSV File"\n"Sample Rate","200"\n\n' + text)
    proposal = propose_mapping(tmp_path / "aim.csv")
    assert proposal.doubts == ()
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False)


RAGGED = {
    "a name with a comma": ("t,x, rear,F,i,T\n0,1,5,0,20\n1,2,6,0,20\n", "line 1 has 6 names, the rows have 5 cells"),
    "a column without a name": ("x,i,F\n0,1,0,5\n1,2,0,6\n", "line 1 has 3 names, the rows have 4 cells"),
    "decimal commas": (
        "t,x,i,F,T\n0,1,5,0,20\n1,2,6,0,9,20\n",
        ":3: the line has 6 cells, others have 5; a decimal comma, as in",
    ),
    "a text": (
        "t,x,i,F,n\n0,1,5,0,ok\n1,2,6,0,ok, warm\n",
        ":3: the line has 6 cells, others have 5; a text with ',' in it, as near 'ok'",
    ),
    "a cell is lost": (
        "t,x,i,F,T\n0,1,5,0,20\n1,2,6,20\n2,2,6,1,20\n",
        ":3: the line has 4 cells, others have 5; write ','",
    ),
}


@pytest.mark.parametrize("kind", RAGGED)
def test_rows_that_do_not_fit_the_names_are_refused_with_the_line(tmp_path, kind):
    text, message = RAGGED[kind]
    (tmp_path / "log.csv").write_text(text)
    (tmp_path / "map.yaml").write_text(
        "time: {column: t}\nposition: {column: x}\ncurrent: {column: i}\nforce: {column: F}\n"
    )
    with pytest.raises(RecordingError) as caught:
        import_log(tmp_path / "log.csv", load_dyno_mapping(tmp_path / "map.yaml"))
    assert message in str(caught.value)


def test_what_the_refusal_of_names_advises_works(tmp_path):
    text = RAGGED["a name with a comma"][0]
    (tmp_path / "log.csv").write_text(text)
    signals = "time: {column: t}\nposition: {column: x, unit: mm}\ncurrent: {column: i}\nforce: {column: F}\n"
    (tmp_path / "map.yaml").write_text('names: [t, "x, rear", F, i, T]\n'.replace("x, rear", "x") + signals)
    recording = import_log(tmp_path / "log.csv", load_dyno_mapping(tmp_path / "map.yaml"))
    assert recording.channel("force").values.tolist() == [5.0, 6.0]


def test_names_of_several_words_between_wide_blanks(tmp_path):
    rows = "\n".join(f"  {t:.4f}  {1e3 * x:.9f}  {i:.9f}  {f:.9f}" for t, x, i, f in zip(T, X, CURRENT, F, strict=True))
    (tmp_path / "log.dat").write_text(
        f"  Running Time  Axial Stroke (mm)  Valve Current (A)  Axial Force (N)\n{rows}\n"
    )
    proposal = propose_mapping(tmp_path / "log.dat")
    assert proposal.doubts == ()
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False, rtol=1e-6)


@pytest.mark.parametrize(("exponent", "minus"), [("D", "-"), ("d", "-"), ("e", "\u2212")])
def test_numbers_as_fortran_and_typesetting_write_them(tmp_path, exponent, minus):
    rows = "\n".join(
        ",".join(f"{value:.12e}" for value in row).replace("e", exponent).replace("-", minus)
        for row in zip(T, X, CURRENT, F, strict=True)
    )
    (tmp_path / "log.csv").write_text(f"time_s,stroke_m,current_A,force_N\n{rows}\n", encoding="utf-8")
    proposal = propose_mapping(tmp_path / "log.csv")
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False)


def test_zero_bytes_of_a_serial_line_are_named_by_their_place(tmp_path):
    lines = ["time_s,stroke_mm,current_A,force_N", *(f"{k / 500},{k % 7},0.5,{k % 5}" for k in range(900))]
    lines[700] = "1.3\0\0" + lines[700][3:]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(RecordingError, match=r"log.csv:701: 2 zero bytes from byte 4 of the line on, .* tr -d"):
        propose_mapping(tmp_path / "log.csv")


JAVA = ["Wed Aug 05 23:59:59.500 GMT+01:00 2026", "Thu Aug 06 00:00:00.500 GMT+01:00 2026"]
MAPPED = "position: {column: x, unit: mm}\ncurrent: {column: i}\nforce: {column: F}\n"


@pytest.mark.parametrize(
    ("pattern", "cells"),
    [
        ("%a %b %d %H:%M:%S.%f GMT%z %Y", JAVA),
        ("", JAVA),
        ("", ["Wed Aug  5 22:59:59.500 2026", "Wed Aug  5 23:00:00.500 2026"]),
        ("%H%M%S.%f", ["235959.500", "000000.500"]),
        ("%d.%m.%Y %H:%M:%S.%f %z", ["05.08.2026 23:59:59.500 +0100", "06.08.2026 00:00:00.500 +0100"]),
    ],
)  # fmt: skip
def test_dates_by_pattern_and_as_c_writes_them(tmp_path, pattern, cells):
    date = f', date: "{pattern}"' if pattern else ""
    (tmp_path / "map.yaml").write_text(f"time: {{column: when{date}}}\n{MAPPED}")
    (tmp_path / "log.csv").write_text(f"when,x,i,F\n{cells[0]},1,0,5\n{cells[1]},2,0,6\n")
    stamps = import_log(tmp_path / "log.csv", load_dyno_mapping(tmp_path / "map.yaml")).channel("force").stamps_ns
    assert np.diff(stamps).tolist() == [10**9]
    if "H%M" not in pattern:
        assert stamps[0] == 1_785_970_799_500_000_000  # 2026-08-05 22:59:59.5 UTC


LINES = list(zip(*(values.tolist() for values in (T, 1e3 * X, CURRENT, F)), strict=True))
QUOTED = "".join(",".join(f'"{number:.9g}"'.replace(".", ",") for number in row) + "\n" for row in LINES)
KINDS = {
    "a decimal comma in quotes, between commas": ("a.csv", "Zeit_s,Weg_mm,Strom_A,Kraft_N\n" + QUOTED),
    "durations as MATLAB writes them": (
        "a.csv",
        "Time,position_mm,current_A,force_N\n" + "".join(f"{t:.9g} sec,{x!r},{i!r},{f!r}\n" for t, x, i, f in LINES),
    ),
    "a rate in the first row of the first column": (
        "a.csv",
        "fs_Hz,position_mm,current_A,force_N\n"
        + "".join(f"{'' if k else 500},{x!r},{i!r},{f!r}\n" for k, (_, x, i, f) in enumerate(LINES)),
    ),
    "columns of JSON with their units beside": (
        "a.json",
        json.dumps(
            {
                n: {"data": c, "unit": u}
                for n, c, u in zip(
                    ("t", "position", "current", "force"), zip(*LINES, strict=True), ("s", "mm", "A", "N"), strict=True
                )
            }
        ),
    ),
    "a JSON value in each line, with names inside": (
        "a.jsonl",
        "".join(
            json.dumps({"t_s": t, "rig": {"position_mm": x, "current_A": i}, "force_N": f}) + "\n"
            for t, x, i, f in LINES
        ),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_tables_of_other_programs(tmp_path, kind):
    name, text = KINDS[kind]
    (tmp_path / name).write_text(text)
    proposal = propose_mapping(tmp_path / name)
    assert proposal.doubts == ()
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False, rtol=1e-8)


FAULTS = {
    "a unit of percent": (
        "a.csv",
        "t_s,x_mm,current_%,F_N\n" + "".join(f"{t!r},{x!r},{40 * i!r},{f!r}\n" for t, x, i, f in LINES),
        "is stated as '%'",
    ),
    "two marks of decimals": (
        "a.csv",
        "t_s;x_mm;i_A;F_N\n"
        + "".join(
            f"{t:.3f};{x:.4f};{i:.3f};{f:.1f}\n".replace(f"{x:.4f}", f"{x:.4f}".replace(".", ","))
            for t, x, i, f in LINES
        ),
        "x_mm' is '.*'; expected decimals by '.' as elsewhere",
    ),
    "a pointer of Git LFS": (
        "a.csv",
        "version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 9\n",
        "git lfs pull",
    ),
    "a short name without a unit": (
        "a.csv",
        "t,x_mm,i,F_N\n" + "".join(f"{t!r},{x!r},{i + 0.01 * t!r},{f!r}\n" for t, x, i, f in LINES),
        "'i' may be it, but that is not certain: named 'i'",
    ),
    "a value a row": (
        "a.csv",
        "elapsed,topic,value\n" + "0.0,/a.pos,1.5\n0.1,/a.pos,2.5\n0.0,/a.force,9.5\n",
        "each row holds",
    ),
    "a counter in ms": (
        "a.csv",
        "ms,x_mm,F_N\n" + "65534,1,2\n65535,2,3\n0,3,4\n1,4,5\n",
        "a counter of 16 bits began again",
    ),
    "a line that is cut": ("a.jsonl", '{"t_s": 0.0}\n{"t_s": 0.1}\n{"t_', r"a.jsonl:3: not a JSON value .*jq -s"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_no_table_of_signals_says_why(tmp_path, fault):
    name, text, message = FAULTS[fault]
    (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError, match=message):
        propose_mapping(tmp_path / name).read()
