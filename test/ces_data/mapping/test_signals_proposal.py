"""Signals files proposed from bags with other names, types and units, beside topics that look alike."""

from pathlib import Path

import numpy as np
import proposal_bags as bags
import pytest
import tiny_bags as tiny

from ces_data.bags.reader import read_recording
from ces_data.mapping.proposals import propose_signals
from ces_data.signals_file import load_signals
from ces_observer.errors import RecordingError

ROOT = Path(__file__).parents[3]
pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")
TEMPERATURE = "sensor_msgs/msg/Temperature"
IMAGE, BYTES = "sensor_msgs/msg/CompressedImage", "std_msgs/msg/UInt8MultiArray"
T, X, CURRENT, F = bags.motion()


def proposed(tmp_path, *streams, store=tiny.JAZZY):
    """The proposal for a bag of these topics, and the bag read with the proposed file."""
    path = tiny.write(tmp_path / "bag", streams, store=store)
    proposal = propose_signals([path])
    (tmp_path / "proposed.yaml").write_text(proposal.text)
    return proposal, path


def reread(tmp_path, path, damper=""):
    file = tmp_path / "proposed.yaml"
    return read_recording(path, load_signals(Path(f"{file}#{damper}") if damper else file))


def assert_reads(recording, x=X, i=CURRENT, f=F, rtol=1e-6):
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
        bags.joints("/rig/joints", ["wheel", "piston"], np.sin(T), X),
        bags.numbers("/rig/solenoid", CURRENT),
        bags.wrenches("/rig/loadcell", F),
        stream(
            "/oil", TEMPERATURE, lambda t, v: oil(header=tiny.header(t), temperature=v, variance=0.0), 40.0 + 1e-3 * T
        ),
        *(numbers(topic, v) for topic, v in (("/stroke_cmd", X), ("/desired_force", F), ("/cycle_counter", T))),
        numbers("/battery/current", 4.0 + np.random.default_rng(3).normal(0, 0.05, len(X))),
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
        bags.joints("/joint_states", ["front_damper", "rear_damper"], X, x2),
        bags.numbers("/valve_current", CURRENT),
        bags.wrenches("/front/force", F),
        bags.wrenches("/rear/force", f2),
    ]
    proposal, path = proposed(tmp_path, *streams)
    assert set(proposal.selection.names) == {"front", "rear"}
    assert_reads(reread(tmp_path, path, "front"))
    assert_reads(reread(tmp_path, path, "rear"), x2, CURRENT, f2)


def test_a_bag_without_a_signal_is_refused_with_what_it_has(tmp_path):
    path = tiny.write(tmp_path / "bag", [bags.numbers("/cycle_counter", np.arange(100.0))])
    with pytest.raises(
        RecordingError, match="nothing looks like position, current or force; it has /cycle_counter data"
    ):
        propose_signals([path])


def test_names_that_yaml_would_read_otherwise_are_quoted(tmp_path):
    streams = [bags.numbers("/rig/lvdt: mm #1", X), bags.numbers("/coil/current", CURRENT), bags.wrenches("/load", F)]
    path = tiny.write(tmp_path / "run\nposition", streams)
    proposal = propose_signals([path])
    (tmp_path / "proposed.yaml").write_text(proposal.text)
    assert 'topic: "/rig/lvdt: mm #1"' in proposal.text
    assert "topic: /coil/current\n" in proposal.text
    assert_reads(reread(tmp_path, path))


STORE = bags.custom_store()
X_MM, X_TURNED, F_TURNED = 1000 * X, -X, -F
NOISY = F + np.random.default_rng(1).normal(0, 400.0, len(F))


def others(*, x=True, current=True, force=True):
    """Return plain topics for these signals."""
    plain = ((x, bags.numbers, "/stroke", X), (current, bags.numbers, "/current", CURRENT))
    return [make(topic, v) for is_there, make, topic, v in (*plain, (force, bags.wrenches, "/force", F)) if is_there]


READ = {  # what makes the topics, and words of the proposal for them
    "types that only the bag defines, in other units": (
        lambda: [
            bags.stamped("/stroke_mm", X_MM, STORE),
            bags.stamped("/load_kN", F / 1000, STORE),
            *others(x=False, force=False),
        ],
        "unit mm from the topic's name",
    ),
    "units by range": (
        lambda: [bags.numbers("/lvdt", X_MM), bags.numbers("/coil", 1000 * CURRENT), bags.wrenches("/force", F / 1000)],
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
        lambda: [bags.joints("/joint_states", ["elbow", "damper"], X + 0.1, X), *others(x=False)],
        "[damper]",
    ),
    "an array without names": (
        lambda: [bags.array("/daq", X, CURRENT, F, 40.0 + T, 0.0 * T + 0.5)],
        "by its numbers alone",
    ),
    "constants beside the current": (
        lambda: [bags.array("/valve/current", 0.0 * X + 0.5, CURRENT, 0.0 * X + 2.0), *others(current=False)],
        "data[1]",
    ),
    "a variance": (lambda: [bags.numbers("/current/variance", np.zeros(len(X))), *others()], "topic: /current\n"),
    "estimates of an observer": (
        lambda: [bags.joints("/observer/estimate", ["rear_damper"], X, efforts=[F * 0.98]), *others()],
        "topic: /force",
    ),
}
NOT_READ = {  # what makes the topics, the signals that are missing, and words of the proposal
    "an array in any order": (
        lambda: [bags.array("/daq", 30 * X / X.max(), 40 * F / F.max()), *others(x=False, force=False)],
        {"position", "force"},
        "# position: {topic: /daq",
    ),
    "two equal forces": (
        lambda: [
            *(bags.wrenches(topic, values) for topic, values in (("/load_upper", F), ("/load_lower", NOISY))),
            *others(force=False),
        ],
        {"force"},
        "2 candidates are equally good",
    ),
    "a command": (
        lambda: [bags.numbers("/valve_cmd", CURRENT), *others(current=False)],
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
    more = [("/camera", IMAGE, [(begin, image)]), ("/blob", BYTES, [(begin, large)]), bags.numbers("/u", CURRENT)]
    one = tiny.write(tmp_path / "one", [*others(), *more])
    proposal = propose_signals([one, tiny.write(tmp_path / "two", others())])
    assert proposal.skipped["/camera"] == "not a sensor's type"
    assert proposal.skipped["/blob"].startswith("messages of 500")
    assert proposal.selection.missing == () and "topic: /u" not in proposal.text
