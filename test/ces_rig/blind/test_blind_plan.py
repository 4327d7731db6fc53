"""The plan of a blind test, and a case on disk: of the planned size, bags that tell nothing, a seal."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ces_data.bags.reader import list_topics, read_recording
from ces_data.signals_file import load_signals
from ces_identify.simulations.simulation import FunctionSimulation
from ces_rig.blind.cases import (
    CaseLabel,
    SealedAnswers,
    WithheldLabel,
    open_arrays,
    open_seal,
    write_arrays,
    write_case,
    write_seal,
)
from ces_rig.blind.plan import KINDS, BlindCase, Levels, draw_case, is_visible, list_spare_effects, plan_sample
from ces_rig.dampers.stepper import KINDS as DAMPERS
from ces_rig.errors import RigError
from ces_rig.experiments.virtual import load_rig
from ces_rig.sensors import EPOCH_NS

LEVELS = Levels(
    effects=("friction", "valve_lag", "backlash", "leakage", "inertia"),
    outside=("groove", "hum"),
    plants={"hydraulic": DAMPERS["hydraulic"].design},
)


def test_half_of_the_cases_without_an_effect_have_a_wrong_simulation():
    none = [case for case in plan_sample(LEVELS, 1, 200) if case.kind == "none"]
    assert abs(sum(case.baseline_ratio > 0.0 for case in none) - len(none) / 2) <= 0.5
    assert all(case.effects == () for case in none)


def test_a_sample_is_balanced():
    cases = plan_sample(LEVELS, 3, 100)
    assert Counter(case.kind for case in cases) == {"effect": 60, "none": 14, "outside": 12, "pair": 14}
    effects = [case for case in cases if case.kind == "effect"]
    assert set(Counter(case.effects for case in effects).values()) == {12}
    assert set(Counter(case.gap_to_noise for case in effects).values()) == {15}
    assert set(Counter(case.baseline_ratio for case in effects).values()) == {20}
    assert all(is_visible(case.effects, case.excitation) for case in cases)
    assert all(len(set(case.effects)) == 2 for case in cases if case.kind == "pair")


def test_a_plan_is_a_function_of_its_seed():
    plan = plan_sample(LEVELS, 1, 60)
    assert plan == plan_sample(LEVELS, 1, 60) != plan_sample(LEVELS, 2, 60)
    assert [case.number for case in plan] == list(range(1, 61))
    assert len({case.seed for case in plan}) == 60


def test_numbers_say_nothing_about_the_kind():
    cases = plan_sample(LEVELS, 5, 400)
    places = {kind: [case.number for case in cases if case.kind == kind] for kind in KINDS}
    means = {kind: sum(numbers) / len(numbers) for kind, numbers in places.items()}
    assert all(abs(mean - 200.5) < 45.0 for mean in means.values())  # 2.5 standard errors of the smallest kind


def test_what_may_stand_in_is_of_the_same_kind_and_visible():
    for case in plan_sample(LEVELS, 7, 60):
        others = list_spare_effects(case, LEVELS)
        assert case.effects not in others
        assert all(len(other) == len(case.effects) and is_visible(other, case.excitation) for other in others)


def test_an_effect_that_no_excitation_shows_is_refused():
    with pytest.raises(RigError, match="valve_lag cannot be seen under constant_current"):
        plan_sample(Levels(("valve_lag",), (), {}, ("effect",), excitations=("constant_current",)), 1, 3)


SECONDS = 2.0

PLANTS = {"hydraulic": DAMPERS["hydraulic"].design}
FRICTION = BlindCase("effect", ("friction",), 3.0, 1.0 / 3.0, "rich", PLANTS, number=7, seed=12)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blind") / "0007"
    return folder, write_case(draw_case(FRICTION, SECONDS), folder)


def bag(folder, place):
    return read_recording(folder / place, load_signals())


@pytest.mark.slow
def test_effect_and_simulation_are_of_the_planned_size(made):
    label = made[1][0]
    assert label.gap_N == pytest.approx(24.0, rel=0.11)
    assert label.noise_N == 8.0
    assert label.baseline_error_N == pytest.approx(8.0, abs=3.5)  # in it what the sensors' noise does to the inputs
    assert [effect.name for effect in label.effects] == ["friction"]
    assert label.effects[0].physical


@pytest.mark.slow
def test_sealed_arrays_are_what_was_measured_without_its_noise(made):
    folder, (_label, arrays) = made
    force = bag(folder, "held_out/h1").channel("force")
    clock = bag(folder, "held_out/h1").channel("position").stamps_ns
    true = CubicSpline((clock - clock[0]) * 1e-9, arrays["h1_force_N"])((force.stamps_ns - clock[0]) * 1e-9)
    noise = (force.values - true)[100:-100]
    assert 1.4826 * np.median(np.abs(noise)) == pytest.approx(
        8.0, rel=0.1
    )  # robust: two clocks blur the sharpest steps
    assert abs(np.median(noise)) < 0.7


@pytest.mark.slow
def test_references_are_free_of_the_effect_and_the_rest_is_not(made):
    folder, (label, _arrays) = made
    simulate = FunctionSimulation("baseline", load_rig(folder / "baseline.yaml"))

    def gap(place):
        recording = bag(folder, place)
        force, clock = recording.channel("force"), recording.channel("position").stamps_ns
        return rms((force.values - np.interp(force.stamps_ns, clock, simulate.force(recording)))[100:-100])

    error = label.baseline_error_N
    assert gap("reference/f1") < 1.5 * np.hypot(8.0, error)
    assert gap("real/r1") > 2.0 * np.hypot(8.0, error)


@pytest.mark.slow
def test_the_folder_tells_nothing_of_what_is_withheld(made):
    folder, (_label, arrays) = made
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert not any(b"friction" in path.read_bytes().lower() for path in files)
    assert {path.stat().st_mtime for path in folder.rglob("*")} == {EPOCH_NS * 1e-9}
    described = json.loads((folder / "case.json").read_text())
    assert not set(described) & {"kind", "plant", "effects", "gap_to_noise", "baseline_ratio", "gap_N"}
    other_label, other_arrays = write_case(
        draw_case(BlindCase("none", (), 3.0, 0.0, "rich", PLANTS, 8, 5), SECONDS), folder.parent / "0008"
    )
    names = [sorted(str(p.relative_to(f)) for p in f.rglob("*")) for f in (folder, folder.parent / "0008")]
    assert names[0] == names[1]
    assert arrays.keys() == other_arrays.keys()
    assert other_label.gap_N == 0.0
    assert other_label.baseline_error_N < 6.0


@pytest.mark.slow
def test_predictions_in_the_bag_are_the_simulation_run_on_it(made):
    folder, (_label, arrays) = made
    assert "/sim_force" in {topic.name for topic in list_topics(folder / "held_out/h1")}
    simulate = FunctionSimulation("baseline", load_rig(folder / "baseline.yaml"))
    force = simulate.force(bag(folder, "held_out/h1"))
    assert arrays["h1_baseline_N"] == pytest.approx(force, abs=0.01)


@pytest.mark.slow
def test_a_case_repeats_exactly(made, tmp_path):
    again, _ = write_case(draw_case(FRICTION, SECONDS), tmp_path / "0007")
    assert again == made[1][0]
    for place in ("real/r2/r2.mcap", "reference/f1/f1.mcap", "baseline.yaml"):
        assert (tmp_path / "0007" / place).read_bytes() == (made[0] / place).read_bytes()


@pytest.fixture
def sealed(tmp_path):
    arrays = {"h1_force_N": np.linspace(0.0, 1.0, 5, dtype=np.float32)}
    effects, digest = (WithheldLabel("friction"),), write_arrays(tmp_path, "0001", arrays)
    label = CaseLabel("0001", "effect", effects=effects, arrays_sha256=digest)
    digest = write_seal(tmp_path, {"seed": 4}, [label])
    return tmp_path, label, digest


def test_labels_and_arrays_come_out_of_their_seal(sealed, tmp_path_factory):
    folder, label, digest = sealed
    assert open_seal(folder) == SealedAnswers({"seed": 4}, (label,))
    assert open_arrays(folder, label)["h1_force_N"] == pytest.approx(np.linspace(0.0, 1.0, 5))
    assert (folder / "cases" / "seal.sha256").read_text().strip() == digest
    assert "effect" not in (folder / "seal.json").read_text(), "labels cannot be read by accident"
    assert write_seal(tmp_path_factory.mktemp("again"), {"seed": 4}, [label]) != digest


def test_other_labels_and_arrays_are_refused(sealed, tmp_path_factory):
    folder, label, _ = sealed
    write_arrays(folder, "0001", {"h1_force_N": np.zeros(5, np.float32)})
    with pytest.raises(RigError, match=r"0001\.npz: its hash is not the sealed one"):
        open_arrays(folder, label)
    other = tmp_path_factory.mktemp("other")
    write_seal(other, {"seed": 4}, [replace(label, kind="none")])
    (folder / "seal.json").write_text((other / "seal.json").read_text())
    with pytest.raises(RigError, match="its hash is not the published one"):
        open_seal(folder)


@pytest.mark.parametrize("text", ["", "{}", "[1]", json.dumps({"salt": "a"})])
def test_what_is_no_seal_is_refused_in_one_line(sealed, text):
    (sealed[0] / "seal.json").write_text(text)
    with pytest.raises(RigError, match="not a sealed blind test"):
        open_seal(sealed[0])
