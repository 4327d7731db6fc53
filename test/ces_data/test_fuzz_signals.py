"""Whatever a signals description says, reading it gives signals or one line of SignalsError."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.fuzz.fuzz import DICTIONARY
from bench.fuzz.fuzz_samples import spoil_bytes
from bench.fuzz.fuzz_targets import READ, REFUSED, try_signals
from ces_data.signals_file import load_signals
from ces_observer.errors import SignalsError
from ces_observer.signals import FieldPath, Signals

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
