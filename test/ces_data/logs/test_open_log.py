"""What every log that cannot be opened says: one line, and what to do."""

import json
import re
import sys

import pytest

from ces_data.logs.log_file import find_format, open_log
from ces_data.logs.log_import import import_log
from ces_data.logs.log_mapping import DynoMapping, parse_dyno_mapping
from ces_observer.errors import RecordingError

HEADS = {"log.mat": b"MATLAB 7.3 MAT-file".ljust(512)}


@pytest.mark.parametrize(
    ("name", "module", "package", "extra"),
    [
        ("log.mf4", "asammdf", "asammdf", "mdf"),
        ("log.mat", "h5py", "h5py", "mat73"),
        ("log.blf", "can", "python-can", "can"),
        ("log.asc", "cantools", "cantools", "can"),
        ("log.parquet", "pyarrow", "pyarrow", "parquet"),
    ],
)
def test_a_missing_library_is_one_line_with_the_extra(tmp_path, monkeypatch, name, module, package, extra):
    path = tmp_path / name
    path.write_bytes(HEADS.get(name, b""))
    for loaded in [one for one in sys.modules if one.partition(".")[0] == module]:
        monkeypatch.setitem(sys.modules, loaded, None)  # as if it were not installed
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(RecordingError) as caught:
        open_log(path, DynoMapping("map.yaml", {}))
    suffix = path.suffix
    assert str(caught.value) == f"{path}: reading {suffix} needs {package}: pip install 'ces_observer[{extra}]'"


def test_what_is_not_there_and_a_folder(tmp_path):
    for suffix in ("mf4", "blf", "parquet", "mat", "bag", "csv", "json"):
        with pytest.raises(RecordingError, match=rf"log\.{suffix}: cannot be read: No such file or directory"):
            open_log(tmp_path / f"log.{suffix}", DynoMapping("map.yaml", {}))
    with pytest.raises(RecordingError, match="is a folder; expected a log"):
        open_log(tmp_path, DynoMapping("map.yaml", {}))


SERIES = "\n".join(f"{name}: {{column: {name}}}" for name in ("position", "current", "force"))
TIMES = [0.0, 0.001, 0.002]


def import_series(path, **times):
    """Import time series with these lists of times, and values that count from 1."""
    series = {
        name: {"time": list(times.get(name, TIMES)), "data": [*range(1, 1 + len(times.get(name, TIMES)))]}
        for name in ("position", "current", "force")
    }
    path.write_text(json.dumps(series))
    return import_log(path, parse_dyno_mapping(SERIES, "map.yaml"))


def test_series_that_begin_before_zero_keep_their_distance(tmp_path):
    found = import_series(tmp_path / "log.json", position=[-0.5, -0.4, 0.1], force=[-0.3, 0.0, 0.2])
    starts = [found.channel(name).stamps_ns[0] for name in ("position", "force", "current")]
    assert starts == [0, 200_000_000, 500_000_000]


def test_series_without_times_are_refused_by_name(tmp_path):
    for times, reason in (
        ([], "is empty; expected samples"),
        ([0.0, float("nan"), 0.1], "time 1 is nan; expected seconds"),
        ([0.0, 1e12, 2e12], r"time 1 is 1e\+12; expected seconds"),
    ):
        with pytest.raises(RecordingError, match=rf"log.json: 'force':? {reason}"):
            import_series(tmp_path / "log.json", force=times)


@pytest.mark.parametrize("form", ['{"position": [1, %s], "force": [1, 2]}', '[{"position": 1}, {"position": %s}]'])
def test_a_whole_number_that_no_float_holds_is_a_bad_cell(tmp_path, form):
    (tmp_path / "log.json").write_text(form % ("1" + "0" * 400))
    mapping = parse_dyno_mapping(
        "rate: 1000.0\nposition: {column: position}\ncurrent: {constant: 0}\nforce: {constant: 1}", "map.yaml"
    )
    with pytest.raises(RecordingError, match="column 'position' has a cell that is not a number"):
        import_log(tmp_path / "log.json", mapping)


def test_a_quote_that_is_not_closed_is_one_line(tmp_path):
    rows = "".join(f"{0.001 * k:.3f},0.1,2.0\n" for k in range(15_000))
    (tmp_path / "log.csv").write_text(f'time,position,force\n{rows[:4000]}0.9,"0.1,2.0\n{rows}')
    mapping = parse_dyno_mapping(
        "time: {column: time}\nposition: {column: position}\ncurrent: {constant: 0}\nforce: {column: force}", "map.yaml"
    )
    with pytest.raises(RecordingError, match=r"log.csv: cannot be read as a table: .*is a quote \(\"\) not closed"):
        import_log(tmp_path / "log.csv", mapping)


def test_what_to_do_about_files_that_are_not_read(tmp_path):
    for name, message in (
        ("log.xlsx", "is not read: save the sheet as CSV"),
        ("log.csv.gz", "is not read: unpack it"),
        ("log.xyz", "cannot tell the format from '.xyz'; if it is one of csv, json, mat"),
    ):
        (tmp_path / name).write_bytes(b"abc")
        with pytest.raises(RecordingError, match=re.escape(message)):
            open_log(tmp_path / name, DynoMapping(source="map.yaml", signals={}))


def test_an_asc_file_is_a_can_log_only_if_it_begins_like_one(tmp_path):
    (tmp_path / "log.asc").write_text("time\tposition\n0.0\t1.0\n")
    (tmp_path / "can.asc").write_text("date Wed May 1 12:00:00.250 pm 2024\nbase hex  timestamps absolute\n")
    assert (find_format(tmp_path / "log.asc"), find_format(tmp_path / "can.asc")) == ("csv", "can")
