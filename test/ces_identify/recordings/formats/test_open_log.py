"""What every log that cannot be opened says: one line, and what to do."""

import re
import sys

import pytest

from ces_identify.recordings.formats.open_log import find_format, open_log
from ces_identify.recordings.log_mapping import DynoMapping
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


@pytest.mark.parametrize("name", ["log.mf4", "log.blf", "log.parquet", "log.mat", "log.bag", "log.csv", "log.json"])
def test_a_file_that_is_not_there(tmp_path, name):
    with pytest.raises(RecordingError, match=rf"{name}: cannot be read: No such file or directory"):
        open_log(tmp_path / name, DynoMapping("map.yaml", {}))


def test_a_folder_is_no_log(tmp_path):
    with pytest.raises(RecordingError, match="is a folder; expected a log"):
        open_log(tmp_path, DynoMapping("map.yaml", {}))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("log.xlsx", "is not read: save the sheet as CSV"),
        ("log.csv.gz", "is not read: unpack it"),
        ("log.tdms", "is not read: export it as CSV"),
        ("log.xyz", "cannot tell the format from '.xyz'; if it is one of csv, json, mat"),
    ],
)
def test_what_to_do_about_files_that_are_not_read(tmp_path, name, message):
    (tmp_path / name).write_bytes(b"abc")
    with pytest.raises(RecordingError, match=re.escape(message)):
        open_log(tmp_path / name, DynoMapping(source="map.yaml", signals={}))


def test_an_asc_file_is_a_can_log_only_if_it_begins_like_one(tmp_path):
    (tmp_path / "log.asc").write_text("time\tposition\n0.0\t1.0\n")
    (tmp_path / "can.asc").write_text("date Wed May 1 12:00:00.250 pm 2024\nbase hex  timestamps absolute\n")
    assert (find_format(tmp_path / "log.asc"), find_format(tmp_path / "can.asc")) == ("csv", "can")
