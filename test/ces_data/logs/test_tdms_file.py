"""LabVIEW's TDMS files, written by nptdms: waveforms with their own times, and a channel of times."""

import numpy as np
import pytest
from log_examples import CURRENT, I_SLOW, START_NS, F, T, X, assert_proposed

from ces_data.logs.log_file import open_log
from ces_data.logs.log_mapping import DynoMapping
from ces_observer.errors import RecordingError

nptdms = pytest.importorskip("nptdms", reason="nptdms is not installed: pip install 'ces_observer[tdms]'")
STEP = T[1] - T[0]


def write(path, channels, group="Rig"):
    """Write channels (name, values, properties) of a group."""
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject(group, name, values, facts) for name, values, facts in channels])
    return path


def waveform(step, unit, **others):
    return {"wf_increment": step, "wf_start_offset": 0.0, "unit_string": unit, **others}


def test_waveforms_have_the_times_of_their_steps(tmp_path):
    start = {"wf_start_time": np.datetime64(START_NS, "ns")}
    slow = waveform(4 * STEP, "mA", **start) | {"wf_start_offset": 0.0005}
    channels = [
        ("Stroke", 1e3 * X, waveform(STEP, "mm", **start)),
        ("Valve current", 1e3 * I_SLOW, slow),
        ("Load", 1e-3 * F, waveform(STEP, "kN", **start)),
    ]
    assert_proposed(write(tmp_path / "lab.tdms", channels), START_NS)


@pytest.mark.parametrize("dated", [False, True])
def test_a_channel_of_times(tmp_path, dated):
    times = np.datetime64(START_NS // 1000, "us") + np.rint(T * 1e6).astype("m8[us]") if dated else T
    units = [("Time", times, {}), ("Stroke", 1e3 * X, {"unit_string": "mm"})]
    units += [("Current", CURRENT, {"unit_string": "A"}), ("Load", F, {"unit_string": "N"})]
    path = write(tmp_path / "lab.tdms", units)
    assert_proposed(path, START_NS if dated else 0, slow=False)


def test_a_damaged_file_is_one_line(tmp_path):
    (tmp_path / "lab.tdms").write_bytes(b"TDSm" + bytes(range(60)))
    with pytest.raises(RecordingError, match=r"lab.tdms: (not a TDMS file, or damaged|holds no channel)"):
        open_log(tmp_path / "lab.tdms", DynoMapping(source="a mapping", signals={}))
