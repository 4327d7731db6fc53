"""An exported FMU as a SIM: `ces simulate` and `ces identify --teacher`, and its one-line errors."""

import csv

import numpy as np
import pytest
from needs import skip_without

from ces_cli.main import main
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_observer.model import Envelope, Model, Sampling, load_model
from ces_observer.signals import Signals
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

RULES = "force: {lags: [1]}\nspeed: {lags: [0], powers: [1.0], forms: [signed]}\nproducts: [[force], [speed]]\n"


def ces(*words):
    return main([str(word) for word in words])


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with a bag, a model and the model's FMU."""
    pytest.importorskip("fmpy")
    skip_without("cc")
    folder = tmp_path_factory.mktemp("work")
    terms = (Term(0.5, (Factor("force", 1),)), Term(900.0, (Factor("speed", 0),)))
    envelope = Envelope((-0.1, 0.1), (-2.0, 2.0), (0.0, 2.0))
    Model(Sampling(500.0, 60.0, 0.02), Polynomial(terms), envelope, (-3e4, 3e4)).save(folder / "model.json")
    t = np.arange(5000) / 500.0
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    columns = {"position": ("m", 0.01 * np.sin(19.0 * t) + 0.004 * np.sin(50.0 * t)), "current": ("A", 0.5 + 0.0 * t)}
    channels = {name: Channel(name, unit, stamps, values) for name, (unit, values) in columns.items()}
    write_bag(folder / "bag", recording_topics(Recording("bag", channels), Signals.from_mapping({}, "defaults")))
    (folder / "rules.yaml").write_text(RULES)
    assert ces("export", folder / "model.json", "--format", "fmu", "--out", folder / "damper.fmu") == 0
    return folder


def forces(path):
    with path.open() as file:
        return np.array([float(row["force_N"]) for row in csv.DictReader(file)])


@pytest.mark.parametrize("spec", ["damper.fmu", "damper.fmu:position=position,current=current,force=force"])
def test_simulate_returns_the_models_force(work, tmp_path, spec):
    assert ces("simulate", "--sim", work / "model.json", work / "bag", "--out", tmp_path / "model.csv") == 0
    assert ces("simulate", "--sim", f"{work}/{spec}", work / "bag", "--out", tmp_path / "fmu.csv") == 0
    expected = forces(tmp_path / "model.csv")
    assert np.isfinite(expected).sum() > 4000
    np.testing.assert_allclose(forces(tmp_path / "fmu.csv"), expected, rtol=1e-9, atol=1e-9)


def test_identify_learns_from_it(work, tmp_path):
    words = ["identify", work / "bag", "--teacher", work / "damper.fmu", "--candidates", work / "rules.yaml"]
    words += ["--terms", 2, "--starts", 1, "--threads", 1, "--time", 10, "--rate", 500, "--bandwidth", 60]
    assert ces(*words, "--out", tmp_path / "learned.json") == 0
    terms = load_model(tmp_path / "learned.json").body.terms
    coefficients = {term.factors[0].signal: term.coefficient for term in terms}
    assert coefficients["force"] == pytest.approx(0.5, abs=0.02)
    assert coefficients["speed"] == pytest.approx(900.0, rel=0.04)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("none.fmu", "no such file"),
        ("damper.fmu:position=x", "no real input 'x' for the position"),
        ("broken.fmu", "not a zip file"),
    ],
)
def test_an_unusable_fmu_gives_one_line(work, tmp_path, capsys, spec, message):
    (work / "broken.fmu").write_text("PK")
    assert ces("simulate", "--sim", f"{work}/{spec}", work / "bag", "--out", tmp_path / "x.csv") == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("ces simulate: error: ")
    assert message in lines[0]


def test_the_help_says_that_an_fmu_runs_native_code(capsys):
    with pytest.raises(SystemExit):
        ces("simulate", "--help")
    assert "native code" in " ".join(capsys.readouterr().out.split())
