"""Parquet files written by pyarrow: units in the metadata, nulls, timestamps."""

import numpy as np
import pytest
from log_examples import CURRENT, START_NS, F, T, X, assert_proposed, assert_recording

from ces_data.logs import parquet
from ces_data.logs.log_file import open_log
from ces_data.logs.log_import import import_log, read_blocks
from ces_data.logs.log_mapping import parse_dyno_mapping
from ces_data.recording import Recording
from ces_observer.errors import CesError

pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
pq = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
MAPPING = "time: {column: t}\nposition: {column: x}\ncurrent: {column: i}\nforce: {column: F}\n"
UNITS = {"x": "mm", "i": "A", "F": "kN"}


def write(path, **columns):
    columns = {"t": T, "x": 1000 * X, "i": CURRENT, "F": F / 1000, **columns}
    arrays = {name: pa.array(values) for name, values in columns.items()}
    fields = [pa.field(n, a.type, metadata={"unit": UNITS[n]} if n in UNITS else {}) for n, a in arrays.items()]
    pq.write_table(pa.table(list(arrays.values()), schema=pa.schema(fields)), path)
    return path


def test_units_come_from_the_metadata(tmp_path):
    path = write(tmp_path / "log.parquet")
    assert_recording(import_log(path, parse_dyno_mapping(MAPPING, "map.yaml")), slow=False)
    assert_proposed(path, slow=False)


def test_timestamps_are_absolute(tmp_path):
    stamps = (START_NS + np.rint(T * 1e9).astype(np.int64)).astype("datetime64[ns]")
    recording = import_log(write(tmp_path / "log.parquet", t=stamps), parse_dyno_mapping(MAPPING, "map.yaml"))
    assert_recording(recording, START_NS, slow=False)


def test_nulls_are_missing_samples_if_the_mapping_says_so(tmp_path):
    slow = [value if k % 3 == 0 else None for k, value in enumerate(CURRENT.tolist())]
    path = write(tmp_path / "log.parquet", i=slow)
    with pytest.raises(
        CesError, match=r"row 1: column 'i' is null; expected a number .*set blank: missing in map\.yaml"
    ):
        import_log(path, parse_dyno_mapping(MAPPING, "map.yaml"))
    recording = import_log(path, parse_dyno_mapping(MAPPING + "blank: missing\n", "map.yaml"))
    np.testing.assert_array_equal(recording.channel("current").values, CURRENT[::3])


def test_a_long_file_is_the_same_in_blocks(tmp_path, monkeypatch):
    path, rows = write(tmp_path / "log.parquet", i=[None, *CURRENT.tolist()[1:]]), len(T) // 3
    wanted = parse_dyno_mapping(MAPPING + "blank: missing\n", "map.yaml")
    whole = import_log(path, wanted)
    monkeypatch.setattr(parquet, "MAX_ROWS", rows)
    blocks = list(read_blocks(open_log(path, wanted), wanted))
    assert len(blocks) >= 3
    for name, channel in whole.channels.items():
        np.testing.assert_array_equal(Recording.join(blocks).channel(name).stamps_ns, channel.stamps_ns)
        np.testing.assert_array_equal(Recording.join(blocks).channel(name).values, channel.values)
    write(path, i=[*CURRENT.tolist()[:-1], None])
    with pytest.raises(CesError, match=f"row {len(T) - 1}: column 'i' is null"):
        import_log(path, parse_dyno_mapping(MAPPING, "map.yaml"))


def test_mistakes_are_one_line(tmp_path):
    path = write(tmp_path / "log.parquet", i=["on"] * len(CURRENT))
    with pytest.raises(CesError, match="column 'i' is string; expected numbers"):
        import_log(path, parse_dyno_mapping(MAPPING, "map.yaml"))
    with pytest.raises(CesError, match="no column 'Weg'; the table has t, x, i, F"):
        import_log(path, parse_dyno_mapping(MAPPING.replace("column: x", "column: Weg"), "map.yaml"))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(CesError, match="not a Parquet file, or damaged"):
        import_log(path, parse_dyno_mapping(MAPPING, "map.yaml"))
