"""What `from ces_identify import ...` and its sisters give: functions and classes, light to import."""

import inspect
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
    with pytest.raises(CesError, match="structure 'tree' is unknown; expected one of polynomial, sigmoid, anfis"):
        ces_identify.identify(recording, structure="tree")
    with pytest.raises(CesError, match="structure 'sigmoid' has no size leaves"):
        ces_identify.identify(recording, structure="sigmoid", leaves=3)
    with pytest.raises(CesError, match="cannot be read"):
        read_log(tmp_path / "log.csv", mapping=tmp_path / "none.yaml")
