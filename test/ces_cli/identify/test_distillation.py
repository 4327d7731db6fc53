"""An augmented simulation runs as a SIM and teaches a model, which records its distillation loss."""

import csv
import json
import sys

import numpy as np
import pytest
from programs import NO_SHORT_FITS, ces, error_line

from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_gap.augmented import save_augmented
from ces_gap.effects.effect import Composition, Setting
from ces_gap.effects.library import user_effect
from ces_observer.model import load_model
from ces_observer.signals import Signals

pytestmark = pytest.mark.slow
DEFAULT = Signals.from_mapping({}, "defaults")
RATE, PULL_N_M, NOISE_N = 500.0, 8000.0, 5.0
PHYSICS = """\
import numpy as np

from ces_gap.effects.effect import Effect, EffectParameter


def force(time_s, position_m, current_A):
    return 900.0 * np.gradient(position_m, time_s) * (0.5 + current_A)


class Pull(Effect):
    name, form = "pull", "linear"
    parameters = (EffectParameter("stiffness_N_m", -1e5, 1e5, (1e3,), "of a spring", magnitude=True),)

    def respond(self, trace, inputs, force, values):
        return force + values[0] * trace.inputs.position
"""
RULES = """\
speed: {lags: [0], powers: [1.0], forms: [signed]}
current: {lags: [0], powers: [1.0], forms: [magnitude]}
position: {lags: [0], powers: [1]}
products: [[], [speed], [speed, current], [position]]
"""


def inputs(seed):
    t = np.arange(round(8.0 * RATE)) / RATE
    position = 0.01 * np.sin(2 * np.pi * 2 * t) + 0.003 * np.sin(2 * np.pi * 5.3 * t + seed)
    return t, position, 0.5 + 0.2 * np.sin(2 * np.pi * 0.7 * t + seed)


def bag(path, seed, forced=True):
    t, position, current = inputs(seed)
    force = 900.0 * np.gradient(position, t) * (0.5 + current) + PULL_N_M * position
    columns = {"position": ("m", position), "current": ("A", current)}
    if forced:
        columns["force"] = ("N", force + np.random.default_rng(seed).normal(0.0, NOISE_N, len(t)))
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    channels = {name: Channel(name, unit, stamps, values) for name, (unit, values) in columns.items()}
    write_bag(path, recording_topics(Recording(path.name, channels), DEFAULT))


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with bags, a module with physics, and an augmented simulation in a subfolder."""
    folder = tmp_path_factory.mktemp("distilled")
    bag(folder / "one", 1), bag(folder / "two", 2), bag(folder / "bare", 3, forced=False)
    (folder / "distilled_physics.py").write_text(PHYSICS)
    (folder / "rules.yaml").write_text(RULES)
    (folder / "out").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [str(folder), *sys.path])
        patch.chdir(folder)
        patch.setattr(*NO_SHORT_FITS)
        pull = Setting(user_effect("distilled_physics:Pull"), (PULL_N_M,))
        save_augmented(folder / "out" / "augmented.json", "distilled_physics:force", Composition((pull,)))
        yield folder


def identify(*words):
    fixed = ("--candidates", "rules.yaml", "--terms", 4, "--starts", 1, "--threads", 1, "--time", 5)
    return ces("identify", *words, "--teacher", "out/augmented.json", *fixed)


def forces(path):
    with path.open() as file:
        return np.array([float(row["force_N"]) for row in csv.DictReader(file)])


def test_simulate_runs_it(work):
    assert ces("simulate", "--sim", "out/augmented.json", "one", "--out", "a.csv") == 0
    assert ces("simulate", "--sim", "distilled_physics:force", "one", "--out", "s.csv") == 0
    added = forces(work / "a.csv") - forces(work / "s.csv")
    np.testing.assert_allclose(added[50:-50], PULL_N_M * inputs(1)[1][50:-50], atol=0.5)


def test_a_model_learns_it_with_its_distillation_loss(work, capsys):
    assert identify("one", "--validate", "two", "--out", "taught.json") == 0
    printed = capsys.readouterr().out
    model = load_model(work / "taught.json")
    terms = {t.factors[0].signal: t.coefficient for t in model.body.terms if len(t.factors) == 1}
    assert terms["position"] == pytest.approx(PULL_N_M, rel=0.03)
    facts = model.provenance["teacher"]
    assert facts["simulation"] == "out/augmented.json"
    assert len(facts["sha256"]) == 64
    assert [(row["recording"], row["role"]) for row in facts["cost_J_percent"]] == [
        ("one", "identification"),
        ("two", "validation"),
    ]
    spread = np.std(PULL_N_M * inputs(2)[1]) + 1.0
    for row in facts["cost_J_percent"]:
        assert row["model_to_teacher"] < 5.0
        assert 0.2 < row["teacher_to_measured"] < 100.0 * 3.0 * NOISE_N / spread
        assert row["model_to_measured"] >= row["teacher_to_measured"]
        assert row["loss"] == pytest.approx(row["model_to_measured"] - row["teacher_to_measured"], abs=2e-4)
    assert "J above compares with the teacher out/augmented.json" in printed
    assert "distillation loss" in printed
    assert f"{facts['cost_J_percent'][1]['loss']:+.2f}" in printed


def test_without_a_measured_force_there_is_no_loss(work, capsys):
    assert identify("bare", "--out", "bare.json") == 0
    assert "hold no measured force" in capsys.readouterr().out
    rows = load_model(work / "bare.json").provenance["teacher"]["cost_J_percent"]
    assert all(row["model_to_teacher"] is not None and row["loss"] is None for row in rows)


def test_a_changed_simulation_gives_one_line(work, capsys):
    path = work / "out" / "changed.json"
    document = json.loads((work / "out" / "augmented.json").read_text())
    (work / "m.json").write_text("{}")
    path.write_text(json.dumps({**document, "sim": {"spec": "../m.json", "sha256": "0" * 64}}))
    line = error_line(capsys, "simulate", "--sim", path, "one", "--out", "x.csv")
    assert "m.json has changed since; run `ces diagnose` again" in line
