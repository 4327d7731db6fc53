"""An FMU as a simulation: its own exports give the model's force, others theirs without delay, and bad ones a line."""

import tempfile
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fmus import algebraic_fmu, changed, damper, damper_fmu, packed

from ces_data.recording import Channel, Recording
from ces_identify.export.export_model import binary_path
from ces_identify.simulations.fmu import Port, choose_ports, open_fmu, read_names
from ces_identify.simulations.simulate import sample_force
from ces_observer.errors import CesError

START = 10**18


@pytest.fixture(autouse=True)
def _fmpy():
    pytest.importorskip("fmpy")


def recording(count=2000, seed=1, jitter_ns=400_000, noise_m=15e-6):
    dice = np.random.default_rng(seed)
    stamps = START + np.arange(count) * 1_000_000 + dice.integers(0, jitter_ns, count)
    t = (stamps - START) * 1e-9
    position = 0.012 * np.sin(25.0 * t) + 0.004 * np.sin(60.0 * t) + dice.normal(0, noise_m, count)
    return make_recording(stamps, position, 0.5 + 0.3 * np.sin(4.0 * t))


def make_recording(stamps, position, current):
    channels = {
        "position": Channel("position", "m", stamps, position),
        "current": Channel("current", "A", stamps, current),
    }
    return Recording("made", channels)


def spoiled():
    """Return a recording with a gap, a lost row, late and repeated stamps, an outlier, and what is not finite."""
    c = recording().channels
    stamps, position, current = c["position"].stamps_ns.copy(), c["position"].values.copy(), c["current"].values.copy()
    stamps[800:] += 300_000_000
    stamps[1000:] += 20_000_000
    position[1000:] += 0.01
    stamps[1200], stamps[1300] = stamps[1195], stamps[1299]
    position[500], current[600] = np.nan, np.inf
    position[1500] += 0.05
    return make_recording(stamps, position, current)


@pytest.mark.slow
@pytest.mark.needs("cc")
@pytest.mark.parametrize("what", [recording, spoiled])
def test_an_exported_model_gives_the_models_force(tmp_path, what):
    force = open_fmu(str(damper_fmu(tmp_path))).force(what())
    expected = sample_force(damper(), what())
    assert np.isfinite(expected).sum() > 1500
    np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.needs("cc")
def test_without_interpolation_or_validity_it_still_follows(tmp_path):
    """Inputs of a step's end, taken as of its beginning: the same forces, for stamps that are regular."""
    changes = {'canInterpolateInputs="true"': 'canInterpolateInputs="false"', 'name="valid"': 'name="good"'}
    simulation = open_fmu(str(damper_fmu(tmp_path, **changes)))
    assert not simulation.interpolates
    assert simulation.ports.valid is None
    even = recording(jitter_ns=1)
    force, expected = simulation.force(even), sample_force(damper(), even)
    assert (force[:50] == 0.0).all()
    # the FMU took no first sample of its own: it warms up a sample later, and its past begins there
    np.testing.assert_allclose(force[800:], expected[800:], rtol=1e-6, atol=1e-6)


@pytest.mark.needs("cc")
@pytest.mark.parametrize("variable", ["true", "false"])
def test_a_force_that_follows_at_once_is_not_delayed_and_units_are_minded(tmp_path, variable):
    simulation = open_fmu(f"{algebraic_fmu(tmp_path, variable)}:force=rear.out")
    assert simulation.step_s == (0.0 if variable == "true" else 0.0005)
    assert simulation.ports.inputs["position"] == Port("rear.x", 0, 0.001)
    clean = recording(noise_m=0.0)
    x, i = clean.channel("position").values, clean.channel("current").values
    t = (clean.channel("position").stamps_ns - START) * 1e-9
    v = 0.012 * 25.0 * np.cos(25.0 * t) + 0.004 * 60.0 * np.cos(60.0 * t)
    expected = 1e3 * (1500.0 * v * (1.0 + i) + 20.0 * 1e3 * x)
    error = (simulation.force(clean) - expected)[100:-100]
    assert np.abs(error).max() < 0.005 * np.abs(expected).max()  # a delay of one sample would be ten times that


@pytest.mark.needs("cc")
def test_nothing_stays_behind(tmp_path, monkeypatch):
    path = damper_fmu(tmp_path)
    (tmp_path / "t").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "t"))
    simulation = open_fmu(str(path))
    assert np.isfinite(simulation.force(recording())).any()
    changed(path, {}, without=["binaries"])
    with pytest.raises(CesError, match="Cannot find shared library"):
        simulation.force(recording())
    assert list((tmp_path / "t").iterdir()) == []


@pytest.mark.needs("cc")
def test_a_failing_step_says_when(tmp_path):
    simulation = open_fmu(f"{algebraic_fmu(tmp_path)}:force=rear.out")
    c = recording(jitter_ns=1).channels
    strong = make_recording(c["position"].stamps_ns, c["position"].values, 0.0 * c["current"].values + 8.0)
    with pytest.raises(CesError, match=r"algebraic.fmu: the FMU failed at 1\.90.* s: fmi2DoStep failed with status 3"):
        simulation.force(strong)


@pytest.mark.needs("cc")
def test_a_library_that_does_not_load_is_one_line(tmp_path):
    path = changed(damper_fmu(tmp_path), {}, without=["binaries"])
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(binary_path("damper"), b"not a library")
    here = Path.cwd()
    with pytest.raises(CesError, match=r"damper\.fmu: the FMU failed at 0\.0.*Failed to load shared library") as caught:
        open_fmu(str(path)).force(recording())
    assert "\n" not in str(caught.value)
    assert Path.cwd() == here


# -------------------------------------------------------------------------------------------------- files refused


def describe(path, xml):
    packed(path, {"modelDescription.xml": xml.encode()})


MINIMAL = (
    '<fmiModelDescription fmiVersion="{version}" modelName="a" guid="g">{kind}<ModelVariables/><ModelStructure/>'
    "</fmiModelDescription>"
)


MODEL_EXCHANGE = MINIMAL.format(version="2.0", kind='<ModelExchange modelIdentifier="a"/>')
NO_BINARY = MINIMAL.format(version="2.0", kind='<CoSimulation modelIdentifier="a"/>')


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda path: path.write_text("hello"), "a.fmu: not an FMU or damaged: not a zip file"),
        (lambda path: packed(path, {"a.txt": b"x"}), r"a.fmu: not an FMU or damaged: .*modelDescription\.xml"),
        (lambda path: None, r"a\.fmu: no such file"),
        (lambda path: describe(path, "<fmiModel"), "damaged"),
        (lambda path: describe(path, MODEL_EXCHANGE), "a.fmu: FMI 2.0 for model exchange only, .*; expected"),
        (lambda path: describe(path, MINIMAL.format(version="1.0", kind="")), "a.fmu: .*FMI 1.0|damaged"),
        (lambda path: describe(path, NO_BINARY), "a.fmu: .* binaries: none; expected"),
    ],
)
def test_files_that_are_no_fmu_or_one_of_another_kind(tmp_path, write, message) -> None:
    write(tmp_path / "a.fmu")
    with pytest.raises(CesError, match=message) as caught:
        open_fmu(str(tmp_path / "a.fmu"))
    assert "\n" not in str(caught.value)


@pytest.mark.needs("cc")
def test_an_fmu_of_another_platform_or_of_sources(tmp_path):
    path = changed(damper_fmu(tmp_path), {}, without=["binaries"])
    with pytest.raises(CesError, match=r"binaries: sources; expected .* binary for \w+: compile or export it"):
        open_fmu(str(path))


def test_without_fmpy_the_extra_is_named(monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr("ces_identify.simulations.fmu.import_module", missing)
    with pytest.raises(CesError, match=r"pip install 'ces_observer\[fmi\]'"):
        open_fmu("a.fmu")


# -------------------------------------------------------------------------------------------------------- variables


def variable(name, reference, causality, unit=None, kind="Real"):
    return SimpleNamespace(
        name=name, valueReference=reference, causality=causality, unit=unit, type=kind, declaredType=None
    )


def unit(name, kg=0, m=0, s=0, A=0, factor=1.0, offset=0.0):
    base = SimpleNamespace(kg=kg, m=m, s=s, A=A, factor=factor, offset=offset)
    return SimpleNamespace(name=name, baseUnit=base)


UNITS = [unit("m", m=1), unit("mm", m=1, factor=1e-3), unit("m/s", m=1, s=-1), unit("A", A=1)]
UNITS += [unit("N", 1, 1, -2), unit("V", 1, 2, -3, -1), unit("degC", factor=1.0, offset=273.15)]


def description(inputs, outputs):
    """Return a description with variables given as name or (name, unit)."""
    given = [(row, causality) for rows, causality in ((inputs, "input"), (outputs, "output")) for row in rows]
    rows = [(*((row, None) if isinstance(row, str) else row), causality) for row, causality in given]
    variables = [variable(name, k, causality, of) for k, (name, of, causality) in enumerate(rows)]
    return SimpleNamespace(unitDefinitions=UNITS, modelVariables=variables)


def chosen(inputs, outputs, names=""):
    ports = choose_ports(description(inputs, outputs), read_names(names, "a.fmu"), "/d/a.fmu")
    return {role: port.name for role, port in ports.inputs.items()} | {"force": ports.force.name}


@pytest.mark.parametrize(
    ("inputs", "outputs", "names", "expected"),
    [
        (["position", "current"], ["force"], "", "position current force"),
        (["x", "v", "i"], ["F"], "", "x v i F"),
        ([("a", "mm"), ("b", "A")], [("c", "N"), ("d", "m/s")], "", "a b c"),
        (["d.rodSpeed", "d.coilCurrent", ("T", "degC")], ["d.outForce"], "", "d.rodSpeed d.coilCurrent d.outForce"),
        ([("a", "m"), ("rod_position", "m"), "i"], [("c", "N"), ("force", "N")], "", "rod_position i force"),
        (["u1", "u2"], ["y"], "position=u2,current=u1,force=y", "u2 u1 y"),
        (["u1", "u2"], ["y"], "position=,speed=u1,current=u2,force=y", "u1 u2 y"),
        ([("x", "m"), "k"], ["F"], "current=", "x F"),
    ],
)  # fmt: skip
def test_variables_are_found_by_unit_name_or_order_of_the_user(inputs, outputs, names, expected):
    assert list(chosen(inputs, outputs, names).values()) == expected.split()


@pytest.mark.parametrize(
    ("inputs", "outputs", "names", "message"),
    [
        (["u1", "u2"], ["F"], "", r"no input that is the piston's position or speed; name it \(a.fmu:position=NAME\)"),
        (["x", "i"], ["y1", "y2"], "", r"no output that is the damping force; .*outputs: y1 \[\?\], y2 \[\?\]"),
        (
            [("a", "m"), ("b", "mm"), "i"],
            ["F"],
            "",
            r"a and b may each be the position; .*inputs: a \[m\], b \[mm\], i",
        ),
        (["x", "k"], ["F"], "", "no input that is the valve current"),
        (["x", "i"], ["F"], "position=y", "no real input 'y' for the position"),
        (["x", "i"], ["F"], "positon=x", "'positon=x'; expected each of position, speed, current, force"),
        (["x", "i"], ["F"], "force=F,force=F", "at most once"),
    ],
)
def test_what_is_not_clear_is_asked_with_the_variables_listed(inputs, outputs, names, message):
    with pytest.raises(CesError, match=message):
        chosen(inputs, outputs, names)
