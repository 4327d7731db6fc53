"""CAN logs written by python-can with a DBC: multiplexed signals, extended ids, CAN FD, several buses."""

import numpy as np
import pytest
from log_examples import I_SLOW, START_NS, T_SLOW, F, T, X, assert_proposed, assert_recording

from ces_data.logs.log_import import import_log, to_recording
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.mapping.proposals import propose_mapping
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
