"""What `from ces_identify import ...` and its sisters give: functions and classes, light to import."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ces_gap
import ces_identify
import ces_observer
from ces_identify import make_recording, read_log, read_recording, simulate, simulate_arrays, validate, write_recording
from ces_observer import CesError, load_model

ROOT = Path(__file__).resolve().parents[1]
ROAD, SINE = ROOT / "bags/road", ROOT / "bags/sine_4hz"
PACKAGES = (ces_observer, ces_identify, ces_gap)


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.__name__)
def test_public_names_are_documented_functions_and_classes(package):
    for name in package.__all__:
        value = getattr(package, name)
        assert not inspect.ismodule(value), name
        if not name.isupper():
            assert callable(value) and inspect.getdoc(value), name
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = package.nonsense


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.__name__)
def test_the_page_of_the_api_has_every_name_and_every_keyword(package):
    page = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    for name in package.__all__:
        value = getattr(package, name)
        assert f"`{name}`" in page or f"`{name}(" in page, name
        if inspect.isfunction(value):
            (signature,) = re.findall(rf"^\| `{name}\((.*)\)` \|", page, re.MULTILINE)[-1:] or [""]
            written = [part.partition("=")[0].strip("* ") for part in re.split(r",\s*(?![^(]*\))", signature)]
            assert [w for w in written if w] == list(inspect.signature(value).parameters), name


def test_importing_a_package_imports_nothing_heavy():
    code = "import sys, ces_gap, ces_identify, ces_observer; print(*(m for m in sys.modules if m.startswith('ces_')))"
    code += "; assert not {'numba', 'scipy', 'numpy', 'matplotlib'} & set(sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert set(loaded.split()) == {"ces_gap", "ces_identify", "ces_observer", "ces_observer.lazy_names"}


def test_packages_are_marked_as_typed():
    for package in ("ces_observer", "ces_identify", "ces_gap", "ces_rig", "ces_cli"):
        assert (ROOT / package / "py.typed").is_file()


@pytest.mark.parametrize("kind", [str, Path])
def test_paths_may_be_text(kind, tmp_path):
    model = load_model(kind(ROOT / "config/models/sample.json"))
    recording = read_recording(kind(ROOT / "bags/sine_4hz"))
    (evaluation,) = validate(model, recording)
    assert 0.0 < evaluation.cost < 30.0
    write_recording(recording, kind(tmp_path / "copy"))
    again = read_recording(kind(tmp_path / "copy"), need=("position",))
    np.testing.assert_allclose(simulate(model, again), simulate(model, recording), atol=1e-9)
    model.save(kind(tmp_path / "model.json"))


def test_arrays_are_simulated_as_a_recording_is():
    model = load_model(ROOT / "config/models/sample.json")
    t = np.arange(2000) / 1000.0
    x, i = 0.02 * np.sin(2 * np.pi * 2.0 * t), np.full(2000, 0.5)
    force = simulate_arrays(model, t, x, i)
    assert np.isfinite(force[-1000:]).all()
    np.testing.assert_array_equal(force, simulate(model, make_recording(t, x, i)))


def test_mistakes_are_one_line(tmp_path):
    recording = make_recording([0.0, 1.0], [0.0, 0.1], [0.0, 0.0])
    model = ROOT / "config/models/sample.json"
    for call, text in (
        (lambda: ces_identify.identify([]), "no recording given; expected a recording, a path, or several of them"),
        (lambda: ces_identify.identify(5), "recordings: expected a recording, a path, or several .* of type int"),
        (lambda: ces_identify.identify(tmp_path / "none"), "none: no such file or folder"),
        (lambda: ces_identify.identify(recording, time="ten"), "time is 'ten'; expected a number from"),
        (lambda: ces_identify.identify(recording, weight="much"), "weight='much': expected"),
        (lambda: ces_identify.identify(recording, delay="late"), "delay is 'late'; expected a number from 0 to 0.02 s"),
        (lambda: ces_identify.identify(recording, delay=(0, 0.003)), "expected a number from 0 to 0.02 s"),
        (lambda: ces_identify.identify(recording, options=5), "options: expected IdentifyOptions"),
        (lambda: validate(tmp_path / "x.json"), "x.json: no such model file"),
        (lambda: validate(model), "no recording given"),
        (lambda: validate(None, recording), "model: expected a model or a path; got None"),
        (lambda: load_model(5), "expected the path of a model file; got a value of type int"),
        (lambda: ces_identify.compare_models([model, model], recording), "expected models by their names"),
        (lambda: make_recording(["a"], [0.0], [0.0]), "time_s: expected an array of numbers"),
        (lambda: read_log(tmp_path / "log.csv"), "log.csv: cannot be read"),
    ):
        with pytest.raises(CesError, match=text) as error:
            call()
        assert "\n" not in str(error.value)
    with pytest.raises(CesError, match="structure is 'tree'; expected one of polynomial, sigmoid, anfis"):
        ces_identify.identify(recording, structure="tree")
    with pytest.raises(CesError, match="leaves is unknown; known are structure, time, "):
        ces_identify.identify(recording, structure="sigmoid", leaves=3)
    with pytest.raises(CesError, match="rules applies to structure='anfis' or auto, not to sigmoid; remove it"):
        ces_identify.identify(recording, structure="sigmoid", rules="2x2")
    with pytest.raises(CesError, match="cannot be read"):
        read_log(tmp_path / "log.csv", mapping=tmp_path / "none.yaml")


def test_a_log_is_read_without_a_mapping_and_its_result_prints_itself(tmp_path):
    t = np.arange(0.0, 8.0, 0.001)
    x = 20.0 * np.sin(2 * np.pi * 2.0 * t) * np.sin(0.7 * t)
    current, speed = 0.5 + 0.4 * np.sign(np.sin(0.9 * t)), np.gradient(x / 1000.0, t)
    columns = np.stack([t, x, current, 1500.0 * current * np.tanh(speed / 0.1)], axis=1)
    log = tmp_path / "mine.csv"
    np.savetxt(log, columns, delimiter=",", header="time_s,position_mm,current_A,force_N", comments="")
    assert read_log(str(log)).channel("position").values.max() < 0.021
    result = ces_identify.identify(str(log), time=1.0, terms=4, starts=1, band=False, ignore_findings=True)
    assert "terms at" in repr(result) and "recording" in repr(result) and "<table" in result._repr_html_()
    result.model.save(tmp_path / "model.json")
    evaluations = validate(str(tmp_path / "model.json"), [log, read_log(log)])
    assert len(repr(evaluations).splitlines()) == 3 and evaluations._repr_html_().count("<tr>") == 3
    assert "J = " in repr(evaluations[0])


def test_a_model_may_have_a_delay():
    quick = {"time": 5.0, "terms": 3, "starts": 1, "band": False}
    at_once, later = (ces_identify.identify(ROAD, delay=delay, **quick).model for delay in (0.0, 0.003))
    assert (at_once.sampling.delay_s, later.sampling.delay_s) == (0.0, 0.003)
    compared = ces_identify.compare_models({"mine": at_once, "later": later}, SINE)
    assert [one.name for one in compared.models] == ["mine", "later"] and "delay ms" in repr(compared)
