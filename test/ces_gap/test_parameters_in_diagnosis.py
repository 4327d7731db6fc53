"""Parameters of the user's simulator compete with missing effects: alone, beside an effect, and instead of one."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from programs import ONE_KIND

from bench.gaps.users_dampers import SIMULATORS, record
from ces_cli.terminal.inputs import open_simulation
from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, Diagnosis
from ces_gap.pipeline import DiagnoseOptions, diagnose
from ces_gap.report.gap_json import gap_document
from ces_gap.result_files import result_files
from ces_identify.simulations.simulation import FunctionSimulation

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _one_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(*ONE_KIND)


def diagnose_own(kind: str, values: dict[str, float], fit: tuple[str, ...] = (), **missing: float) -> Diagnosis:
    made = [record(kind, values, seed, 10.0, **missing) for seed in (1, 2, 3)]
    simulation, options = FunctionSimulation(kind, SIMULATORS[kind]), DiagnoseOptions(experiment=False, fit=fit)
    return diagnose(simulation, f"bench.gaps.users_dampers:{kind}", made[:2], made[2:], options=options)


def test_wrong_parameters_are_named_and_no_effect(tmp_path: Path) -> None:
    true = {"stiffness_N_m": 3e5, "relief_N": 300.0}
    d = diagnose_own("chamber", true)
    assert (d.verdict, d.composition.effects) == (NAMED, ("parameters",))
    assert d.sentence.startswith("stiffness_N_m is 300") and "With both the gap shrinks from " in d.sentence
    document = gap_document(d)
    cause = document["causes"][0]
    assert cause["effect"] == "parameters" and cause["probability"] > 0.9 and cause["shrink"] > 0.9
    assert cause["parameters"]["relief_N"]["default"] == 220.0
    low, high = cause["parameters"]["relief_N"]["ci95"]
    assert 299.0 < low < high < 301.0
    total = sum(c["probability"] for c in document["causes"]) + sum(document["probabilities"].values())
    assert total == pytest.approx(1.0, abs=0.01)
    files = result_files(d, {"spec": d.simulation, "sha256": None}, ())
    (tmp_path / "augmented.json").write_text(files["augmented.json"])
    assert json.loads(files["augmented.json"])["parameters"]["relief_N"] == pytest.approx(300.0, rel=0.02)
    assert "numbers of the simulation are off" in files["report.html"]
    held = record("chamber", true, 3, 10.0, noise_N=0.0)
    repaired = open_simulation(str(tmp_path / "augmented.json")).force(held)
    assert np.sqrt(np.mean((repaired - held.channel("force").values) ** 2)) < 3.0


def test_an_effect_is_seen_beside_two_wrong_parameters() -> None:
    d = diagnose_own("chamber", {"relief_N": 300.0, "stiffness_N_m": 3e5}, mass_kg=2.0)
    assert d.verdict == NAMED and d.composition.effects == ("parameters", "inertia")
    assert {e.name for e in d.composition.estimates[0]} == {"relief_N", "stiffness_N_m"}
    assert re.search(r"Beside both, inertia of [12][.\d]* kg is missing\. With both the gap shrinks from", d.sentence)
    assert d.composition.gap_after_N < 0.05 * d.gap.rms_N < d.gap.corrected_N


def test_a_missing_effect_is_not_taken_for_a_parameter() -> None:
    d = diagnose_own("bouc_wen", {}, friction_N=25.0)
    assert d.verdict == NAMED and d.composition.effects == ("friction",)
    assert "parameters" not in {name for c in d.causes for name in c.effects}


def test_what_explains_as_much_is_printed() -> None:
    d = diagnose_own("knee", {"seal_N": 43.0})
    assert d.verdict == AMBIGUOUS and d.composition.effects == ("parameters",)
    assert d.explained_as_well == (("friction",),) and d.alternatives == ("friction",)
    assert "As much would be explained by friction of " in d.sentence


@pytest.mark.parametrize(("fit", "verdict"), [((), NO_GAP), (("none",), NO_GAP)])
def test_a_right_simulation_has_no_gap(fit: tuple[str, ...], verdict: str) -> None:
    assert diagnose_own("knee", {}, fit).verdict == verdict


def test_parameters_stay_fixed_on_request_or_within_their_range() -> None:
    fixed = diagnose_own("knee", {"gas_N_m": 2990.0}, ("none",))
    assert "parameters" not in {name for c in fixed.causes for name in c.effects}
    some = diagnose_own("chamber", {"relief_N": 300.0}, ("relief_N=200..260",))
    assert some.verdict != NAMED and "relief_N lies at the end of the range or far from the default" in some.sentence


def test_a_simulation_that_fails_while_it_is_fitted_loses_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    def stateful(force: Callable[..., object], calls: list[int]) -> Callable[..., object]:
        def counting(time_s, position_m, current_A, *, seal_N=25.0):  # type: ignore[no-untyped-def]
            calls.append(1)
            return force(time_s, position_m, current_A, seal_N=seal_N + 1e-3 * len(calls))

        return counting

    made = [record("knee", {}, seed, 10.0, friction_N=25.0) for seed in (1, 2, 3)]
    simulation = FunctionSimulation("f", stateful(SIMULATORS["knee"], []))  # type: ignore[arg-type]
    d = diagnose(simulation, "f", made[:2], made[2:], options=DiagnoseOptions(experiment=False))
    assert "friction" in d.composition.effects
    assert any("parameters of the simulation not available: f: two equal calls" in note for note in d.notes)


def test_with_references_a_parameter_that_has_changed_since_competes() -> None:
    new = [record("knee", {}, seed, 8.0, lag_s=0.004) for seed in (11, 12)]  # the simulation's own error: a lag
    worn = [record("knee", {"seal_N": 60.0}, seed, 8.0, lag_s=0.004) for seed in (1, 2)]
    options = DiagnoseOptions(experiment=False, fit=("seal_N", "gas_N_m", "knee_m_s"))
    simulation = FunctionSimulation("knee", SIMULATORS["knee"])
    d = diagnose(simulation, "bench.gaps.users_dampers:knee", worn[:1], worn[1:], new, options)
    assert d.composition.effects == ("parameters",) and d.composition.gap_after_N < 0.3 * d.gap.corrected_N
    (seal,) = [e for e in d.composition.estimates[0] if e.name == "seal_N"]
    assert seal.value == pytest.approx(60.0, rel=0.1) and seal.default == 25.0
    assert " seal_N is " in d.sentence and ", not 25 (" in d.sentence
    fixed = diagnose(simulation, "s", worn[:1], worn[1:], new, DiagnoseOptions(experiment=False))
    assert "parameters" not in {name for c in fixed.causes for name in c.effects}
