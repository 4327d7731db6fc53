"""What every log that cannot be opened says: one line, and what to do."""

import sys

import pytest

from ces_identify.recordings.formats.open_log import open_log
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
