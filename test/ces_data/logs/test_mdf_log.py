"""MDF files written by asammdf: groups with different rates, units, conversions, invalidation bits."""

import datetime
from itertools import pairwise

import numpy as np
import pytest
from log_examples import CURRENT, I_SLOW, START_NS, T_SLOW, F, T, X, assert_proposed, assert_recording

from ces_data.logs import mdf
from ces_data.logs.log_file import open_log
from ces_data.logs.log_import import import_log, read_blocks
from ces_data.logs.log_mapping import parse_dyno_mapping
from ces_data.recording import Recording
from ces_observer.errors import CesError

asammdf = pytest.importorskip("asammdf", reason="asammdf is not installed")
MAPPING = "position: {column: Stroke}\ncurrent: {column: ValveCurrent}\nforce: {column: LoadCell}\n"


def mapping(text=MAPPING):
    return parse_dyno_mapping(text, "map.yaml")


def write(path, version="4.10", more=(), invalid=None):
    with asammdf.MDF(version=version) as mdf:
        mdf.start_time = datetime.datetime(2024, 5, 1, 12, 0, 0, 250_000, tzinfo=datetime.UTC)
        bits = {} if invalid is None else {"invalidation_bits": invalid}
        raw = np.rint(F / 0.5 * 1e3).astype(np.int64)
        fast = [
            asammdf.Signal(1000 * X, T, name="Stroke", unit="mm", **bits),
            asammdf.Signal(raw, T, name="LoadCell", unit="kN", conversion={"a": 0.5e-6, "b": 0.0}),
        ]
        mdf.append(fast, common_timebase=True, comment="fast")
        mdf.append([asammdf.Signal(1000 * I_SLOW, T_SLOW, name="ValveCurrent", unit="mA"), *more], comment="slow")
        saved = mdf.save(path.with_suffix(".mf4" if version[0] == "4" else ".mdf"), overwrite=True)
    return saved.rename(path)


@pytest.mark.parametrize(("name", "version"), [("run.mf4", "4.10"), ("run.dat", "3.30")])
def test_channels_keep_their_own_times_and_units(tmp_path, name, version):
    recording = import_log(write(tmp_path / name, version), mapping())
    assert_recording(recording, START_NS, rtol=1e-5)
    assert len(recording.channel("current")) == len(T_SLOW)


def test_a_proposal_needs_no_mapping(tmp_path):
    assert_proposed(write(tmp_path / "run.mf4"), start_ns=START_NS, rtol=1e-5)


def test_a_long_file_is_the_same_in_blocks(tmp_path, monkeypatch):
    path, shares = write(tmp_path / "run.mf4", invalid=np.arange(len(T)) % 100 == 7), []
    whole = import_log(path, mapping())
    monkeypatch.setattr(mdf, "MAX_ROWS", len(T) // 3)
    blocks = list(read_blocks(open_log(path, mapping(), shares.append), mapping()))
    assert len(blocks) >= 3
    assert shares == sorted(shares)
    for name, channel in whole.channels.items():
        np.testing.assert_array_equal(Recording.join(blocks).channel(name).stamps_ns, channel.stamps_ns)
        np.testing.assert_array_equal(Recording.join(blocks).channel(name).values, channel.values)
    ends = [[c.stamps_ns[at] for c in b.channels.values() if len(c) for at in (0, -1)] for b in blocks]
    assert all(max(one) <= min(following) for one, following in pairwise(ends))


def test_invalid_samples_are_left_out(tmp_path):
    invalid = np.arange(len(T)) % 100 == 7
    recording = import_log(write(tmp_path / "run.mf4", invalid=invalid), mapping())
    np.testing.assert_allclose(recording.channel("position").values, X[~invalid])
    assert len(recording.channel("force")) == len(T)


def test_a_channel_with_a_second_name_is_one_candidate(tmp_path):
    path = tmp_path / "run.mf4"
    with asammdf.MDF(version="4.10") as mdf:
        names = (("damper.position\\XCP:1", 1000 * X, "mm"), ("iValve", CURRENT, "A"), ("fz\\XCP:1", F, "N"))
        mdf.append([asammdf.Signal(values, T, name=name, unit=unit) for name, values, unit in names])
        mdf.start_time = datetime.datetime(2024, 5, 1, 12, 0, 0, 250_000, tzinfo=datetime.UTC)
        mdf.save(path)
    assert_proposed(path, start_ns=START_NS, slow=False)


def test_a_name_in_two_groups_is_selected_by_its_group(tmp_path):
    again = asammdf.Signal(2000 * I_SLOW, T_SLOW, name="Stroke", unit="mm")
    path = write(tmp_path / "run.mf4", more=[again])
    with pytest.raises(CesError, match=r"'Stroke' is in 2 groups \(0 'fast', 1 .*\); give one as"):
        import_log(path, mapping())
    for group in ("0", "fast"):
        text = MAPPING.replace("{column: Stroke}", f"{{column: Stroke, group: {group}}}")
        assert_recording(import_log(path, mapping(text)), START_NS, rtol=1e-5)


def test_mistakes_are_one_line(tmp_path):
    path = write(tmp_path / "run.mf4")
    with pytest.raises(CesError, match="no channel 'Weg'; the file has Stroke, LoadCell, ValveCurrent"):
        import_log(path, mapping(MAPPING.replace("Stroke", "Weg")))
    with pytest.raises(CesError, match="'ValveCurrent' is in 'mA', which is not a unit of a force"):
        import_log(path, mapping(MAPPING.replace("LoadCell", "ValveCurrent")))
    with pytest.raises(CesError, match=r"remove 'rate': the channels of run\.mf4 have their own times"):
        import_log(path, mapping(MAPPING + "rate: 100\n"))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(CesError, match="not an MDF file, or damaged"):
        import_log(path, mapping())
