"""MATLAB 7.3 files in MATLAB's layout: user block, transposed arrays, structures, references, texts."""

import json

import numpy as np
import pytest
import scipy.io
from log_examples import CURRENT, I_SLOW, T_SLOW, F, T, X, assert_proposed, assert_recording
from scipy.io.matlab import MatlabOpaque

from ces_data.logs.log_import import import_log, to_recording
from ces_data.logs.log_mapping import parse_dyno_mapping
from ces_data.logs.mat import open_mat73, replace_objects
from ces_data.logs.matlab_objects import MatlabObject
from ces_data.mapping.proposals import propose_mapping
from ces_observer.errors import CesError, RecordingError

h5py = pytest.importorskip("h5py", reason="h5py is not installed")
TABLE = "time: {column: t}\nposition: {column: x_mm, unit: mm}\ncurrent: {column: i}\nforce: {column: F}\n"


def mapping(text):
    return parse_dyno_mapping(text, "map.yaml")


def save(path, variables):
    """Write variables as MATLAB's save -v7.3 does."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            add(file, name, value)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Wed May 01 12:00:00 2024 HDF5 schema 1.00 ."
    with path.open("r+b") as file:
        file.write(head.ljust(116) + bytes(8) + b"\x00\x02IM")
    return path


def add(group, name, value):
    if isinstance(value, dict):
        inner = group.create_group(name)
        inner.attrs["MATLAB_class"] = np.bytes_("struct")
        for key, one in value.items():
            add(inner, key, one)
        return
    if isinstance(value, list):
        hidden = group.file.require_group("#refs#")
        references = []
        for one in value:
            inner = f"{name}{len(hidden)}"
            add(hidden, inner, one)
            references.append(hidden[inner].ref)
        data = group.create_dataset(name, data=np.array([references], dtype=h5py.ref_dtype).T)
        data.attrs["MATLAB_class"] = np.bytes_("cell")
        return
    text = isinstance(value, str)
    array = np.array([[ord(c) for c in value]], dtype=np.uint16) if text else np.atleast_2d(np.asarray(value))
    data = group.create_dataset(name, data=array.T)
    data.attrs["MATLAB_class"] = np.bytes_("char" if text else "double")


def column(values):
    return np.asarray(values)[:, None]  # n x 1, as MATLAB's columns


def test_variables_as_columns_and_as_rows(tmp_path):
    variables = {"t": column(T), "x_mm": 1000 * X, "i": column(CURRENT), "F": F, "rig": "7"}
    path = save(tmp_path / "log.mat", variables)
    assert_recording(import_log(path, mapping(TABLE)), slow=False)


def test_a_structure_and_a_matrix(tmp_path):
    run = {"name": "sweep", "log": {"t": T, "x_mm": 1000 * X, "i": CURRENT, "F": F}}
    path = save(tmp_path / "log.mat", {"run": run, "m": np.column_stack([T, 1000 * X, CURRENT, F])})
    assert_recording(import_log(path, mapping(TABLE + "rows: run.log\n")), slow=False)
    numbered = TABLE
    for number, name in enumerate(("t", "x_mm", "i", "F")):
        numbered = numbered.replace(f"column: {name}", f"column: {number}")
    assert_recording(import_log(path, mapping(numbered + "rows: m\n")), slow=False)


def test_one_of_several_runs_is_taken_by_its_number(tmp_path):
    """An array of structures, whose fields are references without a class."""
    runs = [{"t": T, "x_mm": 1000 * X, "i": CURRENT, "F": k * F} for k in (1.0, 2.0)]
    path = save(tmp_path / "log.mat", {"run": {name: [run[name] for run in runs] for name in runs[0]}})
    with h5py.File(path, "r+") as file:
        for field in file["run"].values():
            del field.attrs["MATLAB_class"]
    assert "rows: the file has 2 runs, run(1) to run(2); this is run(1)" in propose_mapping(path).doubts[0]
    recording = import_log(path, mapping(TABLE + "rows: run(2)\n"))
    np.testing.assert_allclose(recording.channel("force").values, 2.0 * F)


def test_time_series_keep_their_own_times(tmp_path):
    series = {
        "position_mm": {"time": column(T), "signals": {"values": column(1000 * X), "dimensions": 1.0}},
        "current_A": {"Time": column(T_SLOW), "Data": column(I_SLOW)},
        "force_N": {"time": column(T), "data": column(F)},
    }
    path = save(tmp_path / "log.mat", {"out": series})
    text = (
        "rows: out\nposition: {column: position_mm, unit: mm}\ncurrent: {column: current_A}\nforce: {column: force_N}\n"
    )
    assert_recording(import_log(path, mapping(text)))
    proposal = assert_proposed(path)
    assert_recording(import_log(path, mapping(proposal.text)))


@pytest.mark.parametrize("suffix", [".mat", ".json"])
def test_time_series_of_older_files_and_json(tmp_path, suffix):
    series = {
        "stroke_mm": {"time": T.tolist(), "data": (1000 * X).tolist()},
        "current_A": {"time": T_SLOW.tolist(), "data": I_SLOW.tolist()},
        "force_N": {"time": T.tolist(), "data": F.tolist()},
    }
    path = tmp_path / f"log{suffix}"
    if suffix == ".json":
        path.write_text(json.dumps(series))
    else:
        scipy.io.savemat(path, series)
    assert_proposed(path)


def test_a_rate_beside_arrays_without_times(tmp_path):
    rate = 1.0 / (T[1] - T[0])
    arrays = {"x_mm": 1e3 * X, "i_A": CURRENT, "F_N": F}
    scipy.io.savemat(tmp_path / "run.mat", {"fs": rate, "gain": 3.0, "position_offset_mm": 1.0, **arrays})
    proposal = propose_mapping(tmp_path / "run.mat")
    assert proposal.doubts == () and "rate from 'fs'" in proposal.found
    assert_recording(to_recording(proposal.log, proposal.mapping), slow=False)


def save_objects(path, names, kind, **numbers):
    save(path, {**numbers, **dict.fromkeys(names, np.zeros(6))})
    with h5py.File(path, "r+") as file:
        for name in names:
            file[name].attrs["MATLAB_class"] = np.bytes_(kind)
            file[name].attrs["MATLAB_object_decode"] = np.int32(3)
    return path


def test_an_object_is_refused_with_what_to_save_instead(tmp_path):
    path = save_objects(tmp_path / "log.mat", ["F"], "timeseries", t=T, x_mm=X, i=CURRENT)
    refused = r"'F' is a MATLAB object \(timeseries\), which is not read; in MATLAB: F = struct\('time', F.Time,"
    with pytest.raises(CesError, match=refused):
        import_log(path, mapping(TABLE))
    alone = save_objects(tmp_path / "alone.mat", ["stroke", "force"], "timeseries")
    with pytest.raises(CesError, match=r"'force' is a MATLAB object \(timeseries\).*likewise 'stroke' \(timeseries\)"):
        propose_mapping(alone)


def test_a_cell_of_columns_and_a_damaged_file(tmp_path):
    path = save(tmp_path / "log.mat", {"log": [column(T), column(X)]})
    with pytest.raises(CesError, match="no column 'x_mm'; the table has columns 0"):
        import_log(path, mapping(TABLE + "rows: log\n"))
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(CesError, match=r"not a MATLAB 7\.3 file, or damaged"):
        import_log(path, mapping(TABLE))


def test_objects_beside_numbers_are_the_reason_why_a_signal_is_not_found(tmp_path):
    path = save_objects(tmp_path / "log.mat", ["logsout"], "Simulink.SimulationData.Dataset", tout=T)
    proposal = propose_mapping(path, rate=500.0)
    assert "for k = 1:logsout.numElements, e = logsout{k};" in proposal.doubts[0]
    assert proposal.doubts[0] in proposal.faults


@pytest.mark.parametrize(("cells", "own"), [((b"F", b"MCOS", b"table", 1), "F"), (("MCOS", "table", 1), "")])
def test_objects_of_older_files_have_the_names_that_either_scipy_gives(cells, own):
    record = np.empty((), dtype=[(f"s{k}", object) for k in range(len(cells))])
    record[()] = cells
    tree = {"None" if own else "F": MatlabOpaque(record), "t": T}
    found = replace_objects(tree)
    assert found["F"] == MatlabObject("table") and found["t"] is T


SIMULINK = {
    "logs": {
        "time": T,
        "signals": [
            {"label": label, "values": values}
            for label, values in (("stroke_m", X), ("force_N", F), ("current_A", CURRENT))
        ],
    }
}
CONTROL_DESK = {
    "run": {
        "X": {"Name": "Time", "Unit": "s", "Data": T},
        "Y": [
            {"Name": f"Model Root/{name}", "Unit": unit, "XIndex": 1, "Data": values}
            for name, unit, values in (("Stroke", "mm", 1e3 * X), ("Valve current", "A", CURRENT), ("Force", "N", F))
        ],
    }
}


@pytest.mark.parametrize("content", [SIMULINK, CONTROL_DESK], ids=["simulink", "controldesk"])
def test_arrays_of_named_series(tmp_path, content):
    scipy.io.savemat(tmp_path / "log.mat", content)
    proposal = assert_proposed(tmp_path / "log.mat", slow=False)
    assert_recording(import_log(tmp_path / "log.mat", parse_dyno_mapping(proposal.text, "map.yaml")), slow=False)


def test_numbers_beyond_memory_and_those_of_other_files_are_refused(tmp_path):
    path = save(tmp_path / "m.mat", {"x": column(X), "t": column(T)})
    save(tmp_path / "other.mat", {"x": column(X)})
    (tmp_path / "raw.bin").write_bytes(bytes(80))
    with h5py.File(path, "r+") as file:
        file.create_dataset("huge", shape=(10**12, 1), dtype="f8", chunks=(1024, 1))
        file["link"] = h5py.ExternalLink("other.mat", "x")
        file.create_dataset("raw", shape=(10,), dtype="f8", external=[(str(tmp_path / "raw.bin"), 0, 80)])
        layout = h5py.VirtualLayout(shape=(1, len(X)), dtype="f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.mat"), "x", shape=(1, len(X)))
        file.create_virtual_dataset("virtual", layout)
    tree = open_mat73(path)
    np.testing.assert_array_equal(tree["x"], X)
    assert sorted(tree) == ["huge", "raw", "t", "virtual", "x"]
    for name, phrase in (
        ("huge", r"m\.mat: 'huge' states 1000000000000 numbers, 8e\+03 GB; expected at most 4 GB"),
        ("link", "'link' is a link to another file"),
        ("raw", "the numbers of 'raw' are in another file"),
        ("virtual", "the numbers of 'virtual' are in another file"),
    ):
        with pytest.raises(RecordingError, match=phrase):
            tree[name]


def test_columns_that_are_no_columns_of_numbers_are_named(tmp_path):
    for x, doubt in (
        (1e3 * X + 0j, "holds complex numbers; expected real ones"),
        (1e3 * X[:-5], f"has {len(T) - 5} values for {len(T)} rows"),
    ):
        scipy.io.savemat(tmp_path / "log.mat", {"t": T, "x_mm": x, "current_A": CURRENT, "F_N": F})
        assert propose_mapping(tmp_path / "log.mat").doubts == (f"position: 'x_mm' {doubt}",)
