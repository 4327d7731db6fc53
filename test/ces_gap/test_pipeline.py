"""The diagnosis as a pipeline: each result is computed once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import pytest
from engine_plant import SIMULATION, WEIGHTS, F, damper, recorded
from example_effects import CurrentGain, Friction, Spring
from whole_diagnosis_examples import STIFFNESS, sprung, strange, wrong

from ces_gap import pipeline
from ces_gap.diagnosis import NAMED, UNKNOWN, Diagnosis
from ces_gap.effects.effect import Effect
from ces_gap.errors import GapError
from ces_gap.inference import evidence, verdict
from ces_gap.inference.held_out import HeldOutScorer
from ces_gap.inputs import prepare
from ces_gap.pipeline import DiagnoseOptions, diagnose
from ces_identify.simulations.simulation import FunctionSimulation

FEW: tuple[Effect, ...] = (CurrentGain(), Friction(), Spring())


@pytest.fixture(autouse=True)
def _few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "library", lambda: FEW)
    monkeypatch.setattr(pipeline, "calibration", lambda mode: WEIGHTS)
    monkeypatch.setattr(prepare, "SLOW_S", 60.0)


def run_diagnosis(with_references: bool = True) -> Diagnosis:
    reference = [recorded(wrong, s, 8.0) for s in (11, 12)] if with_references else []
    real, held_out = [recorded(sprung, s, 4.0) for s in (1, 2)], [recorded(sprung, 3, 4.0)]
    return diagnose(SIMULATION, "damper", real, held_out, reference, DiagnoseOptions(experiment=False))


def count(monkeypatch: pytest.MonkeyPatch, places: list[Any], name: str) -> list[Any]:
    """Return a list that gets the arguments of every call."""
    calls: list[Any] = []
    for place in places:
        plain: Callable[..., Any] = getattr(place, name)
        monkeypatch.setattr(place, name, lambda *given, _plain=plain: (calls.append(given), _plain(*given))[1])
    return calls


@pytest.mark.parametrize("with_references", [True, False])
def test_the_ceiling_is_learnt_once_from_the_gap_and_once_from_the_rest(
    monkeypatch: pytest.MonkeyPatch, with_references: bool
) -> None:
    calls = count(monkeypatch, [evidence, verdict], "learn_ceiling")
    found = run_diagnosis(with_references)
    assert found.figures is not None and len(calls) == 2


def test_the_held_out_forces_of_each_explanation_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = count(monkeypatch, [HeldOutScorer], "forces")
    found = run_diagnosis()
    assert found.verdict == NAMED and found.composition.effects == ("spring",)
    compositions = [fit.composition for _, fit, _ in calls]
    assert len(compositions) == len(FEW) and all(compositions.count(c) == 1 for c in compositions)


def test_results_of_the_same_recordings_are_equal_and_frozen() -> None:
    first, again = run_diagnosis(), run_diagnosis()
    assert first.figures == again.figures and first.gap == again.gap and first.causes == again.causes
    for record in (first, first.gap, first.where, first.causes[0], first.held_out[0].trace):
        assert is_dataclass(record) and fields(record) and type(record).__dataclass_params__.frozen  # type: ignore[attr-defined]


def test_the_verdict_stands_if_no_experiment_can_be_simulated() -> None:
    def short_memory(time_s: F, position_m: F, current_A: F) -> F:
        if time_s[-1] - time_s[0] > 9.0:
            raise GapError("at most 9 s can be simulated")
        return damper(time_s, position_m, current_A)

    def truth(time_s: F, position_m: F, current_A: F) -> F:
        return strange(time_s, position_m, current_A) + STIFFNESS * position_m

    simulation = FunctionSimulation("short_memory", short_memory)
    reference = [recorded(wrong, s, 8.0) for s in (11, 12)]
    real, held_out = [recorded(truth, s, 4.0) for s in (1, 2)], [recorded(truth, 3, 4.0)]
    found = diagnose(simulation, "short_memory", real, held_out, reference)
    assert found.verdict == UNKNOWN and found.composition.effects and found.next_experiment is None
    assert "next experiment not available: the simulation refuses all" in found.notes[-1]
