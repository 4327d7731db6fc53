"""CAN logs written by python-can with a DBC: multiplexed signals, extended ids, CAN FD, several buses."""

import datetime
from itertools import pairwise

import numpy as np
import pytest
from log_examples import CURRENT, I_SLOW, START_NS, T_SLOW, F, T, X, assert_proposed, assert_recording

from ces_data.logs import mdf
from ces_data.logs.log_file import open_log
from ces_data.logs.log_import import import_log, read_blocks, to_recording
from ces_data.logs.log_mapping import load_dyno_mapping, parse_dyno_mapping
from ces_data.mapping.proposals import propose_mapping
from ces_data.recording import Recording
from ces_observer.errors import CesError

can = pytest.importorskip("can", reason="python-can is not installed")
cantools = pytest.importorskip("cantools", reason="cantools is not installed")

DBC = """VERSION ""
BS_:
BU_: ECU
BO_ 256 Damper: 8 ECU
 SG_ Stroke : 0|32@1- (0.000001,0) [-1000|1000] "mm" ECU
 SG_ Force : 32|32@1- (0.0001,0) [-10000|10000] "N" ECU
BO_ 2566844926 Valve: 8 ECU
 SG_ Mux M : 0|8@1+ (1,0) [0|3] "" ECU
 SG_ Current m0 : 8|32@1- (0.001,0) [0|3000] "mA" ECU
 SG_ Temperature m1 : 8|16@1- (0.1,0) [-40|200] "degC" ECU
BO_ 512 Long: 24 ECU
 SG_ Load : 128|32@1- (0.0001,0) [-10000|10000] "N" ECU
"""
MAPPING = (
    "dbc: rig.dbc\nposition: {column: Damper.Stroke}\ncurrent: {column: Valve.Current}\nforce: {column: Damper.Force}\n"
)
VALVE_ID = 2566844926 & 0x1FFFFFFF


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.dbc").write_text(DBC)
    (tmp_path / "map.yaml").write_text(MAPPING)
    return tmp_path


def frames(database, bus=0, fd=False):
    damper, valve, long = (database.get_message_by_name(name) for name in ("Damper", "Valve", "Long"))
    for t, x, f in zip(T, X, F, strict=True):
        yield t, damper.frame_id, False, damper.encode({"Stroke": 1000 * x, "Force": f}, strict=False), False, bus
        if fd:
            yield t, long.frame_id, False, long.encode({"Load": f}, strict=False), True, bus
    for k, (t, i) in enumerate(zip(T_SLOW, I_SLOW, strict=True)):
        yield t, VALVE_ID, True, valve.encode({"Mux": 0, "Current": 1000 * i}, strict=False), False, bus
        warm = valve.encode({"Mux": 1, "Temperature": 40 + 0.1 * (k % 5)}, strict=False)
        yield t + 1e-4, VALVE_ID, True, warm, False, bus
        yield t + 2e-4, VALVE_ID, False, bytes(8), False, bus  # a standard frame of the same number is another message


def write(path, *groups):
    rows = sorted((row for group in groups for row in group), key=lambda row: row[0])
    with can.Logger(path) as logger:
        for t, number, extended, data, fd, bus in rows:
            if extended or number <= 0x7FF:
                where = {"channel": bus if path.suffix != ".log" else f"can{bus}", "is_fd": fd}
                kind = {"arbitration_id": number, "is_extended_id": extended}
                logger.on_message_received(can.Message(START_NS * 1e-9 + t, data=data, **kind, **where))
    return path


def database(folder):
    return cantools.database.load_file(folder / "rig.dbc")


@pytest.mark.parametrize("suffix", [".asc", ".log", ".trc"])
def test_signals_keep_their_own_absolute_times(folder, suffix, monkeypatch):
    path = write(folder / f"run{suffix}", frames(database(folder)))
    recording = import_log(path, load_dyno_mapping(folder / "map.yaml"))
    start = START_NS if suffix != ".asc" else int(recording.channel("position").stamps_ns[0])
    assert_recording(recording, start, rtol=1e-4)
    assert abs(start - START_NS) < 15 * 3600 * 10**9  # .asc states the local time of day, in whole milliseconds
    assert len(recording.channel("current")) == len(T_SLOW)


def test_a_proposal_needs_the_database_only(folder):
    path = write(folder / "run.blf", frames(database(folder)))
    assert_proposed(path, dbc=[folder / "rig.dbc"], start_ns=START_NS, rtol=1e-4)


def test_signals_of_can_fd_frames_on_the_bus_that_is_selected(folder):
    path = write(folder / "run.blf", *(frames(database(folder), bus, fd=True) for bus in (0, 1)))
    with pytest.raises(CesError, match=r"'Damper.Stroke' is on bus 0 and 1; select one in .*map.yaml: \{column:"):
        import_log(path, load_dyno_mapping(folder / "map.yaml"))
    (folder / "map.yaml").write_text(MAPPING.replace("}", ", group: 1}").replace("Damper.Force", "Long.Load"))
    assert_recording(import_log(path, load_dyno_mapping(folder / "map.yaml")), START_NS, rtol=1e-4)


def test_mistakes_are_one_line(folder):
    path = write(folder / "run.blf", frames(database(folder)))
    for old, new, message in (
        ("Damper.Stroke", "Damper.Weg", "no signal 'Damper.Weg'; the message has Damper.Stroke, Damper.Force"),
        ("Damper.Stroke", "Weg", r"expected MESSAGE\.SIGNAL, one of Damper\.Stroke"),
        (
            "Damper.Stroke",
            "Long.Load",
            r"no frame carries 'Long.Load' \(id 0x200, standard\); is it the right database",
        ),
        ("dbc: rig.dbc", "dbc: none.dbc", "none.dbc: cannot be read: No such file"),
        ("dbc: rig.dbc\n", "", "a CAN log needs its database; give dbc: FILE.dbc in .*map.yaml"),
    ):
        (folder / "map.yaml").write_text(MAPPING.replace(old, new))
        with pytest.raises(CesError, match=message):
            import_log(path, load_dyno_mapping(folder / "map.yaml"))
    (folder / "rig.dbc").write_text("no database\n")
    (folder / "map.yaml").write_text(MAPPING)
    with pytest.raises(CesError, match="not a DBC file"):
        import_log(path, load_dyno_mapping(folder / "map.yaml"))


def test_a_log_that_ends_early_says_so(folder):
    path = write(folder / "run.blf", frames(database(folder)))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    proposal = propose_mapping(path, dbc=[folder / "rig.dbc"])
    assert proposal.log.notes == (f"the file ends early: it has {len(whole) // 2} of {len(whole)} bytes",)


def test_frames_in_an_mdf_file(folder):
    asammdf = pytest.importorskip("asammdf", reason="asammdf is not installed")
    rows = [r for r in sorted(frames(database(folder)), key=lambda r: r[0]) if r[2] or r[1] <= 0x7FF]
    fields = [("BusChannel", "u1"), ("ID", "<u4"), *((name, "u1") for name in ("IDE", "DLC", "DataLength"))]
    fields += [("DataBytes", "(8,)u1")]
    samples = np.zeros(len(rows), dtype=[(f"CAN_DataFrame.{name}", kind) for name, kind in fields])
    for at, (_, number, extended, data, *_) in enumerate(rows):
        samples[at] = (1, number, extended, 8, len(data), np.frombuffer(data.ljust(8, b"\0"), dtype=np.uint8))
    times = np.array([row[0] for row in rows])
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append([asammdf.Signal(samples, times, name="CAN_DataFrame")])
        mdf.save(folder / "run.mf4", overwrite=True)
    with pytest.raises(CesError, match=r"run.mf4: holds CAN frames, not signals; give their database: --dbc FILE.dbc"):
        propose_mapping(folder / "run.mf4")
    proposal = propose_mapping(folder / "run.mf4", dbc=[folder / "rig.dbc"])
    recording = to_recording(proposal.log, proposal.mapping)
    assert_recording(recording, int(recording.channel("position").stamps_ns[0]), rtol=1e-4)


def test_options_that_do_not_apply(folder):
    write(folder / "run.blf", frames(database(folder)))
    (folder / "log.csv").write_text("time_s,x_mm,current_A,F_N\n0,1,0,2\n1,2,0,3\n2,1,0,3\n")
    for name, rate, message in (
        ("run.blf", 500.0, "rate does not apply: the channels of this log have their own times"),
        ("log.csv", None, "dbc does not apply: this is no CAN log"),
    ):
        with pytest.raises(CesError, match=message):
            propose_mapping(folder / name, dbc=[folder / "rig.dbc"], rate=rate)


# ------------------ MDF files written by asammdf: groups with different rates, units, conversions, invalidation bits.


asammdf = pytest.importorskip("asammdf", reason="asammdf is not installed")
MAPPING_mdf = "position: {column: Stroke}\ncurrent: {column: ValveCurrent}\nforce: {column: LoadCell}\n"


def mapping(text=MAPPING_mdf):
    return parse_dyno_mapping(text, "map.yaml")


def write_mdf(path, version="4.10", more=(), invalid=None):
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
    recording = import_log(write_mdf(tmp_path / name, version), mapping())
    assert_recording(recording, START_NS, rtol=1e-5)
    assert len(recording.channel("current")) == len(T_SLOW)


def test_a_proposal_needs_no_mapping(tmp_path):
    assert_proposed(write_mdf(tmp_path / "run.mf4"), start_ns=START_NS, rtol=1e-5)


def test_a_long_file_is_the_same_in_blocks(tmp_path, monkeypatch):
    path, shares = write_mdf(tmp_path / "run.mf4", invalid=np.arange(len(T)) % 100 == 7), []
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
    recording = import_log(write_mdf(tmp_path / "run.mf4", invalid=invalid), mapping())
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
    path = write_mdf(tmp_path / "run.mf4", more=[again])
    with pytest.raises(CesError, match=r"'Stroke' is in 2 groups \(0 'fast', 1 .*\); give one as"):
        import_log(path, mapping())
    for group in ("0", "fast"):
        text = MAPPING_mdf.replace("{column: Stroke}", f"{{column: Stroke, group: {group}}}")
        assert_recording(import_log(path, mapping(text)), START_NS, rtol=1e-5)


def test_mistakes_are_one_line_mdf(tmp_path):
    path = write_mdf(tmp_path / "run.mf4")
    with pytest.raises(CesError, match="no channel 'Weg'; the file has Stroke, LoadCell, ValveCurrent"):
        import_log(path, mapping(MAPPING_mdf.replace("Stroke", "Weg")))
    with pytest.raises(CesError, match="'ValveCurrent' is in 'mA', which is not a unit of a force"):
        import_log(path, mapping(MAPPING_mdf.replace("LoadCell", "ValveCurrent")))
    with pytest.raises(CesError, match=r"remove 'rate': the channels of run\.mf4 have their own times"):
        import_log(path, mapping(MAPPING_mdf + "rate: 100\n"))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(CesError, match="not an MDF file, or damaged"):
        import_log(path, mapping())


# ------------------------------------------- Text logs that python-can alone reads in part, or not.


def frame_lines(folder, form):
    """Return lines with the frames of position and force, `form` of time, time since the line before, and data."""
    damper, before = database(folder).get_message_by_name("Damper"), 0.0
    for t, x, f in zip(T - 1.0, X, F, strict=True):
        data = damper.encode({"Stroke": 1000 * x, "Force": f}, strict=False)
        yield form(t, t - before, " ".join(f"{byte:02X}" for byte in data))
        before = t


HEAD = "date Wed May 1 12:00:00.250 pm 2024\nbase hex  timestamps {}\n"
ASC = "   {0:.6f} 1  100             Rx   d 8 {1}\n"
TEXTS = {
    "times before a trigger": ("log.asc", HEAD.format("absolute"), lambda t, d, data: ASC.format(t, data)),
    "relative times": ("log.asc", HEAD.format("relative"), lambda t, d, data: ASC.format(d, data)),
    "candump -ta": ("log.log", "", lambda t, d, data: f" ({t + 9:.6f})  can0  100   [8]  {data}\n"),
    "candump -ta -x": ("log.log", "", lambda t, d, data: f" ({t + 9:.6f})  can0  RX - -  100   [8]  {data}\n"),
}
WITHOUT_CURRENT = MAPPING.replace("{column: Valve.Current}", "{constant: 0.0}")


@pytest.mark.parametrize("kind", TEXTS)
def test_every_frame_of_a_text_log_is_read_at_its_time(folder, kind):
    name, head, form = TEXTS[kind]
    (folder / name).write_text(head + "".join(frame_lines(folder, form)))
    recording = import_log(folder / name, parse_dyno_mapping(WITHOUT_CURRENT, str(folder / "map.yaml")))
    for signal, values in (("position", X), ("force", F)):
        channel = recording.channel(signal)
        np.testing.assert_allclose(channel.values, values, atol=1e-4 * np.abs(values).max())
        np.testing.assert_allclose(np.diff(channel.stamps_ns) * 1e-9, np.diff(T), atol=3e-6)


def test_candump_without_times_is_refused_with_the_line(folder):
    (folder / "log.log").write_text("".join(frame_lines(folder, lambda t, d, data: f"  can0  100   [8]  {data}\n")))
    with pytest.raises(
        CesError, match=r"log.log:1: candump's console output, which has no times; record .* candump -l"
    ):
        import_log(folder / "log.log", parse_dyno_mapping(WITHOUT_CURRENT, str(folder / "map.yaml")))


def test_values_that_the_database_calls_not_available_are_missing(folder):
    (folder / "rig.dbc").write_text(DBC + 'VAL_ 256 Force 2147483647 "Signal not available" -1 "low" ;\n')
    none = bytes.fromhex("FF FF FF 7F")
    count = iter(range(len(T)))

    def form(t, d, data):
        raw = bytes.fromhex(data)
        return ASC.format(t + 2.0, (raw[:4] + none if next(count) % 10 == 3 else raw).hex(" "))

    (folder / "log.asc").write_text(HEAD.format("absolute") + "".join(frame_lines(folder, form)))
    recording = import_log(folder / "log.asc", parse_dyno_mapping(WITHOUT_CURRENT, str(folder / "map.yaml")))
    there = np.arange(len(T)) % 10 != 3
    np.testing.assert_allclose(recording.channel("force").values, F[there], atol=1e-3)
    assert len(recording.channel("position")) == len(T)
