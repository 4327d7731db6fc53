"""`ces diagnose --identify`: a model of the references is fitted, saved, named in augmented.json, and diagnosed."""

import json

import pytest
from programs import ONE_KIND, ces, only_effects, run_here
from rig_rides import SLOW, identified, rig_ride
from schema_rules import faults

from ces_cli.terminal.inputs import open_simulation
from ces_data.bags.reader import read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_gap.augmented import load_augmented
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
