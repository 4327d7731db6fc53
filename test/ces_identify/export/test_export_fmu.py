"""The exported FMU gives what the estimator gives at every communication point, and keeps to FMI 2.0."""

import subprocess
import zipfile

import numpy as np
import pytest
from exported_c import with_delay
from fmus import UNPROVED, damper
from hydraulic_models import hydraulic_model, make_hydraulic
from physical_examples import make_valve
from tick_forms import STRICT

from ces_identify.export.export_model import export_fmu, find_compiler, list_variables, sources
from ces_identify.simulations.fmu import open_fmu
from ces_observer.errors import CesError
from ces_observer.estimator import Estimator
from ces_observer.reasons import REASONS

pytestmark = [pytest.mark.slow, pytest.mark.needs("cc")]

POSITION, CURRENT, FORCE, SPEED, VALID, CLAMPED, REASON = range(7)  # of a model without a delay


@pytest.fixture(scope="module", params=["polynomial", "hydraulic"])
def model(request):
    return damper() if request.param == "polynomial" else hydraulic_model(make_hydraulic(make_valve(2.3)))


@pytest.fixture(scope="module")
def fmu(tmp_path_factory, model):
    """Return the path of a model's FMU and its unzipped folder."""
    return write_fmu(tmp_path_factory.mktemp("fmu"), model)


def write_fmu(folder, model):
    path = folder / "damper.fmu"
    path.write_bytes(export_fmu(model, "damper", UNPROVED, find_compiler()))
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder / "unzipped")
    return path, folder / "unzipped"


@pytest.fixture
def slave(fmu):
    """Return a started instance."""
    made = open_slave(fmu)
    yield made
    made.terminate()
    made.freeInstance()


def open_slave(fmu):
    pytest.importorskip("fmpy")
    from fmpy import read_model_description
    from fmpy.fmi2 import FMU2Slave

    guid = read_model_description(str(fmu[0])).guid
    made = FMU2Slave(guid=guid, modelIdentifier="damper", unzipDirectory=str(fmu[1]), instanceName="one")
    made.instantiate()
    start(made)
    return made


def start(slave):
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()


def stroke(count=1500, seed=1, jitter_s=0.0, step_s=1e-3):
    """Return times [s] of increasing samples, positions [m] and currents [A]."""
    dice = np.random.default_rng(seed)
    time = step_s * np.arange(count) + dice.uniform(0.0, jitter_s, count)
    position = 0.012 * np.sin(25.0 * time) + 0.004 * np.sin(90.0 * time + 1.0) + dice.normal(0, 15e-6, count)
    return time, position, 0.5 + 0.5 * np.sin(4.0 * time)


def run(slave, time, position, current, sloped):
    """Step from sample to sample; return rows (force, speed, valid, clamped, reason) after each step."""
    rows = []
    for k in range(len(time) - 1):
        step = time[k + 1] - time[k]
        slave.setReal([POSITION, CURRENT], [position[k], current[k]])
        if sloped:
            slopes = [(position[k + 1] - position[k]) / step, (current[k + 1] - current[k]) / step]
            slave.setRealInputDerivatives([POSITION, CURRENT], [1, 1], slopes)
        slave.doStep(time[k], step)
        rows.append([*slave.getReal([FORCE, SPEED]), *slave.getBoolean([VALID, CLAMPED]), *slave.getInteger([REASON])])
    return np.array(rows, float)


def estimated(model, time, position, current):
    """Return the same rows for each sample from the estimator in Python."""
    e, rows = Estimator(model), []
    for t, x, i in zip(np.rint(time * 1e9).astype(int).tolist(), position.tolist(), current.tolist(), strict=True):
        force = e.step(t, x, i)
        rows.append([force or 0.0, e.speed, force is not None, e.clamped, REASONS.index(e.reason)])
    return np.array(rows, float)


def same(rows, expected, rtol=0.0):
    assert expected[:, 3].any()
    assert expected[:, 2].any()
    assert not expected[:, 2].all()
    np.testing.assert_array_equal(rows[:, 2:], expected[:, 2:])
    for column in (0, 1):
        largest = np.abs(expected[:, column]).max()
        np.testing.assert_allclose(rows[:, column], expected[:, column], rtol=0.0, atol=rtol * largest)


@pytest.mark.parametrize("how", [{}, {"jitter_s": 0.9e-3}, {"step_s": 4.1e-3}, {"step_s": 0.3e-3}], ids=str)
def test_with_derivatives_the_force_is_that_of_the_steps_end(slave, model, how):
    samples = stroke(**how)
    rows = run(slave, *samples, sloped=True)
    same(rows, estimated(model, *samples)[1:], rtol=1e-12)  # extrapolated inputs are rounded


def test_a_wrong_derivative_is_forgotten_after_its_step(slave, model):
    time, position, current = stroke()
    slave.setReal([POSITION, CURRENT], [position[0], current[0]])
    slave.setRealInputDerivatives([POSITION], [1], [3.0])
    slave.doStep(time[0], time[1] - time[0])
    rows = run(slave, time[1:], position[1:], current[1:], sloped=False)
    same(rows, estimated(model, time, position, current)[1:-1])


def test_a_delayed_force_comes_out_as_soon_as_it_is_known(tmp_path):
    from fmpy.validation import validate_fmu

    model = with_delay(damper(), 0.003)
    fmu, place = write_fmu(tmp_path, model), {one.name: i for i, one in enumerate(list_variables(model))}
    assert validate_fmu(str(fmu[0])) == []
    assert "force" not in place and open_fmu(str(fmu[0])).ports.force.name == "force_delayed"
    time, position, current = stroke()
    time[700:] += 0.02
    time[1000:] += 0.3
    made, estimator, known = open_slave(fmu), Estimator(model), None
    rows, expected = [], []
    for k in range(len(time) - 1):
        made.setReal([POSITION, CURRENT], [position[k], current[k]])
        made.doStep(time[k], time[k + 1] - time[k])
        valid = made.getBoolean([place["valid"]])
        rows.append([*made.getReal([place["force_delayed"], place["delay"]]), *valid])
        stamp_ns = round(1e9 * time[k])
        estimator.step(stamp_ns, position[k], current[k])
        known = estimator.late[-1] if estimator.late else known
        is_valid = known is not None and stamp_ns - known.stamp_ns <= 53_000_000
        expected.append([known.force if is_valid else 0.0, 0.003, is_valid])
    np.testing.assert_array_equal(rows, expected)
    assert 1000 < sum(row[2] for row in expected) < 1300
    made.terminate()
    made.freeInstance()


def test_a_state_is_kept_restored_and_written_as_bytes(slave):
    samples = stroke()
    half = [column[:700] for column in samples]
    rest = [column[700:] for column in samples]
    run(slave, *half, sloped=True)
    state = slave.getFMUstate()
    once = run(slave, *rest, sloped=True)
    slave.setFMUstate(state)
    np.testing.assert_array_equal(run(slave, *rest, sloped=True), once)
    saved = slave.serializeFMUstate(state)
    slave.freeFMUstate(state)
    slave.reset()
    start(slave)
    slave.setFMUstate(slave.deSerializeFMUstate(saved))
    np.testing.assert_array_equal(run(slave, *rest, sloped=True), once)
    with pytest.raises(Exception, match="fmi2DeSerializeFMUstate failed"):
        slave.deSerializeFMUstate(b"x" + saved[1:])


def test_a_reset_brings_it_back_to_new(slave):
    samples = stroke()
    once = run(slave, *samples, sloped=True)
    slave.reset()
    start(slave)
    np.testing.assert_array_equal(run(slave, *samples, sloped=True), once)


FORBIDDEN = [
    ("fmi2DoStep", lambda s: s.doStep(0.0, 0.0)),
    ("fmi2DoStep", lambda s: s.doStep(float("nan"), 1e-3)),
    ("fmi2DoStep", lambda s: (s.doStep(0.1, 1e-3), s.doStep(0.05, 1e-3))),
    ("fmi2SetReal", lambda s: s.setReal([FORCE], [1.0])),
    ("fmi2GetReal", lambda s: s.getReal([VALID])),
    ("fmi2GetBoolean", lambda s: s.getBoolean([FORCE])),
    ("fmi2GetInteger", lambda s: s.getInteger([99])),
    ("fmi2SetRealInputDerivatives", lambda s: s.setRealInputDerivatives([POSITION], [2], [1.0])),
    ("fmi2DoStep", lambda s: (s.reset(), s.doStep(0.0, 1e-3))),
]


def test_what_cannot_be_done_is_an_error(slave) -> None:
    for function, call in FORBIDDEN:
        with pytest.raises(Exception, match=f"{function} failed with status 3"):
            call(slave)


def test_a_library_of_another_description_does_not_start(fmu):
    fmi2 = pytest.importorskip("fmpy.fmi2")
    other = fmi2.FMU2Slave(guid="{0}", modelIdentifier="damper", unzipDirectory=str(fmu[1]), instanceName="one")
    with pytest.raises(Exception, match="Failed to instantiate"):
        other.instantiate()


def test_the_description_is_valid_and_a_simulator_runs_it(fmu, model):
    fmpy = pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(fmu[0])) == []
    time, position, current = stroke()
    driven = np.array(
        list(zip(time, position, current, strict=True)), [(n, float) for n in ("time", "position", "current")]
    )
    ran = fmpy.simulate_fmu(
        str(fmu[0]), start_time=0.0, stop_time=1.4, input=driven, output_interval=1e-3, output=["force", "valid"]
    )
    expected = estimated(model, time, position, current)
    np.testing.assert_allclose(
        ran["force"][1:1400], expected[:1399, 0], rtol=0.0, atol=1e-9 * abs(expected[:, 0]).max()
    )


def test_the_sources_compile_without_a_warning_and_as_a_part_of_another_program(tmp_path, model):
    for name, text in sources(model, "rear_left", UNPROVED).items():
        (tmp_path / name).write_text(text, encoding="ascii")
    files = ["rear_left.c", "ces_core.c", "fmi2_rear_left.c"]
    subprocess.run(["cc", *STRICT, "-fPIC", "-shared", "-o", "it.so", *files, "-lm"], cwd=tmp_path, check=True)
    prefixed = ["cc", *STRICT, "-DFMI2_FUNCTION_PREFIX=rear_left_", "-c", "fmi2_rear_left.c"]
    subprocess.run(prefixed, cwd=tmp_path, check=True)
    assert b"rear_left_fmi2DoStep" in (tmp_path / "fmi2_rear_left.o").read_bytes()


def test_the_same_model_gives_the_same_bytes_and_another_another_guid(fmu, model) -> None:
    assert export_fmu(model, "damper", UNPROVED, find_compiler()) == fmu[0].read_bytes()
    guids = {
        sources(damper(past), "damper", UNPROVED)["fmi2_damper.c"].split('GUID[] = "')[1][:38] for past in (0.6, 0.5)
    }
    assert len(guids) == 2


def test_sources_only_needs_no_compiler(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    model = damper()
    (tmp_path / "a.fmu").write_bytes(export_fmu(model, "damper", model.certify()))
    with zipfile.ZipFile(tmp_path / "a.fmu") as archive:
        assert not any(name.startswith("binaries") for name in archive.namelist())
        assert "stable for every input (proved)" in archive.read("modelDescription.xml").decode()
    with pytest.raises(CesError, match=r"no C compiler found .*sources_only=True"):
        find_compiler()


def test_a_compiler_that_fails_is_one_line(tmp_path, monkeypatch):
    bad = tmp_path / "bad"
    bad.write_text("#!/bin/sh\necho 'x.c:1: error: no' >&2; exit 1\n")
    bad.chmod(0o755)
    monkeypatch.setenv("CC", str(bad))
    with pytest.raises(CesError, match=r"bad: x\.c:1: error: no") as caught:
        export_fmu(damper(), "damper", UNPROVED, find_compiler())
    assert "\n" not in str(caught.value)
    monkeypatch.setenv("CC", "nothing-of-this-name")
    with pytest.raises(CesError, match="CC=nothing-of-this-name is not found"):
        find_compiler()
