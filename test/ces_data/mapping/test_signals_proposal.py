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


@pytest.mark.parametrize("name", ["noise", "sweep", "sine_4hz", "road"])
def test_sample_bags_give_the_packaged_file(tmp_path, name):
    proposal = propose_signals([ROOT / "bags" / name])
    (tmp_path / "s.yaml").write_text(proposal.text)
    mine, packaged = load_signals(tmp_path / "s.yaml"), load_signals(ROOT / "config" / "signals.yaml")
    for signal in ("position", "current", "force"):
        assert mine[signal].topic.lstrip("/") == packaged[signal].topic
        assert mine[signal].field == packaged[signal].field
        assert (mine[signal].scale, mine[signal].offset) == (1.0, 0.0)
    assert proposal.selection.checks == ()


def test_renamed_topics_beside_distractors(tmp_path):
    streams = [
        bags.joints("/rig/joints", ["wheel", "piston"], np.sin(T), X),
        bags.numbers("/rig/solenoid", CURRENT),
        bags.wrenches("/rig/loadcell", F),
        *bags.distractors(X, F),
    ]
    proposal, path = proposed(tmp_path, *streams)
    assert_reads(reread(tmp_path, path))
    assert proposal.selection.missing == ()
    rejected = {r.candidate.topic: r.why for c in proposal.selection.dampers[""].choices.values() for r in c.others}
    assert "a command by its name" in rejected["/stroke_cmd"]
    assert "'battery' in its name" in rejected["/battery/current"]


def test_custom_types_that_only_the_bag_defines_in_other_units(tmp_path):
    store = bags.custom_store()
    streams = [
        bags.stamped("/stroke_mm", 1000 * X + 150.0, store),
        bags.stamped("/valve_current_mA", 1000 * CURRENT, store),
        bags.stamped("/load_kN", F / 1000, store),
    ]
    proposal, path = proposed(tmp_path, *streams, store=store)
    assert_reads(reread(tmp_path, path), x=X + 0.15)
    assert "unit mm from the topic's name" in proposal.text


def test_units_by_range_are_marked_if_they_are_not_si(tmp_path):
    streams = [
        bags.numbers("/lvdt", 1000 * X + 150.0),
        bags.numbers("/coil", 1000 * CURRENT),
        bags.wrenches("/force", F / 1000),
    ]
    proposal, path = proposed(tmp_path, *streams)
    assert_reads(reread(tmp_path, path), x=X + 0.15)
    assert [check.partition(":")[0] for check in proposal.selection.checks] == ["position", "current", "force"]
    assert "CHECK: taken as mm" in proposal.text


def test_a_turned_position_gets_a_negative_scale(tmp_path):
    streams = [bags.numbers("/stroke_mm", -1000 * X), bags.numbers("/current", CURRENT), bags.wrenches("/force", F)]
    proposal, path = proposed(tmp_path, *streams)
    assert "scale: -0.001  # mm to SI, sign turned" in proposal.text
    assert "larger peak, that in rebound, is negative as it should be" in " ".join(proposal.text.split()).replace(
        "# ", ""
    )
    assert_reads(reread(tmp_path, path))


def test_a_turned_force_gets_a_negative_scale(tmp_path):
    streams = [bags.numbers("/stroke", X), bags.numbers("/current", CURRENT), bags.wrenches("/force", -F)]
    proposal, path = proposed(tmp_path, *streams)
    assert "scale: -1.0  # sign turned" in proposal.text
    assert_reads(reread(tmp_path, path))


def test_a_position_named_extension_is_turned_with_its_force(tmp_path):
    streams = [bags.numbers("/extension", -X), bags.numbers("/current", CURRENT), bags.wrenches("/force", -F)]
    proposal, path = proposed(tmp_path, *streams)
    assert "named 'extension', so positive in rebound" in proposal.text
    assert_reads(reread(tmp_path, path))


def test_front_and_rear_become_two_dampers(tmp_path):
    _, x2, i2, f2 = bags.motion(seed=1.0)
    streams = [
        bags.joints("/joint_states", ["front_damper", "rear_damper"], X, x2),
        bags.numbers("/front/valve_current", CURRENT),
        bags.numbers("/rear/valve_current", i2),
        bags.wrenches("/front/force", F),
        bags.wrenches("/rear/force", f2),
    ]
    proposal, path = proposed(tmp_path, *streams)
    assert set(proposal.selection.names) == {"front", "rear"}
    assert_reads(reread(tmp_path, path, "front"))
    assert_reads(reread(tmp_path, path, "rear"), x2, i2, f2)


def test_numbered_dampers_share_a_current(tmp_path):
    _, x2, _, f2 = bags.motion(seed=1.0)
    streams = [
        bags.numbers("/damper_1/stroke", X),
        bags.numbers("/damper_2/stroke", x2),
        bags.numbers("/valve_current", CURRENT),
        bags.wrenches("/damper_1/force", F),
        bags.wrenches("/damper_2/force", f2),
    ]
    proposal, path = proposed(tmp_path, *streams)
    assert proposal.selection.names == ("damper_1", "damper_2")
    assert_reads(reread(tmp_path, path, "damper_2"), x2, CURRENT, f2)


def test_a_joint_named_damper_goes_before_another_joint_that_moves_alike(tmp_path):
    streams = [
        bags.joints("/joint_states", ["elbow", "damper"], X + 0.1, X),
        bags.numbers("/valve_current", CURRENT),
        bags.wrenches("/force", F),
    ]
    _, path = proposed(tmp_path, *streams)
    assert_reads(reread(tmp_path, path))


def test_a_bag_with_the_observers_estimates_gives_the_measured_signals(tmp_path):
    estimate = bags.joints("/observer/estimate", ["rear_damper"], X, efforts=[F * 0.98])
    streams = [bags.joints("/joint_states", ["rear_damper"], X), bags.numbers("/valve_current", CURRENT)]
    proposal, path = proposed(tmp_path, *streams, bags.wrenches("/measured_force", F), estimate)
    assert_reads(reread(tmp_path, path))
    assert proposal.selection.checks == ()


def test_an_array_without_names_is_read_by_its_numbers_and_marked(tmp_path):
    proposal, path = proposed(tmp_path, bags.array("/daq", X, CURRENT, F, 40.0 + T))
    assert_reads(reread(tmp_path, path))
    assert sum("by its numbers alone" in check for check in proposal.selection.checks) == 3


def test_an_array_whose_order_cannot_be_known_is_not_guessed(tmp_path):
    proposal, _ = proposed(
        tmp_path, bags.array("/daq", 30 * X / X.max(), 40 * F / F.max()), bags.numbers("/coil", CURRENT)
    )
    assert {missing.signal for missing in proposal.selection.missing} == {"position", "force"}
    assert "# not found: position" in proposal.text
    assert "# position: {topic: /daq" in proposal.text


def test_two_forces_that_are_equally_good_are_both_named(tmp_path):
    streams = [
        bags.numbers("/stroke", X),
        bags.numbers("/current", CURRENT),
        bags.wrenches("/load_upper", F),
        bags.wrenches("/load_lower", F + np.random.default_rng(1).normal(0, 400.0, len(F))),
    ]
    proposal, _ = proposed(tmp_path, *streams)
    (missing,) = proposal.selection.missing
    assert missing.signal == "force"
    assert "2 candidates are equally good" in missing.reason
    assert "/load_upper" in proposal.text
    assert "/load_lower" in proposal.text


def test_a_passive_damper_gets_the_line_for_a_constant(tmp_path):
    proposal, _ = proposed(tmp_path, bags.numbers("/stroke", X), bags.wrenches("/force", F))
    assert "# current: {constant: 0.0}" in proposal.text


def test_a_current_that_was_only_commanded_is_not_taken_for_measured(tmp_path):
    streams = [bags.numbers("/stroke", X), bags.numbers("/valve_cmd", CURRENT), bags.wrenches("/force", F)]
    proposal, _ = proposed(tmp_path, *streams)
    (missing,) = proposal.selection.missing
    assert missing.signal == "current"
    assert "# current: {topic: /valve_cmd" in proposal.text
    assert "a command by its name ('cmd')" in proposal.text


@pytest.mark.parametrize(
    ("storage", "compression"),
    [
        (tiny.StoragePlugin.MCAP, tiny.CompressionMode.NONE),
        (tiny.StoragePlugin.SQLITE3, tiny.CompressionMode.NONE),
        (tiny.StoragePlugin.SQLITE3, tiny.CompressionMode.FILE),
    ],
)
def test_every_storage(tmp_path, storage, compression):
    path = tiny.write(tmp_path / "bag", tiny.drive(), storage=storage, compression=compression)
    choices = propose_signals([path]).selection.dampers[""].choices
    assert {name: choice.candidate.topic for name, choice in choices.items()} == {
        "position": "/joint_states",
        "current": "/valve_current",
        "force": "/measured_force",
    }


def test_images_are_passed_over(tmp_path):
    kind = "sensor_msgs/msg/CompressedImage"
    image = tiny.TYPES[kind](header=tiny.header(0), format="png", data=np.zeros(50_000, dtype=np.uint8))
    large = tiny.TYPES["std_msgs/msg/UInt8MultiArray"](
        layout=tiny.TYPES["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0), data=np.zeros(50_000, dtype=np.uint8)
    )
    streams = [bags.numbers("/stroke", X), bags.numbers("/current", CURRENT), bags.wrenches("/force", F)]
    streams += [("/camera", kind, [(bags.stamps()[0], image)])]
    streams += [("/blob", "std_msgs/msg/UInt8MultiArray", [(bags.stamps()[0], large)])]
    proposal, path = proposed(tmp_path, *streams)
    assert_reads(reread(tmp_path, path))
    assert proposal.skipped["/camera"] == "not a sensor's type"
    assert proposal.skipped["/blob"].startswith("messages of 500")


def test_the_four_dampers_of_a_car_get_their_own_topics(tmp_path):
    sides = ("front_left", "front_right", "rear_left", "rear_right")
    motions = {side: bags.motion(seed=0.3 * k)[1:] for k, side in enumerate(sides)}
    names = ("stroke", "current", "force")
    streams = [
        bags.numbers(f"/{side}/{name}", values)
        for side, signals in motions.items()
        for name, values in zip(names, signals, strict=True)
    ]
    proposal, path = proposed(tmp_path, *streams)
    assert proposal.selection.names == sides
    for side, signals in motions.items():
        assert_reads(reread(tmp_path, path, side), *signals)


def test_several_bags_are_examined_together(tmp_path):
    one = tiny.write(
        tmp_path / "one", [bags.numbers("/stroke", X), bags.wrenches("/force", F), bags.numbers("/u", CURRENT)]
    )
    two = tiny.write(tmp_path / "two", [bags.numbers("/stroke", X), bags.wrenches("/force", F)])
    proposal = propose_signals([one, two])
    assert "/stroke" in proposal.text
    assert "topic: /u" not in proposal.text


def test_a_bag_without_a_signal_is_refused_with_what_it_has(tmp_path):
    path = tiny.write(tmp_path / "bag", [bags.numbers("/cycle_counter", np.arange(100.0))])
    with pytest.raises(
        RecordingError, match="nothing looks like position, current or force; it has /cycle_counter data"
    ):
        propose_signals([path])


def test_a_number_that_changes_is_taken_before_constant_ones_beside_it(tmp_path):
    def constant(value):
        return np.full(len(X), value)

    streams = [
        bags.numbers("/position", X),
        bags.array("/dyno/current", constant(0.5), CURRENT, constant(2.0)),
        bags.wrenches("/force", F),
    ]
    proposal, path = proposed(tmp_path, *streams)
    assert proposal.selection.missing == ()
    assert_reads(reread(tmp_path, path))


def test_a_variance_is_no_measurement(tmp_path):
    streams = [
        bags.numbers("/position", X),
        bags.numbers("/valve_current/variance", np.zeros(len(X))),
        bags.numbers("/valve_current/data", CURRENT),
        bags.wrenches("/force", F),
    ]
    _, path = proposed(tmp_path, *streams)
    assert_reads(reread(tmp_path, path))
    only = [stream for stream in streams if stream is not streams[2]]
    missing = propose_signals([tiny.write(tmp_path / "without", only)]).selection.missing
    assert [one.signal for one in missing] == ["current"]


def test_names_that_yaml_would_read_otherwise_are_quoted(tmp_path):
    streams = [bags.numbers("/rig/lvdt: mm #1", X), bags.numbers("/coil/current", CURRENT), bags.wrenches("/load", F)]
    path = tiny.write(tmp_path / "run\nposition", streams)
    proposal = propose_signals([path])
    (tmp_path / "proposed.yaml").write_text(proposal.text)
    assert 'topic: "/rig/lvdt: mm #1"' in proposal.text
    assert "topic: /coil/current\n" in proposal.text
    assert_reads(reread(tmp_path, path))
