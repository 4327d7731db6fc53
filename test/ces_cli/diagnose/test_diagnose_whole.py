"""`ces diagnose` without any substitute, through an FMU; and its augmented simulation replayed."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from needs import skip_without
from schema_rules import faults

from ces_cli.main import main
from ces_data.bags.reader import read_recording
from ces_data.bags.writer import TopicData, recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_identify.simulations.simulate import sample_force
from ces_observer.model import Envelope, Model, Sampling
from ces_observer.signals import Signals
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

RATE, NOISE_N, COULOMB_N = 250.0, 6.0, 40.0
DEFAULT = Signals.from_mapping({}, "defaults")
SPEED, CURRENT = Factor("speed", 0), Factor("current", 0)
MODEL = Model(
    Sampling(RATE, 40.0, 0.02, warm_up_s=0.2),
    Polynomial((Term(0.3, (Factor("force", 1),)), Term(700.0, (SPEED,)), Term(600.0, (SPEED, CURRENT)))),
    Envelope((-0.05, 0.05), (-2.0, 2.0), (0.0, 2.0)),
    (-3e4, 3e4),
)


def ces(*words):
    return main([str(word) for word in words])


def ride(name, seed, coulomb_N, seconds=8.0):
    """The model's force with Coulomb friction beside it, and the model's own prediction."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    tones = zip(random.uniform(0.001, 0.005, 5), random.uniform(0.5, 7.0, 5), random.uniform(0.0, 6.0, 5), strict=True)
    position = sum(a * np.sin(2.0 * np.pi * f * t + p) for a, f, p in tones)
    current = 0.6 + 0.3 * np.sign(np.sin(2.0 * np.pi * 0.7 * t + seed))
    from_zero = np.rint(t * 1e9).astype(np.int64)
    inputs = {
        key: Channel(key, "", from_zero, values) for key, values in (("position", position), ("current", current))
    }
    predicted = np.nan_to_num(sample_force(MODEL, Recording("inputs", inputs)))
    friction = coulomb_N * np.tanh(np.gradient(position, t) / 0.015)
    force = predicted + friction + random.normal(0.0, NOISE_N, len(t))
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    columns = {"position": ("m", position), "current": ("A", current), "force": ("N", force)}
    channels = {key: Channel(key, unit, stamps, values) for key, (unit, values) in columns.items()}
    return Recording(name, channels), TopicData("/predicted", "std_msgs/msg/Float64", stamps, {"data": predicted})


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """Recordings with friction, one for evaluation, references without friction; the model and its FMU."""
    folder = tmp_path_factory.mktemp("whole")
    for name, seed, coulomb_N in (
        ("one", 1, COULOMB_N),
        ("two", 2, COULOMB_N),
        ("judge", 3, COULOMB_N),
        ("free", 4, 0.0),
    ):
        recording, predicted = ride(name, seed, coulomb_N)
        write_bag(folder / name, (*recording_topics(recording, DEFAULT), predicted))
    MODEL.save(folder / "model.json")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


def diagnosed(sim, out):
    words = ("--real", "one", "two", "--held-out", "judge", "--reference", "free", "--threads", 1)
    assert ces("diagnose", "--sim", sim, *words, "--out", out) == 0
    return json.loads(Path(out, "gap.json").read_text())


def left(folder, out, tmp_path):
    """The gap [N] of the augmented simulation on the evaluation recording, noise subtracted."""
    assert ces("simulate", "--sim", f"{out}/augmented.json", "judge", "--out", tmp_path / "a.csv") == 0
    rows = list(csv.DictReader((tmp_path / "a.csv").open()))
    simulated = np.array([float(row["force_N"]) for row in rows])
    recording = read_recording(folder / "judge", DEFAULT)
    gap = (recording.channel("force").values - simulated)[100:-50]
    gap = gap[np.isfinite(gap)]
    assert len(gap) > 0.9 * len(simulated) - 150
    return float(np.sqrt(max(np.mean(gap**2) - NOISE_N**2, 0.0)))


@pytest.fixture(scope="module")
def through_fmu(work):
    pytest.importorskip("fmpy")
    skip_without("cc")
    assert ces("export", "model.json", "--format", "fmu", "--out", "damper.fmu") == 0
    return diagnosed("damper.fmu", "fmu_gap")


def test_an_fmu_is_diagnosed(through_fmu):
    assert faults(through_fmu) == []
    assert through_fmu["verdict"] == "named"
    assert through_fmu["composition"]["effects"] == ["friction"]
    assert through_fmu["gap"]["rms_N"] == pytest.approx(0.9 * COULOMB_N, rel=0.1)
    assert through_fmu["causes"][0]["probability"] > 0.8
    assert through_fmu["composition"]["shrink"] > 0.8


def test_the_augmented_fmu_closes_the_gap_as_claimed(work, through_fmu, tmp_path):
    claimed = through_fmu["composition"]["gap_after_N"]
    assert left(work, "fmu_gap", tmp_path) == pytest.approx(claimed, abs=0.1 * COULOMB_N)
    assert json.loads((work / "fmu_gap" / "augmented.json").read_text())["sim"]["spec"] == "../damper.fmu"


def test_the_same_effects_around_recorded_predictions(work, through_fmu, tmp_path):
    document = json.loads((work / "fmu_gap" / "augmented.json").read_text())
    (work / "topic_gap").mkdir()
    sim = {"spec": "topic:/predicted", "sha256": None}
    (work / "topic_gap" / "augmented.json").write_text(json.dumps({**document, "sim": sim}))
    assert left(work, "topic_gap", tmp_path) == pytest.approx(through_fmu["composition"]["gap_after_N"], abs=4.0)
