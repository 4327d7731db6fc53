from types import SimpleNamespace as Message

import pytest

from ces_observer.errors import SignalsError
from ces_observer.signals import DEFAULTS, NAMES, UNITS, Constant, FieldPath, Signal, Signals, override

JOINTS = Message(name=["fork", "rear"], position=[0.1, 0.2], effort=[])
WRENCH = Message(wrench=Message(force=Message(x=1, y=2.5, z=True)))
NESTED = Message(joint_names=["a", "b"], points=[Message(values=[1, 2]), Message(values=[3, 4])], label="x")


@pytest.mark.parametrize(
    ("message", "path", "value"),
    [
        (Message(data=3), "data", 3.0),
        (WRENCH, "wrench.force.y", 2.5),
        (WRENCH, "wrench.force.z", 1.0),
        (JOINTS, "position[1]", 0.2),
        (JOINTS, "position[fork]", 0.1),
        (JOINTS, " position[ rear ] ", 0.2),
        (NESTED, "points[b].values[0]", 3.0),
    ],
)
def test_path_finds_the_number(message, path, value):
    assert FieldPath.parse(path).read(message) == value


@pytest.mark.parametrize(
    ("message", "path", "told"),
    [
        (JOINTS, "velocity[0]", "no 'velocity' in SimpleNamespace"),
        (Message(data=1.0), "data[0]", r"'data\[0\]': a float is no array; remove \[0\]"),
        (JOINTS, "position[2]", "index 2 is outside an array of 2"),
        (JOINTS, "effort[rear]", "index 1 is outside an array of 0"),
        (JOINTS, "position[seat]", r"no joint 'seat'; the message has \['fork', 'rear'\]"),
        (Message(position=[1.0]), "position[seat]", "the message has no names"),
        (JOINTS, "position", "is a list, not a number"),
        (WRENCH, "wrench.torque.z", "no 'torque' in SimpleNamespace"),
        (NESTED, "label", "is a str, not a number"),
    ],
)
def test_a_missing_path_raises(message, path, told):
    with pytest.raises(SignalsError, match=told) as caught:
        FieldPath.parse(path).read(message)
    assert f"field '{path}'" in str(caught.value)


@pytest.mark.parametrize(
    "path", ["", ".", "a..b", "a[", "a[]", "a]0[", "a[b]c", "a[0][1]", "1a", "a b", "a.b\n.", "a-b"]
)
def test_path_that_is_none(path):
    with pytest.raises(SignalsError, match="not a field name with an optional"):
        FieldPath.parse(path)


def test_defaults_describe_position_current_and_force():
    signals = Signals.from_mapping({}, "here")
    assert {s.name: (s.topic, s.type, s.field.text) for s in signals.list_topic_signals()} == {
        name: tuple(settings.values()) for name, settings in DEFAULTS.items()
    }
    assert all(signals[name].unit == UNITS[name] for name in DEFAULTS)
    assert [(s.scale, s.offset) for s in signals.list_topic_signals()] == [(1.0, 0.0)] * 3


def test_reader_scales_to_si():
    signals = Signals.from_mapping({"position": {"field": "position[rear]", "scale": -0.5, "offset": 3}}, "here")
    position = signals["position"]
    assert isinstance(position, Signal)
    assert position.make_reader()(JOINTS) == -0.5 * 0.2 + 3


@pytest.mark.parametrize(
    ("described", "recorded", "same"),
    [
        ("joints", "/joints", True),
        ("/joints", "/joints", True),
        ("a/joints", "/joints", False),
        ("joint", "/joints", False),
    ],
)
def test_topic_resolves_in_the_root_namespace(described, recorded, same):
    signal = Signals.from_mapping({"position": {"topic": described}}, "here")["position"]
    assert isinstance(signal, Signal)
    assert signal.matches(recorded) is same


def test_constant_takes_the_place_of_a_topic():
    signals = Signals.from_mapping({"current": {"constant": 0}}, "here")
    assert signals["current"] == Constant("current", 0.0)
    assert [s.name for s in signals.list_topic_signals()] == ["position", "force"]


def test_optional_signals_are_there_only_if_described():
    given = {"topic": "oil", "type": "sensor_msgs/msg/Temperature", "field": "temperature"}
    assert [s.name for s in Signals.from_mapping({"temperature": given}, "here").list_topic_signals()][
        -1
    ] == "temperature"
    with pytest.raises(SignalsError, match="here: no signal 'temperature'; known are position, current, force"):
        Signals.from_mapping({}, "here")["temperature"]
    assert set(DEFAULTS) < set(NAMES)


def test_other_parameters_of_a_node_are_ignored():
    assert (
        Signals.from_mapping({"rate": 500.0, "use_sim_time": True}, "x").by_name
        == Signals.from_mapping({}, "x").by_name
    )


@pytest.mark.parametrize(
    ("mapping", "told"),
    [
        ({"position": 3}, "signal 'position' is 3; expected a mapping"),
        ({"position": {"topik": "x"}}, "unknown key 'topik'; did you mean 'topic'"),
        (
            {"sim_force": {"topic": "x"}},
            "signal 'sim_force': key 'type' is missing; expected a text; set topic, type and field",
        ),
        ({"force": {"topic": ""}}, "'topic' is missing"),
        ({"force": {"type": "Float64"}}, "type: 'Float64' is not of the form package/msg/Type"),
        ({"force": {"scale": 0}}, "scale is 0; expected the factor"),
        ({"force": {"scale": True}}, "scale is True; expected a number"),
        ({"force": {"offset": float("inf")}}, "offset is inf; expected a number"),
        ({"current": {"constant": "0 A"}}, "constant is '0 A'; expected a number"),
        ({"current": {"field": "a["}}, r"field path 'a\['"),
    ],
)
def test_a_mistake_raises_one_line(mapping, told):
    with pytest.raises(SignalsError, match=told):
        Signals.from_mapping(mapping, "here")


@pytest.mark.parametrize(
    ("common", "own", "merged"),
    [
        (None, None, None),
        ({"scale": 2.0}, None, {"scale": 2.0}),
        (None, {"scale": 2.0}, {"scale": 2.0}),
        ({"scale": 2.0, "topic": "a"}, {"topic": "b"}, {"scale": 2.0, "topic": "b"}),
        ({"constant": 0.0}, {"topic": "b"}, {"topic": "b"}),
        ({"constant": 0.0}, {"scale": 2.0}, {"constant": 0.0, "scale": 2.0}),
        ({"topic": "a"}, {"constant": 1.0}, {"topic": "a", "constant": 1.0}),
    ],
)
def test_what_is_said_for_one_damper_goes_over_what_is_said_for_all(common, own, merged):
    assert override(common, own) == merged
