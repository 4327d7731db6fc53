"""Whatever a model file says, reading it gives a model that runs or one line of ModelError: no crash, hang or code."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from random import Random
from time import process_time
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.fuzz.fuzz_samples import spoil_model
from bench.fuzz.fuzz_targets import READ, REFUSED, try_model
from ces_observer.errors import ModelError
from ces_observer.limits import FileLimits, ProofLimits
from ces_observer.model import load_model, parse_model
from ces_observer.proof import intervals
from ces_observer.proof.intervals import Sums

FUZZ = Path(__file__).resolve().parents[2] / "bench" / "fuzz"
SEEDS = {path.stem: path.read_bytes() for path in sorted((FUZZ / "seeds" / "model").iterdir())}
QUICK = settings(max_examples=200, deadline=None, derandomize=True)
Change = Callable[[dict[str, Any]], object]


def changed(seed: str, change: Change) -> str:
    raw = json.loads(SEEDS[seed])
    change(raw)
    return json.dumps(raw)


def factors(raw: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the factors of the second term, which has one of speed."""
    return raw["terms"][1]["factors"]  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz") / "model.json"


@pytest.mark.slow
def test_spoilt_files_are_read_or_refused(path: Path) -> None:
    seen = set()

    @QUICK
    @given(st.sampled_from(sorted(SEEDS)), st.integers(0, 2**32))
    def holds(seed: str, number: int) -> None:
        path.write_bytes(spoil_model(SEEDS[seed], Random(number)))
        seen.add(try_model(path))

    holds()
    assert seen == {READ, REFUSED}


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner, max_size=4),
    max_leaves=20,
)


@pytest.mark.slow
@QUICK
@given(value=anything, seed=st.sampled_from(sorted(SEEDS)), data=st.data())
def test_any_value_in_any_place_is_read_or_refused(path: Path, value: object, seed: str, data: st.DataObject) -> None:
    raw = at = json.loads(SEEDS[seed])
    while True:
        key = data.draw(st.sampled_from(sorted(at) if isinstance(at, dict) else range(len(at))))
        if not isinstance(at[key], dict | list) or not at[key] or data.draw(st.integers(0, 5)) == 0:
            break
        at = at[key]
    at[key] = value
    path.write_text(json.dumps(raw))
    try_model(path)


def with_text(old: str, new: str) -> str:
    return SEEDS["tight"].decode().replace(old, new)


def with_history(value: object) -> str:
    return changed("tight", lambda raw: raw["provenance"].update(x=value))


def with_factor(**settings: object) -> str:
    return changed("tight", lambda raw: factors(raw)[0].update(settings))


def overflowing(raw: dict[str, Any]) -> None:
    raw["input_envelope"]["speed_m_s"] = [-1e6, 1e6]
    raw["terms"][1]["factors"] = [{"signal": "speed", "lag": k, "power": 8.0, "signed": True} for k in range(4)]


REFUSALS = {
    "a key twice": (with_text('"lag": 1', '"lag": 1, "lag": 2'), "'lag' occurs twice"),
    "NaN": (with_history(float("nan")), "provenance: x is nan; expected a finite number"),
    "infinity": (with_text("0.9", "1e400"), r"terms\[0\]: coefficient is inf"),
    "a huge whole number": (with_history(10**400), r"beyond 2\^63"),
    "thousands of digits": (with_text("0.9", "9" * 5000), "not a JSON file"),
    "half a surrogate": (with_history("\ud800"), "half of a surrogate pair"),
    "a long text": (with_history("x" * 20_000), "at most 10000"),
    "too deep": ('{"a": ' * 50 + "1" + "}" * 50, "nested more than 32 deep"),
    "far too deep": ("[" * 400_000, "nested more than 32 deep"),
    "a byte order mark": ("\ufeff{}", "BOM"),
    "too large": (" " * (FileLimits.MAX_BYTES + 1), "at most 1000000 bytes"),
    "two lines": (changed("tight", lambda raw: raw.update(schema="a\nb")), r"schema is 'a\\nb'"),
    "other units": (changed("tight", lambda raw: raw["units"].update(force="lbf")), "units are not those"),
    "an unknown key": (with_factor(powr=2), "unknown key 'powr'"),
    "a true number": (with_factor(lag=True), "lag is True"),
    "a lag of a million": (with_factor(lag=10**6), "whole number from 0 to 1000"),
    "a gap of many ticks": (
        changed("tight", lambda raw: raw["sampling"].update(max_gap_s=10.0, rate_Hz=1e5)),
        "spans 1000000 ticks",
    ),
    "a product that overflows": (changed("tight", overflowing), r"can grow beyond 1e\+100"),
    "a name of code": (
        changed("constructed", lambda raw: raw["constructed"][0].update(name="run.x()\n")),
        r"name 'run.x\(\)\\n'",
    ),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_what_harms_is_refused_in_one_line(name: str) -> None:
    text, message = REFUSALS[name]
    with pytest.raises(ModelError, match=message) as caught:
        parse_model(text, "m.json")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


def test_what_is_no_file_is_refused(path: Path) -> None:
    os.mkfifo(path.with_name("pipe"))
    for odd in (path.with_name("pipe"), Path("/dev/zero"), path.parent, Path("a\0b")):
        with pytest.raises(ModelError) as caught:
            load_model(odd)
        assert "\n" not in str(caught.value)


def widest() -> str:
    """Return a model as large as a file may ask for, undecided between stable and not."""

    def fill(raw: dict[str, Any]) -> None:
        random = Random(1)
        raw["terms"] = [
            {
                "coefficient": random.choice((-1, 1)) * 0.01,
                "factors": [
                    {"signal": "force", "lag": random.randint(1, 1000)},
                    *(
                        {
                            "signal": random.choice(("speed", "current", "position")),
                            "lag": random.randint(0, 1000),
                            "power": random.uniform(0.1, 1.5),
                            "signed": False,
                        }
                        for _ in range(7)
                    ),
                ],
            }
            for _ in range(500)
        ]

    return changed("tight", fill)


@pytest.mark.slow
def test_the_largest_model_is_read_and_judged_in_bounded_time(monkeypatch: pytest.MonkeyPatch) -> None:
    start = process_time()
    model = parse_model(widest(), "m.json")
    model.make_predictor().tick(0.01, 0.5, 0.5)
    assert process_time() - start < 10.0  # a second on an idle computer
    monkeypatch.setattr(ProofLimits, "MAX_WORK", 300_000)
    groups = [model.body.terms]
    work = Sums(groups).work
    _, boxes = intervals.bound_maximum(groups, model.envelope.by_signal)
    assert work > 10_000 and 2 < boxes <= 300_000 // work + 2


def test_a_proof_stands_what_has_no_size() -> None:
    """Slopes of roots and of signs next to zero are beyond any float: the proof does without them."""

    def tiny(raw: dict[str, Any]) -> None:
        raw["input_envelope"]["speed_m_s"] = [5e-324, 1.0]
        raw["terms"][0]["factors"] += [
            {"signal": "speed", "lag": 0, "power": power, "signed": True} for power in (0.0, 0.1)
        ]

    assert parse_model(changed("tight", tiny), "m.json").is_stable()


def test_names_of_constructed_inputs_make_no_difference_to_the_force() -> None:
    def renamed(raw: dict[str, Any]) -> None:
        for old, new in (
            ("hysteresis", "inf"),
            ("remanence", "forces"),
            ("valve", "arrive"),
            ("by_stop_1", "copysign"),
        ):
            for one in raw["constructed"]:
                one.update({key: new for key in ("name", "of") if one.get(key) == old})
            for term in raw["terms"]:
                for factor in term["factors"]:
                    factor["signal"] = new if factor["signal"] == old else factor["signal"]

    plain, other = (parse_model(changed("constructed", change), "m.json") for change in (lambda raw: None, renamed))
    assert other.body.constructed[0].name == "arrive"
    one, two = plain.make_predictor(), other.make_predictor()
    inputs = [(0.01 * (k % 5), 0.3 * (-1) ** k, 0.1 * (k % 7)) for k in range(50)]
    assert [one.tick(*u) for u in inputs] == pytest.approx([two.tick(*u) for u in inputs], rel=1e-12)
