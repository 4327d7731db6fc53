from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.fuzz.fuzz import DICTIONARY
from bench.fuzz.fuzz_samples import spoil_bytes
from bench.fuzz.fuzz_targets import READ, REFUSED, try_signals
from ces_data.config_file import MAX_BYTES, read_yaml_mapping
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.signals_file import load_signals
from ces_identify.campaign.plan import load_campaign
from ces_identify.polynomial.rules_file import load_rules
from ces_observer.errors import CesError, SignalsError
from ces_observer.signals import DEFAULTS, Constant, FieldPath, Signal, Signals
from ces_rig.dampers.hydraulic.parameters import load_damper
from ces_rig.experiments.virtual import load_description, load_experiment, load_rig

PACKAGED = Path(__file__).parents[2] / "config" / "signals.yaml"


def load(tmp_path, text):
    path = tmp_path / "signals.yaml"
    path.write_text(text)
    return load_signals(path)


def failure(tmp_path, text):
    with pytest.raises(SignalsError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message
    assert str(tmp_path / "signals.yaml") in message
    return message


def test_no_file_gives_the_defaults():
    signals = load_signals()
    assert {s.name: s.topic for s in signals.list_topic_signals()} == {name: d["topic"] for name, d in DEFAULTS.items()}


def test_packaged_file_says_what_the_defaults_say():
    assert load_signals(PACKAGED).by_name == load_signals().by_name


@pytest.mark.parametrize("head", ["/**:", "observer:", "/front/observer:", "front:\n  observer:"])
def test_any_node_name_namespace_or_wildcard(tmp_path, head):
    depth = "  " * len(head.splitlines())
    text = f"{head}\n{depth}ros__parameters:\n{depth}  use_sim_time: true\n{depth}  position: {{scale: -0.001}}\n"
    position = load(tmp_path, text)["position"]
    assert isinstance(position, Signal)
    assert position.scale == -0.001
    assert position.topic == "joint_states"


def test_dotted_names_as_ros_has_them(tmp_path):
    signals = load(tmp_path, "/**:\n  ros__parameters:\n    force.topic: load_cell\n    force.scale: 9.80665\n")
    assert (signals["force"].topic, signals["force"].scale) == ("load_cell", 9.80665)


def test_named_node_overrides_wildcard_wherever_it_stands_and_other_nodes_are_ignored(tmp_path):
    signals = load(
        tmp_path,
        "observer: {ros__parameters: {position: {scale: 2.0}}}\n"
        "/**: {ros__parameters: {position: {scale: 3.0, offset: 1.0}, current: {topic: amps}}}\n"
        "controller: {ros__parameters: {current: 5, force: {kp: 1}}}\n",
    )
    assert (signals["position"].scale, signals["position"].offset) == (2.0, 1.0)
    assert signals["current"].topic == "amps"


def test_two_nodes_signals_are_ambiguous_and_no_signals_none(tmp_path):
    text = "front: {ros__parameters: {position: {scale: 2.0}}}\nrear: {ros__parameters: {position: {scale: 3.0}}}\n"
    assert "'/front' (line 1) and '/rear' (line 2)" in failure(tmp_path, text)
    assert "describes no signal" in failure(tmp_path, "/**: {ros__parameters: {rate: 500.0}}\n")


@pytest.mark.parametrize(
    ("text", "line", "phrase"),
    [
        ("a: 1\nposition: {scale: 0.0}\n", 2, "scale is 0"),
        ("\n\ncurrent: {topic: }\n", 3, "'topic' is missing"),
        ("current:\n  topc: x\n", 1, "unknown key 'topc'"),
        ("position: {field: 'a..b'}\n", 1, "field path 'a..b'"),
        ("force: {type: Float64}\n", 1, "package/msg/Type"),
        ("force: {scale: .nan}\n", 1, "scale is nan"),
        ("force: 3\n", 1, "expected a mapping"),
    ],
)
def test_mistake_names_file_and_line(tmp_path, text, line, phrase):
    message = failure(tmp_path, text)
    assert phrase in message
    assert f"signals.yaml:{line}:" in message


SEVERAL = """
/**:
  ros__parameters:
    dampers: [front, rear]
    position: {topic: suspension, scale: 0.001}
    current: {constant: 0.0}
    front:
      position: {field: "position[fork]"}
      current: {topic: front_valve}
    rear.position: {field: "position[shock]"}
    rear.current.constant: 0.7
"""


def chosen(tmp_path, damper, text=SEVERAL):
    path = tmp_path / "observer.yaml"
    path.write_text(text)
    return load_signals(path.with_name(f"observer.yaml{damper}"))


def test_one_of_several_dampers_has_its_own_over_what_all_have(tmp_path):
    front, rear = chosen(tmp_path, "#front"), chosen(tmp_path, "#rear")
    for signals, joint in ((front, "fork"), (rear, "shock")):
        position = signals["position"]
        assert (position.topic, position.scale, position.field.text) == ("suspension", 0.001, f"position[{joint}]")
        assert signals["force"].topic == "measured_force"
    assert front["current"].topic == "front_valve"
    assert rear["current"] == Constant("current", 0.7)


@pytest.mark.parametrize(
    ("damper", "text", "phrase"),
    [
        ("", SEVERAL, "describes the dampers front, rear; select one, as in "),
        ("#middle", SEVERAL, "has no damper 'middle'; its dampers are front, rear"),
        ("#front", "position: {scale: 2.0}\n", "has no damper 'front'; it has no parameter 'dampers'"),
        ("", "dampers: front\nposition: {scale: 2.0}\n", "observer.yaml:1: 'dampers' is 'front'; expected a list"),
        ("#front", SEVERAL.replace("front_valve", "''"), "observer.yaml:9: signal 'current': key 'topic' is missing"),
    ],
)
def test_an_unclear_damper_is_refused(tmp_path, damper, text, phrase):
    with pytest.raises(SignalsError) as caught:
        chosen(tmp_path, damper, text)
    assert phrase in str(caught.value)


def test_a_single_named_damper_need_not_be_named_again(tmp_path):
    assert chosen(tmp_path, "", SEVERAL.replace("[front, rear]", "[front]"))["current"].topic == "front_valve"


@pytest.mark.parametrize(
    ("text", "line", "name", "meant"),
    [
        ("postion: {topic: a}\n", 1, "postion", "position"),
        ("position: {scale: 2.0}\nCurrent: {constant: 0.0}\n", 2, "Current", "current"),
        ("/**:\n  ros__parameters:\n    forces.topic: f\n", 3, "forces", "force"),
        (SEVERAL.replace("front:\n      position", "front:\n      positon"), 8, "positon", "position"),
    ],
)
def test_a_misspelled_signal_is_named_with_the_one_that_is_meant(tmp_path, text, line, name, meant):
    damper = "#front" if "dampers" in text else ""
    with pytest.raises(SignalsError, match=rf"observer.yaml:{line}: no signal '{name}'; did you mean {meant}\?"):
        chosen(tmp_path, damper, text)


def test_a_misspelled_section_is_named(tmp_path):
    phrase = r"describes no signal; line 2: 'ros_parameters': did you mean ros__parameters"
    with pytest.raises(SignalsError, match=phrase):
        chosen(tmp_path, "", "/**:\n  ros_parameters:\n    position: {scale: 2.0}\n")


def test_other_parameters_of_a_node_are_no_misspelled_signals(tmp_path):
    others = "seed: 1\ncurrents: [1]\ntorce: {kind: x}\npositions.gain: 2.0\nspeeds: fast\n"
    assert chosen(tmp_path, "", "position: {scale: 2.0}\n" + others)["position"].scale == 2.0


# ------------------------- Whatever a signals description says, reading it gives signals or one line of SignalsError.


SEEDS = Path(__file__).resolve().parents[2] / "bench" / "fuzz" / "seeds" / "signals"
RAWS = [path.read_bytes() for path in sorted(SEEDS.iterdir())]
QUICK = settings(max_examples=80, deadline=None, derandomize=True)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz") / "signals.yaml"


def test_spoilt_files_are_read_or_refused(path: Path) -> None:
    seen = set()

    @QUICK
    @given(st.sampled_from(RAWS), st.integers(0, 2**32))
    def holds(raw: bytes, number: int) -> None:
        path.write_bytes(spoil_bytes(raw, Random(number), DICTIONARY))
        seen.add(try_signals(path))

    holds()
    assert seen == {READ, REFUSED}


keys = st.sampled_from(["topic", "type", "field", "scale", "offset", "constant", "tpoic", 1, None])
values = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20), st.lists(st.integers(), max_size=3)
)
signals = st.one_of(values, st.dictionaries(keys, st.one_of(values, st.just("a/msg/B"), st.just("data")), max_size=6))


@QUICK
@given(st.dictionaries(st.sampled_from(["position", "current", "force", "sim_force", "x"]), signals, max_size=4))
def test_any_mapping_is_taken_or_refused(mapping: dict[str, Any]) -> None:
    try:
        assert Signals.from_mapping(mapping, "parameters")["position"]
    except SignalsError as error:
        assert str(error).isprintable()


@QUICK
@given(st.one_of(st.text(max_size=30), st.from_regex(r"[a-z]+(\[[^\]]*\])?(\.[a-z]+(\[[0-9]+\])?)*", fullmatch=True)))
def test_any_path_is_taken_or_refused(text: str) -> None:
    try:
        path = FieldPath.parse(text)
    except SignalsError as error:
        assert str(error).isprintable()
        return
    assert path.steps and all(name[0].isalpha() and name.isascii() for name, _ in path.steps)
    with pytest.raises(SignalsError):
        path.read(object())


REFUSALS = {
    "an empty number": ('position: {topic: a, scale: !!int ""}\n', "not valid YAML"),
    "a date that is none": ("position: {scale: !!timestamp x}\n", "not valid YAML"),
    "a character beyond Unicode": ('position: {topic: "\\U00110000"}\n', "not valid YAML"),
    "a number beyond floats": (f"position: {{scale: 1{'0' * 400}}}\n", "expected a number from"),
    "a number beyond writing": (f"position: {{scale: 0x{'f' * 9000}}}\n", "too large to write"),
    "a text, then a part": ("position: x\nposition.topic: y\nposition.field: z[\n", "is not a field name"),
    "keys of two kinds": ("position: {1: a, x: b}\n", "unknown key 1"),
    "an index that is no digit": ("position: {field: 'position[²'}\n", "is not a field name"),
    "an index beyond arrays": (f"position: {{field: 'position[{'9' * 5000}]'}}\n", "at most 255"),
    "a field of Python": ("position: {field: __class__.__name__}\n", "is not a field name"),
    "two lines": ('position: {topic: "a\\nb"}\n', "printable"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_what_harms_is_refused_in_one_line(path: Path, name: str) -> None:
    text, message = REFUSALS[name]
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SignalsError, match=message) as caught:
        load_signals(path)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 500


# ---------- Every configuration file of a user comes in by one way: the same mistakes are refused, in the same words.


READERS = (
    *(load_campaign, load_rules, load_dyno_mapping, load_damper, load_experiment, load_description, load_rig),
    *(ANY_KEY := (load_signals, lambda path: read_yaml_mapping(path, "a mapping"))),
)
BOMB = b"a: &a [x, x]\n" + b"".join(b"%c: &%c [*%c, *%c]\n" % (c, c, c - 1, c - 1) for c in range(98, 122))
MISTAKES = (
    (b"- 1\n", ": is not a mapping; expected "),
    (b"", ": is not a mapping; expected "),
    (b"a: [", ":1: not valid YAML: "),
    (b"a: \xff\n", ": is not UTF-8 text; expected "),
    (b"#" * (MAX_BYTES + 1), f": larger than {MAX_BYTES} bytes; expected "),
    (BOMB, ":2: alias '*a'; write the value out"),
    (b"a: " + b"[" * 30 + b"]" * 30, ":1: nested more than 20 deep; remove some levels"),
    (b"force: 1\nforce: 2\n", ":2: 'force' is given twice; keep one"),
    (b"? [1, 2]\n: 3\n", ":1: a key is a list or a mapping; expected a name"),
    (b"force: !!python/object/apply:os.system [ls]\n", ":1: not valid YAML: "),
)
UNKNOWN_KEY = (b"frequenzy: 1\n", ": unknown key 'frequenzy'; expected one of ")


@pytest.mark.parametrize("read", READERS)
def test_a_mistake_is_the_same_line_whatever_the_file(tmp_path: Path, read: Callable[[Path], object]) -> None:
    path = tmp_path / "x.yaml"
    for content, expected in MISTAKES if read in ANY_KEY else (*MISTAKES, UNKNOWN_KEY):
        path.write_bytes(content)
        with pytest.raises(CesError) as caught:
            read(path)
        assert str(caught.value).startswith(f"{path}{expected}")
        assert "\n" not in str(caught.value)
    with pytest.raises(CesError, match=r"none\.yaml: cannot be read: No such file or directory; expected "):
        read(tmp_path / "none.yaml")
