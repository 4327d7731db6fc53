"""`ces diagnose` with hydraulic networks: cause, repair, replay and distillation."""

import csv
import json

import numpy as np
import pytest
from hydraulic_models import GROOVE, hydraulic_model, make_hydraulic
from physical_examples import make_valve
from programs import NO_SHORT_FITS, ONE_KIND, ces, only_effects
from schema_rules import faults

from ces_data.bags.reader import read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_identify.simulations.simulate import sample_force
from ces_observer.signals import Signals

RATE, NOISE_N, COULOMB_N, SECONDS = 1000.0, 6.0, 40.0, 7.0
pytestmark = pytest.mark.slow
DEFAULT = Signals.from_mapping({}, "defaults")
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
