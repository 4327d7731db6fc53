"""Diagnoses with models: one that is identified from references, and one with the physics inside."""

import csv
import json

import numpy as np
import pytest
from hydraulic_models import GROOVE, hydraulic_model, make_hydraulic
from physical_examples import make_valve
from programs import NO_SHORT_FITS, ONE_KIND, ces, only_effects, run_here
from rig_rides import SLOW, identified, rig_ride
from schema_rules import faults

from ces_cli.terminal.inputs import open_simulation
from ces_data.bags.reader import read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_gap.augmented import load_augmented
from ces_identify.simulations.simulate import sample_force
from ces_observer.model import load_model
from ces_observer.signals import Signals

pytestmark = pytest.mark.slow
DEFAULT = Signals.from_mapping({}, "defaults")
WORDS = ("--identify", "--structure", "hydraulic", "--reference", "new1", "new2", "--threads", 1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Rides of the new damper and of the one with the slow valve; the model is that of other tests, and few effects."""
    path = tmp_path_factory.mktemp("identified")
    for ride in (rig_ride(1), rig_ride(2), *(rig_ride(seed, SLOW) for seed in (7, 8, 9))):
        write_bag(path / ride.name, recording_topics(ride, DEFAULT))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        patch.setattr("ces_cli.diagnose.diagnosis.identify_baseline", lambda *references, **options: identified())
        patch.setattr("ces_identify.jobs.run_in_processes", run_here)
        patch.setattr(*only_effects("friction", "valve_lag"))
        patch.setattr(*ONE_KIND)
        yield path


def test_it_diagnoses_with_a_model_of_the_references(folder, capsys):
    assert ces("diagnose", *WORDS, "--real", "slow7", "slow8", "--held-out", "slow9", "--out", "gap") == 0
    gap = json.loads((folder / "gap" / "gap.json").read_text())
    assert faults(gap) == []
    assert gap["simulation"] == "gap/model.json"
    names = [one["recording"] for one in load_model("gap/model.json").provenance["identification"]]
    assert names == ["new1", "new2"]
    assert json.loads((folder / "gap" / "augmented.json").read_text())["sim"]["spec"] == "model.json"
    repaired = load_augmented(folder / "gap" / "augmented.json", open_simulation)
    assert len(repaired.force(read_recording(folder / "slow9", DEFAULT))) == len(rig_ride(9, SLOW).channel("position"))


def test_a_fleet_has_one_model_beside_its_units(folder, capsys):
    assert ces("diagnose", *WORDS, "--real", "slow7", "--each", "recording", "--jobs", 1, "--out", "many") == 0
    rows = [json.loads(line) for line in (folder / "many" / "fleet.jsonl").read_text().splitlines()]
    (row,) = [row for row in rows if row.get("status") == "done"]
    assert load_model("many/model.json").structure == "hydraulic"
    augmented = json.loads((folder / "many" / row["folder"] / "augmented.json").read_text())
    assert augmented["sim"]["spec"] == "../../model.json"


RATE, NOISE_N, COULOMB_N, SECONDS = 1000.0, 6.0, 40.0, 7.0


MODELS = {"plain": make_hydraulic(make_valve()), "groove": make_hydraulic(make_valve(), bypass=GROOVE)}


def ride(name, model, seed, coulomb_N):
    """Return a recording of the model's force with Coulomb friction beside it."""
    random = np.random.default_rng(seed)
    t = np.arange(round(SECONDS * RATE)) / RATE
    tones = zip(random.uniform(0.001, 0.003, 5), random.uniform(0.5, 7.0, 5), random.uniform(0.0, 6.0, 5), strict=True)
    position = sum(a * np.sin(2.0 * np.pi * f * t + p) for a, f, p in tones)
    current = 0.5 + 0.25 * np.sign(np.sin(2.0 * np.pi * 0.7 * t + seed))
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    channels = {n: Channel(n, u, stamps, v) for n, u, v in (("position", "m", position), ("current", "A", current))}
    damper = np.nan_to_num(sample_force(model, Recording(name, channels)))
    force = damper + coulomb_N * np.tanh(np.gradient(position, t) / 0.015) + random.normal(0.0, NOISE_N, len(t))
    return Recording(name, {**channels, "force": Channel("force", "N", stamps, force)})


@pytest.fixture(scope="module", params=MODELS)
def diagnosed(request, tmp_path_factory):
    """The working folder of a diagnosis, and its gap.json."""
    folder, model = tmp_path_factory.mktemp(request.param), hydraulic_model(MODELS[request.param])
    for seed, name in enumerate(("one", "two", "held", "new")):
        coulomb_N = 0.0 if name == "new" else COULOMB_N
        write_bag(folder / name, recording_topics(ride(name, model, seed, coulomb_N), DEFAULT))
    model.save(folder / "model.json")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(*NO_SHORT_FITS)
        patch.setattr(*ONE_KIND)
        patch.setattr(*only_effects("friction", "leakage", "force_scale", "inertia"))
        words = ("--real", "one", "two", "--held-out", "held", "--reference", "new", "--threads", 1)
        assert ces("diagnose", "--sim", "model.json", *words, "--out", "gap") == 0
        yield folder, json.loads((folder / "gap" / "gap.json").read_text())


def test_friction_beside_it_is_named(diagnosed):
    _, gap = diagnosed
    assert faults(gap) == []
    assert (gap["verdict"], gap["composition"]["effects"]) == ("named", ["friction"])
    assert gap["gap"]["rms_N"] == pytest.approx(0.9 * COULOMB_N, rel=0.1)
    assert gap["composition"]["shrink"] > 0.8


def test_its_repair_closes_the_gap_as_claimed(diagnosed, tmp_path):
    folder, gap = diagnosed
    assert ces("simulate", "--sim", "gap/augmented.json", "held", "--out", tmp_path / "a.csv") == 0
    simulated = np.array([float(row["force_N"]) for row in csv.DictReader((tmp_path / "a.csv").open())])
    left = (read_recording(folder / "held", DEFAULT).channel("force").values - simulated)[500:-50]
    left = left[np.isfinite(left)]
    assert len(left) > 0.9 * len(simulated) - 550
    left_N = float(np.sqrt(max(np.mean(left**2) - NOISE_N**2, 0.0)))
    assert left_N == pytest.approx(gap["composition"]["gap_after_N"], abs=0.1 * COULOMB_N)
