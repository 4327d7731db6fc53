"""`ces diagnose`: arguments in, files and a summary out; bad input gives one line; a fleet gives a row per unit."""

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import cheap_diagnosis
import diagnoses
import pytest
from programs import ces, run_here
from samplings import make_sampling

from ces_cli.terminal.inputs import find_fleet_units
from ces_data.bags.find import find_bags
from ces_data.bags.reader import read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.checks.content import recording_marks
from ces_observer.errors import CesError
from ces_observer.json_text import write_all_atomically
from ces_observer.model import Envelope, Model, load_model
from ces_observer.signals import Signals
from ces_observer.structures.polynomial import Factor, Polynomial, Term

DEFAULT = Signals.from_mapping({}, "defaults")
SIM = "diagnosed_damper:force"
MODULE = """\
import numpy as np

from ces_gap.effects.effect import Effect, EffectParameter


def force(time_s, position_m, current_A):
    return 1200.0 * np.gradient(position_m, time_s) * (0.5 + current_A)


class Own(Effect):
    name, form = "own", "constant"
    parameters = (EffectParameter("offset_N", -1e3, 1e3, (10.0,), "of the force", magnitude=True),)

    def respond(self, trace, inputs, force, values):
        return force + values[0]
"""


def bag(path, offset_N=0.0, seed=1, seconds=3.0, **more):
    path.parent.mkdir(parents=True, exist_ok=True)
    recording = cheap_diagnosis.made(path.name, offset_N, seed, seconds)
    write_bag(path, (*recording_topics(recording, DEFAULT), *more.get("topics", ())))
    return path


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with a fleet of three vehicles, references, and a simulation as a function."""
    folder = tmp_path_factory.mktemp("diagnosed")
    (folder / "diagnosed_damper.py").write_text(MODULE)
    for vehicle, offset in (("red", 0.0), ("green", 40.0), ("blue", 90.0)):
        for seed, name in enumerate(("town", "road"), start=1):
            bag(folder / "fleet" / vehicle / name, offset, seed)
    bag(folder / "reference", 0.0, 9)
    return folder


@pytest.fixture
def here(work, monkeypatch):
    monkeypatch.chdir(work)
    monkeypatch.setattr(sys, "path", [str(work), *sys.path])
    return work


@pytest.fixture
def quick(here, monkeypatch):
    """The stand-in diagnosis; a fleet is diagnosed in this process."""
    import ces_cli.diagnose.program  # noqa: F401

    for place in ("ces_cli.diagnose.diagnosis", "ces_cli.diagnose.program"):
        monkeypatch.setattr(f"{place}.diagnose", cheap_diagnosis.diagnose)
        monkeypatch.setattr(f"{place}.result_files", cheap_diagnosis.files)
    monkeypatch.setattr("ces_identify.jobs.run_in_processes", run_here)
    return here


def test_bags_folders_and_globs_name_recordings(here):
    names = [str(path) for path in find_bags(["fleet/red", "fleet/*/road", "reference"])]
    assert names == [
        "fleet/red/road", "fleet/red/town", "fleet/blue/road", "fleet/green/road", "reference",
    ]  # fmt: skip
    assert len(find_bags(["fleet"])) == 6
    assert len(find_bags(["fleet/**"])) == 6
    assert find_bags(["fleet/red/road/road.mcap"]) == [Path("fleet/red/road/road.mcap")]
    assert find_bags(["nowhere"]) == [Path("nowhere")]  # the reader reports the error


@pytest.mark.parametrize(("word", "message"), [("fleet/*/none", "no bag matches"), (".", "no bag in this folder")])
def test_arguments_that_name_no_bag(tmp_path, monkeypatch, word, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CesError, match=message):
        find_bags([word])


def test_units_of_a_fleet_have_distinct_names(here):
    assert [(u.name, len(u.paths)) for u in find_fleet_units(["fleet"], "vehicle")] == [
        ("blue", 2),
        ("green", 2),
        ("red", 2),
    ]
    recordings = find_fleet_units(["fleet"], "recording")
    assert [u.name for u in recordings[:3]] == ["blue_road", "blue_town", "green_road"]
    assert [u.name for u in find_fleet_units(["fleet/red", "reference"], "recording")] == ["road", "town", "reference"]


def test_the_result_is_printed_and_written(quick, capsys):
    words = ("--real", "fleet/blue", "--reference", "reference", "--out", "one", "--effects", "diagnosed_damper:Own")
    assert ces("diagnose", "--sim", SIM, *words) == 0
    printed = capsys.readouterr().out
    assert "NAMED: the gap is 89.9 N" in printed
    assert "left, the gap shrinks by 97 % [87, 107]" in printed
    assert json.loads((quick / "one" / "gap.json").read_text())["rms_N"] == pytest.approx(90.0, abs=1.0)
    assert (
        "'real': ['road', 'town'], 'held_out': [], 'reference': ['reference']"
        in (quick / "one" / "report.html").read_text()
    )


def test_the_document_is_the_diagnosis_with_all_digits(quick, capsys):
    words = ("--real", "fleet/blue", "--reference", "reference", "--out", "document", "--json")
    assert ces("diagnose", "--sim", SIM, *words) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "ces-diagnose/1" and document["folder"] == "document"
    gap = document["diagnosis"]["gap"]["rms_N"]
    assert gap == pytest.approx(90.0, abs=1.0) and gap != round(gap, 6)


def test_files_of_an_earlier_run_are_removed(quick):
    (quick / "stale").mkdir()
    for name in ("next_experiment.yaml", "next_experiment.csv", "mine.txt"):
        (quick / "stale" / name).write_text("old")
    (quick / "stale" / "gap.json").write_text('{"schema": "ces-gap/1"}')
    assert ces("diagnose", "--sim", SIM, "--real", "fleet/red", "--out", "stale") == 2  # not without --overwrite
    assert ces("diagnose", "--sim", SIM, "--real", "fleet/red", "--out", "stale", "--overwrite") == 0
    assert sorted(path.name for path in (quick / "stale").iterdir()) == ["gap.json", "mine.txt", "report.html"]


@pytest.mark.parametrize("full", ["report.html", "gap.json"])
def test_a_diagnosis_is_shown_and_what_fits_is_written_on_a_full_disk(quick, capsys, monkeypatch, full):
    def write(files):
        if full in [path.name for path in files]:
            raise CesError(f"{full}: cannot be written: full; run the same command")
        write_all_atomically(files)

    out = quick / f"no {full}"
    out.mkdir()
    monkeypatch.setattr("ces_cli.diagnose.diagnosis.write_all_atomically", write)
    assert ces("diagnose", "--sim", SIM, "--real", "fleet/blue", "--out", out) == 2
    printed = capsys.readouterr()
    assert "NAMED: the gap is 89.9 N" in printed.out
    kept = full == "report.html"
    assert ("written: " in printed.out) == kept
    told = "run the same command with --overwrite; gap.json are complete\n" if kept else "run the same command\n"
    assert printed.err.endswith(told)
    assert [path.name for path in out.iterdir()] == ["gap.json"] * kept


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (diagnoses.named, ["NAMED: The simulation lacks seal friction", "friction (Coulomb)", "speed ",
                           "not observable: bump_stop", "ces rig gap/next_experiment.yaml", "--teacher gap"]),
        (diagnoses.ambiguous, ["AMBIGUOUS: Valve lag or current hysteresis", "indistinguishable on these recordings: v",
                               "not separable from a calibration", "a twin with J = 2.70 % replaced"]),
        (diagnoses.unknown, ["UNKNOWN: None of the known effects", "unexplained: ", "at its bound", "none of these"]),
        (diagnoses.no_gap, ["NO GAP: No gap", "gap: 2.1 N RMS [0.0, 3.4]"]),
    ],
)  # fmt: skip
def test_every_verdict_is_printed(made, message, capsys, monkeypatch):
    from ces_cli.diagnose.diagnosis import print_diagnosis

    monkeypatch.setattr("ces_cli.terminal.terminal.out.width", 120)
    print_diagnosis(made(), Path("gap"), ("gap.json", "report.html"))
    printed = capsys.readouterr().out
    assert [text for text in message if text not in printed] == []
    assert printed.splitlines()[-1] == "written: gap/gap.json, report.html"
    assert ("--teacher" in printed) == (made in (diagnoses.named, diagnoses.ambiguous))


def narrow(path):
    """A model identified on far less current than the recordings have."""
    envelope = Envelope((-0.05, 0.05), (-2.0, 2.0), (1.5, 2.0))
    terms = (Term(1200.0, (Factor("speed", 0),)),)
    Model(make_sampling(200.0, 0.02), Polynomial(terms), envelope, (-3e4, 3e4)).save(path)
    return path


def rows_of(folder):
    return {row["name"]: row for row in csv.DictReader((folder / "fleet.csv").open())}


def test_a_fleet_has_a_row_for_each_vehicle(quick, capsys):
    words = ("diagnose", "--sim", SIM, "--real", "fleet/*", "--each", "vehicle", "--out", "fleet_gap", "--jobs", 2)
    assert ces(*words) == 0
    printed = capsys.readouterr()
    assert "3 of 3 diagnosed" in printed.out
    rows = rows_of(quick / "fleet_gap")
    assert list(rows) == ["blue", "green", "red"]  # the largest gap first
    assert rows["red"]["verdict"] == "no_gap"
    assert float(rows["green"]["gap_N"]) == pytest.approx(40.0, abs=1.0)
    assert rows["blue"]["recordings"] == "road + town"
    assert all((quick / "fleet_gap" / row["folder"] / "report.html").is_file() for row in rows.values())
    lines = (quick / "fleet_gap" / "fleet.jsonl").read_bytes()
    assert ces(*words, "--json") == 0  # all results exist
    document = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in document["diagnoses"]] == list(rows)
    assert [row["gap_N"] for row in document["diagnoses"]] == [float(row["gap_N"]) for row in rows.values()]
    assert (quick / "fleet_gap" / "fleet.jsonl").read_bytes() == lines
    assert ces(*words, "--seed", 2) == 0
    assert "fleet_gap: also holds 3 results of other recordings or options" in capsys.readouterr().err


def test_vehicles_that_the_model_was_identified_on_are_named(quick, capsys):
    model = load_model(narrow(quick / "known.json"))
    marks = " ".join(recording_marks(read_recording(Path("fleet/red/town"), DEFAULT)))
    known = {"identification": [{"recording": "town", "sha256": "", "marks": marks}]}
    replace(model, provenance=known).save(quick / "known.json")
    words = ("--sim", "known.json", "--real", "fleet/red", "--reference", "fleet/red/town", "--each", "vehicle")
    assert ces("diagnose", *words, "--out", "known_gap", "--jobs", 1) == 2
    printed = " ".join(capsys.readouterr().err.split())
    assert "red: known.json was identified on seconds of their recordings" in printed
    assert "the same recording, under --real and --reference" in printed


def test_failures_do_not_stop_the_other_diagnoses(quick, capsys, tmp_path):
    bag(tmp_path / "spoiled" / "good", 40.0, 5), bag(tmp_path / "spoiled" / "refused", 10.0, 6)
    bag(tmp_path / "spoiled" / "twin", 40.0, 5)
    (tmp_path / "spoiled" / "torn").mkdir()
    (tmp_path / "spoiled" / "torn" / "metadata.yaml").write_text("no: bag\n")
    words = (
        "--sim",
        SIM,
        "--real",
        tmp_path / "spoiled",
        "--each",
        "recording",
        "--out",
        tmp_path / "out",
        "--jobs",
        2,
    )
    for _ in range(2):
        assert ces("diagnose", *words) == 0
        printed = capsys.readouterr()
        assert "1 of 4 diagnosed" in printed.out or "2 of 4 diagnosed" in printed.out
        assert "warning: refused: refused: too short" in printed.err
        assert "torn: cannot be opened as a bag" in printed.err
    assert {row["status"] for row in rows_of(tmp_path / "out").values()} == {"done", "failed"}
