"""What every log that cannot be opened says: one line, and what to do."""

import json
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from log_examples import CURRENT, I_SLOW, START_NS, T_SLOW, F, T, X, assert_proposed, assert_recording
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ces_data.bags.reader import read_recording
from ces_data.logs import parquet
from ces_data.logs.log_file import find_format, open_log
from ces_data.logs.log_import import import_log, read_blocks
from ces_data.logs.log_mapping import DynoMapping, parse_dyno_mapping
from ces_data.mapping.proposals import propose_mapping, propose_signals
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_observer.errors import CesError, RecordingError

HEADS = {"log.mat": b"MATLAB 7.3 MAT-file".ljust(512)}


@pytest.mark.parametrize(
    ("name", "module", "package", "extra"),
    [
        ("log.mf4", "asammdf", "asammdf", "mdf"),
        ("log.mat", "h5py", "h5py", "mat73"),
        ("log.blf", "can", "python-can", "can"),
        ("log.asc", "cantools", "cantools", "can"),
        ("log.parquet", "pyarrow", "pyarrow", "parquet"),
        ("log.tdms", "nptdms", "nptdms", "tdms"),
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


def test_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "x.csv")
    with pytest.raises(RecordingError, match="is no regular file; expected a log on disk"):
        propose_mapping(tmp_path / "x.csv")


def test_what_is_not_there_and_a_folder(tmp_path):
    for suffix in ("mf4", "blf", "parquet", "mat", "csv", "json"):
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
        ([], "has 0 times for 0 values"),
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


def runs_of(kind):
    """Return a MATLAB file's content whose second run holds the signals, and the place of it."""
    signals = {"time": T, "stroke_mm": 1e3 * X, "current_A": CURRENT, "force_N": F}
    first = {name: values[:700] + 1.0 for name, values in signals.items()}
    if kind == "structures":
        return {"run": np.array([first, signals], dtype=object)}, "run(2)", {}
    matrices = np.empty(2, dtype=object)
    matrices[:] = [np.stack(list(part.values()), axis=1) for part in (first, signals)]
    numbers = dict(zip(signals, range(4), strict=True))
    return {"data": matrices}, "data{2}", numbers


@pytest.mark.parametrize("kind", ["structures", "cells"])
def test_one_of_several_runs_in_a_mat_file_is_chosen_by_its_place(tmp_path, kind):
    content, place, numbers = runs_of(kind)
    scipy.io.savemat(tmp_path / "log.mat", content)
    proposal = propose_mapping(tmp_path / "log.mat")
    name, mark = place[:-3], place[-3]
    end = {"(": ")", "{": "}"}[mark]
    (first, *_) = proposal.doubts
    kinds = {"(": "runs", "{": "cells"}[mark]
    expected = f"rows: the file has 2 {kinds}, {name}{mark}1{end} to {name}{mark}2{end}; this is {name}{mark}1{end}"
    assert first == expected
    columns = {signal: numbers.get(column, column) for signal, column in (
        ("time", "time"), ("position", "stroke_mm"), ("current", "current_A"), ("force", "force_N"))}  # fmt: skip
    lines = [f"{signal}: {{column: {column}}}" for signal, column in columns.items()]
    lines[1] = lines[1].replace("}", ", unit: mm}")
    for rows in (place, place.replace("(2)", "[1]").replace("{2}", "[1]")):
        text = "\n".join([f'rows: "{rows}"', *lines])
        assert_recording(import_log(tmp_path / "log.mat", parse_dyno_mapping(text, "map.yaml")), slow=False)
    with pytest.raises(RecordingError, match=re.escape(f"no part {mark}9{end}; expected 1 to 2 there")):
        text = "\n".join([f'rows: "{name}{mark}9{end}"', *lines])
        import_log(tmp_path / "log.mat", parse_dyno_mapping(text, "map.yaml"))


def test_matrices_of_an_iddata_structure_have_its_names_units_and_rate(tmp_path):
    z = {"OutputData": F, "InputData": np.stack([1e3 * X, CURRENT], axis=1), "Ts": T[1] - T[0], "OutputName": "force"}
    names = {"InputName": ["stroke", "current"], "InputUnit": ["mm", "A"], "OutputUnit": "N"}
    z |= {name: np.array(texts, dtype=object) for name, texts in names.items()}
    scipy.io.savemat(tmp_path / "log.mat", {"z": z})
    assert_proposed(tmp_path / "log.mat", slow=False)


# ------------- ROS 1 bags written by rosbags: read by every program with a signals file, and imported with a mapping.


pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")
CUSTOM = "lab/msg/Valve"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("std_msgs/Header header\nstring mode\nfloat32 current_mA\n", CUSTOM))
    path = tmp_path_factory.mktemp("ros1") / "run.bag"
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        for stamp, topic, message in sorted(messages(store.types), key=lambda row: row[0]):
            kind = message.__msgtype__
            found = [c for c in writer.connections if c.topic == topic]
            connection = found[0] if found else writer.add_connection(topic, kind, typestore=store)
            writer.write(connection, stamp, store.serialize_ros1(message, kind))
    return path


def messages(types):
    def header(stamp, frame):
        time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        return types["std_msgs/msg/Header"](seq=7, stamp=time, frame_id=frame)

    empty, vector = np.zeros(0), types["geometry_msgs/msg/Vector3"]
    for k, t in enumerate(np.rint(T * 1e9).astype(int).tolist()):
        stamp = START_NS + t
        names, place = ["wheel", "rear_damper"], np.array([0.1, X[k]])
        joint = types["sensor_msgs/msg/JointState"](
            header=header(stamp, ""), name=names, position=place, velocity=empty, effort=empty
        )
        yield stamp + 50, "/joint_states", joint
        wrench = types["geometry_msgs/msg/Wrench"](
            force=vector(x=0.0, y=0.0, z=F[k]), torque=vector(x=0.0, y=0.0, z=0.0)
        )
        yield stamp + 60, "/load", types["geometry_msgs/msg/WrenchStamped"](header=header(stamp, "rig"), wrench=wrench)
    for t, i in zip(np.rint(T_SLOW * 1e9).astype(int).tolist(), I_SLOW.tolist(), strict=True):
        stamp = START_NS + t
        yield stamp + 70, "/valve", types[CUSTOM](header=header(stamp, "abc"), mode="auto", current_mA=1000 * i)


def test_every_program_reads_it_with_a_signals_file(path, tmp_path):
    proposal = propose_signals([path])
    assert proposal.selection.checks == ()
    (tmp_path / "s.yaml").write_text(proposal.text)
    assert_recording(read_recording(path, load_signals(tmp_path / "s.yaml")), START_NS, rtol=1e-6)


def test_mistakes_are_one_line(path, tmp_path):
    with pytest.raises(RecordingError, match="a bag needs no import: ces info"):
        propose_mapping(path)
    damaged = Path(tmp_path / "damaged.bag")
    damaged.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(CesError, match="not a ROS 1 bag, or damaged"):
        propose_mapping(damaged)


# ---------------------------------------- Parquet files written by pyarrow: units in the metadata, nulls, timestamps.


pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
pq = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
MAPPING_parquet = "time: {column: t}\nposition: {column: x}\ncurrent: {column: i}\nforce: {column: F}\n"
UNITS = {"x": "mm", "i": "A", "F": "kN"}


def write(path, **columns):
    columns = {"t": T, "x": 1000 * X, "i": CURRENT, "F": F / 1000, **columns}
    arrays = {name: pa.array(values) for name, values in columns.items()}
    fields = [pa.field(n, a.type, metadata={"unit": UNITS[n]} if n in UNITS else {}) for n, a in arrays.items()]
    pq.write_table(pa.table(list(arrays.values()), schema=pa.schema(fields)), path)
    return path


def test_units_come_from_the_metadata(tmp_path):
    path = write(tmp_path / "log.parquet")
    assert_recording(import_log(path, parse_dyno_mapping(MAPPING_parquet, "map.yaml")), slow=False)
    assert_proposed(path, slow=False)


def test_timestamps_are_absolute(tmp_path):
    stamps = (START_NS + np.rint(T * 1e9).astype(np.int64)).astype("datetime64[ns]")
    recording = import_log(write(tmp_path / "log.parquet", t=stamps), parse_dyno_mapping(MAPPING_parquet, "map.yaml"))
    assert_recording(recording, START_NS, slow=False)


def test_nulls_are_missing_samples_if_the_mapping_says_so(tmp_path):
    slow = [value if k % 3 == 0 else None for k, value in enumerate(CURRENT.tolist())]
    path = write(tmp_path / "log.parquet", i=slow)
    with pytest.raises(
        CesError, match=r"row 1: column 'i' is null; expected a number .*set blank: missing in map\.yaml"
    ):
        import_log(path, parse_dyno_mapping(MAPPING_parquet, "map.yaml"))
    recording = import_log(path, parse_dyno_mapping(MAPPING_parquet + "blank: missing\n", "map.yaml"))
    np.testing.assert_array_equal(recording.channel("current").values, CURRENT[::3])


def test_a_long_file_is_the_same_in_blocks(tmp_path, monkeypatch):
    path, rows = write(tmp_path / "log.parquet", i=[None, *CURRENT.tolist()[1:]]), len(T) // 3
    wanted = parse_dyno_mapping(MAPPING_parquet + "blank: missing\n", "map.yaml")
    whole = import_log(path, wanted)
    monkeypatch.setattr(parquet, "MAX_ROWS", rows)
    blocks = list(read_blocks(open_log(path, wanted), wanted))
    assert len(blocks) >= 3
    for name, channel in whole.channels.items():
        np.testing.assert_array_equal(Recording.join(blocks).channel(name).stamps_ns, channel.stamps_ns)
        np.testing.assert_array_equal(Recording.join(blocks).channel(name).values, channel.values)
    write(path, i=[*CURRENT.tolist()[:-1], None])
    with pytest.raises(CesError, match=f"row {len(T) - 1}: column 'i' is null"):
        import_log(path, parse_dyno_mapping(MAPPING_parquet, "map.yaml"))


def test_mistakes_are_one_line_parquet(tmp_path):
    path = write(tmp_path / "log.parquet", i=["on"] * len(CURRENT))
    with pytest.raises(CesError, match="column 'i' is string; expected numbers"):
        import_log(path, parse_dyno_mapping(MAPPING_parquet, "map.yaml"))
    with pytest.raises(CesError, match="no column 'Weg'; the table has t, x, i, F"):
        import_log(path, parse_dyno_mapping(MAPPING_parquet.replace("column: x", "column: Weg"), "map.yaml"))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(CesError, match="not a Parquet file, or damaged"):
        import_log(path, parse_dyno_mapping(MAPPING_parquet, "map.yaml"))
