"""Text tables as other programs write them: headers, comments, clocks and spellings that `ces import` finds."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import proposal_bags as bags
import pytest
import tiny_bags as tiny
from log_examples import CURRENT, F, T, X, assert_recording

from ces_cli.main import main
from ces_data.bags.reader import read_recording
from ces_data.logs.log_import import to_recording
from ces_data.mapping.proposals import propose_mapping, propose_signals
from ces_data.signals_file import load_signals
from ces_observer.errors import RecordingError

NAMES = "time_s,position_mm,current_A,force_N\n"
SIGNALS = (T, 1e3 * X, CURRENT, F)
CELLS = [f"{t!r},{1e3 * x!r},{i!r},{f!r}" for t, x, i, f in zip(*(a.tolist() for a in (T, X, CURRENT, F)), strict=True)]
TABLE = "\n".join(CELLS) + "\n"
NOON = datetime(2024, 5, 1, 12, 59, 57, tzinfo=UTC)  # the clock passes 1 PM


def propose(tmp_path, text, name="log.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return propose_mapping(path)


def read(tmp_path, text, **options):
    proposal = propose(tmp_path, text, **options)
    assert proposal.doubts == ()
    return to_recording(proposal.log, proposal.mapping)


def with_times(cells, name="Time"):
    rows = [f"{time},{row.split(',', 1)[1]}" for time, row in zip(cells, CELLS, strict=True)]
    return f"{name},position_mm,current_A,force_N\n" + "\n".join(rows) + "\n"


def clock(form):
    return [(NOON + timedelta(seconds=t)).strftime(form) for t in T]


@pytest.mark.parametrize(
    "text",
    [
        "# damper 17\n# " + NAMES + NAMES + TABLE,
        "# damper 17\n# " + NAMES.replace(",", " ") + TABLE.replace(",", " "),
        "time,position,current,force\nRT,LVDT,Clamp,HBM\n[s],[mm],[A],[N]\n" + TABLE,
        "s,mm,A,N\ntime,position,current,force\n" + TABLE,
        ",position,current,force\n,mm,A,N\ntime,,,\n" + TABLE,
        "waveform,[0],[1],[2]\nt0,1.5.2024 12:00:00,,\ndelta t,0.1,0.1,0.1\n" + NAMES + TABLE,
        "Writer_Version,2\n***End_of_Header***,\nSamples,9,9,9,\nY_Unit_Label,mm,A,N,\nX0,0,0,0,\n***End_of_Header***,,,,\n"
        "X_Value,Position [mm],Current,Force,Comment\n" + TABLE,
        '"XAxis","Model Root/Stroke [mm]/Out1","Model Root/Valve Current [A]/Out1","Model Root/Force [N]/Out1"\n'
        + TABLE,
        "Log\nTime (s) - Voltage_0,Displacement (mm) - Voltage_0,Current (A) - Amp,Force (N) - Bridge\n" + TABLE,
        NAMES + "\n".join([*CELLS[:500], "# marker: bump", *CELLS[500:]]) + "\n",
        "Operator,Meier,,,\nSerial,12345,,,\nState," + NAMES + "\n".join("RUN," + row for row in CELLS) + "\n",
        NAMES.strip() + ",Remark\n" + "\n".join([f"{CELLS[0]},warm", *(row + "," for row in CELLS[1:])]) + "\n",
        "Rig,Damper,Damper,Damper\n" + NAMES + TABLE,
        '"Time\n[s]","Position\n[mm]","Current\n[A]","Force\n[N]"\n' + TABLE,
    ],
)
def test_headers_and_comments_of_other_programs(tmp_path, text):
    assert_recording(read(tmp_path, text), slow=False)
    for encoding in ("utf-16", "utf-16-be"):  # with and without its mark
        assert_recording(read(tmp_path, text, encoding=encoding), slow=False)


@pytest.mark.parametrize(
    ("cells", "start"),
    [
        (clock("%m/%d/%Y %I:%M:%S.%f %p"), NOON),
        ([cell.replace("05/01", "5/13") for cell in clock("%m/%d/%Y %H:%M:%S.%f")], NOON.replace(day=13)),
        ([cell.replace("01/05", "13/5") for cell in clock("%d/%m/%Y %H:%M:%S.%f")], NOON.replace(day=13)),
        (clock("%I:%M:%S.%f %p"), NOON.replace(year=1970, month=1, day=1)),
        (clock("0 days %H:%M:%S.%f"), NOON.replace(year=1970, month=1, day=1)),
        (clock("%M:%S.%f"), datetime(1970, 1, 1, 0, 59, 57, tzinfo=UTC)),
        (clock("%Y/%m/%d %H:%M:%S.%f"), NOON),
        (clock("%d-%b-%Y %H:%M:%S.%f"), NOON),
        (clock("%Y-%m-%dT%H:%M:%S.%fZ"), NOON),
        (clock("1.5.2024 %H:%M:%S.%f"), NOON),
        ([cell.replace("May", "Mai") for cell in clock("%d. %B %Y %H:%M:%S.%f")], NOON),
        ([f"{cell[:-7]}:{cell[-6:-3]}" for cell in clock("%H:%M:%S.%f")], NOON.replace(year=1970, month=1, day=1)),
    ],
)
def test_clocks_and_dates(tmp_path, cells, start):
    recording = read(tmp_path, with_times(cells))
    assert_recording(recording, start_ns=round(start.timestamp() * 1e9), slow=False)


@pytest.mark.parametrize(
    ("count_per_s", "zero", "text"),
    [
        (1 / 86_400, 25_569, "days since 30 December 1899, as Excel counts"),
        (1, 2_082_844_800, "s since 1904, as LabVIEW counts"),
    ],
)
def test_numbers_that_count_from_a_date_and_the_file_that_says_so(tmp_path, count_per_s, zero, text):
    numbers = zero + (NOON.timestamp() + T) * count_per_s
    proposal = propose(tmp_path, with_times([f"{number:.12f}" for number in numbers]))
    recording = to_recording(proposal.log, proposal.mapping)  # whose mapping is parsed from the proposed text
    stamps = recording.channel("force").stamps_ns - round(NOON.timestamp() * 1e9)
    np.testing.assert_allclose(stamps, T * 1e9, atol=20_000)  # a number of this size resolves 10 us
    assert f"time from 'Time' [{text}]" in proposal.found


def test_missing_numbers_in_any_spelling_are_missing_samples_and_counted(tmp_path):
    rows = list(CELLS)
    for at, spelling in ((500, "NA"), (600, "---"), (700, "1.#QNAN"), (800, "#DIV/0!")):
        rows[at] = f"{rows[at].rpartition(',')[0]},{spelling}"
    proposal = propose(tmp_path, NAMES + "\n".join(rows) + "\n")
    recording = to_recording(proposal.log, proposal.mapping)
    assert len(recording.channel("force")) == len(T) - 4 and len(recording.channel("position")) == len(T)
    assert "blank cells are missing samples (4 of force)" in proposal.found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (NAMES + TABLE + "9.5,1.0,0.3,oops\n", "force: line 1202: column 'force_N' is 'oops'; expected a number"),
        (NAMES + TABLE + "END OF DATA\n", "line 1202: column 'position_mm' is missing; the line has 1 cells"),
        (with_times(clock("%m/%d/%Y %H:%M:%S.%f")), "month/day or day/month; set date: '%m/%d/%Y %H:%M:%S.%f' or"),
        (with_times(clock("%Y-%m-%d %H:%M:%S")), "different times in 1200 rows, too coarse"),
        (with_times([f"{0.004 * (k // 2):.3f}" for k in range(len(T))]), "only 600 different times in 1200 rows"),
        (with_times(clock("%H h %M min %S.%f")), "column 'Time' is '12 h 59 min 57.000000'; expected a number"),
        (with_times([f"{t / 86_400 + 0.5:.12f}" for t in T]), "its steps are 2.3"),
        (NAMES + "\n".join(CELLS[::-1]) + "\n", "the newest row is first; reverse the rows"),
        (NAMES + CELLS[0] + "\n", "position: 'position_mm' has 1 samples"),
        ("\0\1\2" * 99, "not a text table, but binary data"),
        ("PK\3\4\0\0" * 99, "but an Excel workbook or a zip archive; save the sheet as CSV"),
        ("Dear reader,\nthis is a letter.\n", "no cell from line 2 on is a number; expected rows of numbers"),
    ],
)
def test_what_cannot_be_read_is_named_and_nothing_is_written(tmp_path, capsys, text, message):
    (tmp_path / "log.csv").write_text(text)
    assert main(["import", str(tmp_path / "log.csv"), "--out", str(tmp_path / "bag")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "bag").exists()


def test_rows_that_begin_with_blank_cells_keep_their_header(tmp_path):
    cells = [row.split(",") for row in CELLS]
    rows = [f"{t},,{i}," if k < 3 else f"{t},{x},{i},{f}" for k, (t, x, i, f) in enumerate(cells)]
    proposal = propose(tmp_path, NAMES + "\n".join(rows) + "\n")
    assert proposal.log.names == ("time_s", "position_mm", "current_A", "force_N")
    assert "blank cells are missing samples (3 of position, 3 of force)" in proposal.found


def table(*columns):
    """Return a table of these cells, separated by semicolons."""
    return NAMES.replace(",", ";") + "\n".join(";".join(row) for row in zip(*columns, strict=True)) + "\n"


COMMAS = [[f"{value:.6f}".replace(".", ",") for value in column] for column in SIGNALS[:3]]
WHOLE = [[str(round(1e3 * value)) for value in column] for column in SIGNALS[:3]]
THOUSANDS = [f"{round(10 * value):,}" for value in F]
SLOW = [
    ",".join([c if k % 60 == 0 or n != 1 else "" for n, c in enumerate(row.split(","))]) for k, row in enumerate(CELLS)
]


def two_times(later_s):
    """Return a table whose position has times of its own, earlier than those of the others."""
    cells = zip(*(values.tolist() for values in SIGNALS), strict=True)
    rows = "\n".join(f"{t},{x},{t + later_s},{i},{f}" for t, x, i, f in cells)
    return f"t_x [s],x [mm],t_i [s],i [A],F [N]\n{rows}\n"


DOUBTS = {
    "without thousands separators": table(*COMMAS, [cell.replace(",", ".") for cell in THOUSANDS]),
    "a number without thousands separators": table(*WHOLE, THOUSANDS).replace("time_s", "time_ms"),
    "expected decimals by ',' as elsewhere": table(*COMMAS, [f"{force:.1f}" for force in F]),
    "columns 't_x [s]' and 't_i [s]' are both times and differ": two_times(0.0007),
    "'position_mm' is named like it, but jumps like noise from sample to sample": NAMES + "\n".join(SLOW) + "\n",
    "force: the same motion as column 4 (force): take the one that is measured": NAMES.strip()
    + ",force_N\n"
    + "\n".join(f"{row},{row.rsplit(',', 1)[1]}" for row in CELLS),
}


@pytest.mark.parametrize("doubt", DOUBTS)
def test_what_is_doubtful_is_named(tmp_path, doubt):
    assert doubt in propose(tmp_path, DOUBTS[doubt]).doubts[0]


def test_the_same_time_may_be_there_twice(tmp_path):
    assert_recording(read(tmp_path, two_times(0.0)), slow=False)


# ----------------- Signals files proposed from bags with other names, types and units, beside topics that look alike.


ROOT = Path(__file__).parents[3]
pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")
TEMPERATURE = "sensor_msgs/msg/Temperature"
IMAGE, BYTES = "sensor_msgs/msg/CompressedImage", "std_msgs/msg/UInt8MultiArray"
BAG_T, BAG_X, BAG_CURRENT, BAG_F = bags.motion()


def proposed(tmp_path, *streams, store=tiny.JAZZY):
    """The proposal for a bag of these topics, and the bag read with the proposed file."""
    path = tiny.write(tmp_path / "bag", streams, store=store)
    proposal = propose_signals([path])
    (tmp_path / "proposed.yaml").write_text(proposal.text)
    return proposal, path


def reread(tmp_path, path, damper=""):
    file = tmp_path / "proposed.yaml"
    return read_recording(path, load_signals(Path(f"{file}#{damper}") if damper else file))


def assert_reads(recording, x=BAG_X, i=BAG_CURRENT, f=BAG_F, rtol=1e-6):
    for name, values in (("position", x), ("current", i), ("force", f)):
        np.testing.assert_allclose(recording.channel(name).values, values, rtol=rtol, atol=1e-6 * np.abs(values).max())


def test_a_sample_bag_gives_the_packaged_file(tmp_path):
    proposal = propose_signals([ROOT / "bags" / "sine_4hz"])
    (tmp_path / "s.yaml").write_text(proposal.text)
    mine, packaged = load_signals(tmp_path / "s.yaml"), load_signals(ROOT / "config" / "signals.yaml")
    for signal in ("position", "current", "force"):
        assert mine[signal].topic.lstrip("/") == packaged[signal].topic
        assert mine[signal].field == packaged[signal].field
        assert (mine[signal].scale, mine[signal].offset) == (1.0, 0.0)
    assert proposal.selection.checks == ()


def test_renamed_topics_beside_distractors(tmp_path):
    stream, numbers, oil = bags.stream, bags.numbers, tiny.TYPES[TEMPERATURE]
    streams = [
        bags.joints("/rig/joints", ["wheel", "piston"], np.sin(BAG_T), BAG_X),
        bags.numbers("/rig/solenoid", BAG_CURRENT),
        bags.wrenches("/rig/loadcell", BAG_F),
        stream(
            "/oil",
            TEMPERATURE,
            lambda t, v: oil(header=tiny.header(t), temperature=v, variance=0.0),
            40.0 + 1e-3 * BAG_T,
        ),
        *(
            numbers(topic, v)
            for topic, v in (("/stroke_cmd", BAG_X), ("/desired_force", BAG_F), ("/cycle_counter", BAG_T))
        ),
        numbers("/battery/current", 4.0 + np.random.default_rng(3).normal(0, 0.05, len(BAG_X))),
    ]
    proposal, path = proposed(tmp_path, *streams)
    assert_reads(reread(tmp_path, path))
    assert proposal.selection.missing == ()
    rejected = {r.candidate.topic: r.why for c in proposal.selection.dampers[""].choices.values() for r in c.others}
    assert "a command by its name" in rejected["/stroke_cmd"]
    assert "'battery' in its name" in rejected["/battery/current"]


def test_front_and_rear_become_two_dampers_that_share_a_current(tmp_path):
    _, x2, _, f2 = bags.motion(seed=1.0)
    streams = [
        bags.joints("/joint_states", ["front_damper", "rear_damper"], BAG_X, x2),
        bags.numbers("/valve_current", BAG_CURRENT),
        bags.wrenches("/front/force", BAG_F),
        bags.wrenches("/rear/force", f2),
    ]
    proposal, path = proposed(tmp_path, *streams)
    assert set(proposal.selection.names) == {"front", "rear"}
    assert_reads(reread(tmp_path, path, "front"))
    assert_reads(reread(tmp_path, path, "rear"), x2, BAG_CURRENT, f2)


def test_a_bag_without_a_signal_is_refused_with_what_it_has(tmp_path):
    path = tiny.write(tmp_path / "bag", [bags.numbers("/cycle_counter", np.arange(100.0))])
    with pytest.raises(
        RecordingError, match="nothing looks like position, current or force; it has /cycle_counter data"
    ):
        propose_signals([path])


def test_names_that_yaml_would_read_otherwise_are_quoted(tmp_path):
    streams = [
        bags.numbers("/rig/lvdt: mm #1", BAG_X),
        bags.numbers("/coil/current", BAG_CURRENT),
        bags.wrenches("/load", BAG_F),
    ]
    path = tiny.write(tmp_path / "run\nposition", streams)
    proposal = propose_signals([path])
    (tmp_path / "proposed.yaml").write_text(proposal.text)
    assert 'topic: "/rig/lvdt: mm #1"' in proposal.text
    assert "topic: /coil/current\n" in proposal.text
    assert_reads(reread(tmp_path, path))


STORE = bags.custom_store()
X_MM, X_TURNED, F_TURNED = 1000 * BAG_X, -BAG_X, -BAG_F
NOISY = BAG_F + np.random.default_rng(1).normal(0, 400.0, len(BAG_F))


def others(*, x=True, current=True, force=True):
    """Return plain topics for these signals."""
    plain = ((x, bags.numbers, "/stroke", BAG_X), (current, bags.numbers, "/current", BAG_CURRENT))
    return [
        make(topic, v) for is_there, make, topic, v in (*plain, (force, bags.wrenches, "/force", BAG_F)) if is_there
    ]


READ = {  # what makes the topics, and words of the proposal for them
    "types that only the bag defines, in other units": (
        lambda: [
            bags.stamped("/stroke_mm", X_MM, STORE),
            bags.stamped("/load_kN", BAG_F / 1000, STORE),
            *others(x=False, force=False),
        ],
        "unit mm from the topic's name",
    ),
    "units by range": (
        lambda: [
            bags.numbers("/lvdt", X_MM),
            bags.numbers("/coil", 1000 * BAG_CURRENT),
            bags.wrenches("/force", BAG_F / 1000),
        ],
        "CHECK: taken as mm",
    ),
    "a turned position": (
        lambda: [bags.numbers("/stroke_mm", -X_MM), *others(x=False)],
        "scale: -0.001  # mm to SI, sign turned",
    ),
    "a turned force": (lambda: [bags.wrenches("/force", F_TURNED), *others(force=False)], "scale: -1.0  # sign turned"),
    "an extension": (
        lambda: [
            bags.numbers("/extension", X_TURNED),
            bags.wrenches("/force", F_TURNED),
            *others(x=False, force=False),
        ],
        "named 'extension', so positive in rebound",
    ),
    "a joint named damper": (
        lambda: [bags.joints("/joint_states", ["elbow", "damper"], BAG_X + 0.1, BAG_X), *others(x=False)],
        "[damper]",
    ),
    "an array without names": (
        lambda: [bags.array("/daq", BAG_X, BAG_CURRENT, BAG_F, 40.0 + BAG_T, 0.0 * BAG_T + 0.5)],
        "by its numbers alone",
    ),
    "constants beside the current": (
        lambda: [
            bags.array("/valve/current", 0.0 * BAG_X + 0.5, BAG_CURRENT, 0.0 * BAG_X + 2.0),
            *others(current=False),
        ],
        "data[1]",
    ),
    "a variance": (lambda: [bags.numbers("/current/variance", np.zeros(len(BAG_X))), *others()], "topic: /current\n"),
    "estimates of an observer": (
        lambda: [bags.joints("/observer/estimate", ["rear_damper"], BAG_X, efforts=[BAG_F * 0.98]), *others()],
        "topic: /force",
    ),
}
NOT_READ = {  # what makes the topics, the signals that are missing, and words of the proposal
    "an array in any order": (
        lambda: [bags.array("/daq", 30 * BAG_X / BAG_X.max(), 40 * BAG_F / BAG_F.max()), *others(x=False, force=False)],
        {"position", "force"},
        "# position: {topic: /daq",
    ),
    "two equal forces": (
        lambda: [
            *(bags.wrenches(topic, values) for topic, values in (("/load_upper", BAG_F), ("/load_lower", NOISY))),
            *others(force=False),
        ],
        {"force"},
        "2 candidates are equally good",
    ),
    "a command": (
        lambda: [bags.numbers("/valve_cmd", BAG_CURRENT), *others(current=False)],
        {"current"},
        "# current: {topic: /valve_cmd",
    ),
    "a passive damper": (lambda: others(current=False), {"current"}, "# current: {constant: 0.0}"),
}


@pytest.mark.parametrize("name", READ)
def test_signals_are_found(tmp_path, name):
    make, words = READ[name]
    proposal, path = proposed(tmp_path, *make(), store=STORE)
    assert words in proposal.text
    assert_reads(reread(tmp_path, path))
    assert bool(proposal.selection.checks) == (name in ("units by range", "an array without names"))


@pytest.mark.parametrize("name", NOT_READ)
def test_what_cannot_be_known_is_not_guessed(tmp_path, name):
    make, missing, words = NOT_READ[name]
    proposal, _ = proposed(tmp_path, *make())
    assert {one.signal for one in proposal.selection.missing} == missing
    assert words in proposal.text


def test_images_are_passed_over_and_several_bags_examined_together(tmp_path):
    image = tiny.TYPES[IMAGE](header=tiny.header(0), format="png", data=np.zeros(50_000, dtype=np.uint8))
    layout = tiny.TYPES["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    large = tiny.TYPES[BYTES](layout=layout, data=image.data)
    begin = bags.stamps()[0]
    more = [("/camera", IMAGE, [(begin, image)]), ("/blob", BYTES, [(begin, large)]), bags.numbers("/u", BAG_CURRENT)]
    one = tiny.write(tmp_path / "one", [*others(), *more])
    proposal = propose_signals([one, tiny.write(tmp_path / "two", others())])
    assert proposal.skipped["/camera"] == "not a sensor's type"
    assert proposal.skipped["/blob"].startswith("messages of 500")
    assert proposal.selection.missing == () and "topic: /u" not in proposal.text
