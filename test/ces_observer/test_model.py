import json
import re

import pytest
from model_examples import make_model

from ces_observer.errors import CesError, ModelError
from ces_observer.model import load_model, parse_model


def broken(change):
    raw = json.loads(make_model().to_json())
    change(raw)
    return json.dumps(raw)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.pop("terms"), "key 'terms' is missing"),
        (lambda m: m["sampling"].pop("rate_Hz"), "sampling: key 'rate_Hz' is missing"),
        (lambda m: m.update(schema="ces-model/9"), "schema is 'ces-model/9'"),
        (lambda m: m["terms"][0]["factors"][0].update(lag=10**6), "lag is 1000000; expected a whole number from 0"),
        (lambda m: m["terms"][1]["factors"][0].update(lag=0), "lag is 0; expected a whole number from 1"),
        (lambda m: m["terms"][1]["factors"].append({"signal": "force", "lag": 1}), "more than one past force"),
        (lambda m: m["terms"][0]["factors"][0].update(signal="valve"), "signal is 'valve'; expected one of"),
        (lambda m: m.update(terms=[]), "terms is .*expected a list of 1 to"),
        (lambda m: m.update(structure="pickle"), "structure is 'pickle'"),
        (lambda m: m["input_envelope"].update(speed_m_s=[1.0, -1.0]), "speed_m_s is .*expected \\[low, high\\]"),
        (lambda m: m["sampling"].update(rate_Hz=0), "rate_Hz is 0"),
        (lambda m: m["sampling"].pop("speed_m_s"), "sampling: key 'speed_m_s' is missing"),
        (lambda m: m["sampling"].update(noise_m=0.0), "noise_m is 0.0; expected a number from 1e-12"),
        (lambda m: m["sampling"].update(stroke_m=[0.1, -0.1]), "stroke_m is .*expected \\[low, high\\]"),
        (lambda m: m["sampling"].update(frequencies_Hz=[]), "frequencies_Hz is \\[\\]"),
        (
            lambda m: m["sampling"].update(frequencies_Hz=[3.0] * 13),
            "frequencies_Hz is .*expected a list of 1 to 12 numbers",
        ),
        (
            lambda m: m["sampling"].update(frequencies_Hz=[3.0, 500.0]),
            "frequencies_Hz are .*expected 0 to half the rate",
        ),
        (lambda m: m["sampling"].update(delay_s=0.0035), "delay_s is 0.0035; expected whole ticks of 0.001 s"),
        (lambda m: m["sampling"].update(delay_s=0.021), "delay_s is 0.021; expected a number from 0 to 0.02 s"),
        (
            lambda m: m["sampling"].update(max_gap_s=9.0, rate_Hz=1e5),
            "max_gap_s spans 900000 ticks; expected at most 20000",
        ),
        (lambda m: m["sampling"].update(order=3), "sampling: unknown key 'order'"),
        (lambda m: m["sampling"].update(bandwidth_Hz=60.0), "sampling: written by .*: identify the model again$"),
    ],
)
def test_what_is_wrong_is_named(change, message):
    with pytest.raises(ModelError, match=message) as caught:
        parse_model(broken(change), "m.json")
    assert str(caught.value).startswith("m.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[1]", "null", '"x"', "[" * 100_000])
def test_what_is_not_a_model_is_refused(text):
    with pytest.raises(ModelError, match=re.escape("m.json")):
        parse_model(text, "m.json")


def test_missing_and_oversized_files_are_refused(tmp_path):
    with pytest.raises(ModelError, match="no such model file"):
        load_model(tmp_path / "none.json")
    (tmp_path / "big.json").write_text(" " * 1_000_001)
    with pytest.raises(ModelError, match="at most 1000000"):
        load_model(tmp_path / "big.json")


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "m.json"
    make_model().save(path)
    before = path.read_text()

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("ces_observer.json_text.os.fsync", fail)
    with pytest.raises(CesError, match="No space left"):
        make_model(force_envelope_N=(-1.0, 1.0)).save(path)
    assert path.read_text() == before
    assert [p.name for p in tmp_path.iterdir()] == ["m.json"]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(CesError, match=r"none.m\.json: cannot be written"):
        make_model().save(tmp_path / "none" / "m.json")


def test_a_file_of_an_earlier_version_with_two_models_is_refused():
    raw = json.loads(make_model().to_json()) | {"delayed": {"delay_s": 0.003}}
    with pytest.raises(ModelError, match=r"m\.json: holds a second model in the key 'delayed'; expected one model"):
        parse_model(json.dumps(raw), "m.json")
