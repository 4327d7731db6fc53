"""Whole diagnoses on a cheap damper: named causes, no gap, unknown causes, recorded predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from engine_plant import NOISE_N, SIMULATION, WEIGHTS, F, Truth, damper, recorded
from whole_diagnosis_examples import STIFFNESS, sprung, strange, wrong

from ces_data.recording import Channel, Recording
from ces_gap import pipeline as diagnose_module
from ces_gap.diagnosis import NAMED, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.effects.effect import Effect, EffectParameter
from ces_gap.errors import GapError
from ces_gap.inputs import prepare as prepare_module
from ces_gap.pipeline import DiagnoseOptions, diagnose
from ces_gap.trace import Trace, TraceInputs
from ces_identify.simulations.simulation import FunctionSimulation, RecordedSimulation, Simulation


def late(time_s: F, position_m: F, current_A: F) -> F:
    """The damper 4 ms behind its position."""
    return damper(time_s, np.interp(time_s - 0.004, time_s, position_m), current_A)


class Ripple(Effect):
    """An effect of the user: the one of `strange`."""

    name, form, needs = "ripple", "sine", "motion"
    parameters = (EffectParameter("ripple_N", 0.0, 500.0, (50.0,), "size", magnitude=True),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] * np.sin(inputs.speed / 0.08) * np.cos(4.0 * inputs.current))


def add_predictions(recording: Recording) -> Recording:
    channel = Channel("sim_force", "N", recording.channel("position").stamps_ns, SIMULATION.force(recording))
    return replace(recording, channels={**recording.channels, "sim_force": channel})


@pytest.fixture(autouse=True)
def run_directly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the simulation directly on a busy machine too, with fixed weights of the verdict."""
    monkeypatch.setattr(prepare_module, "SLOW_S", 60.0)
    monkeypatch.setattr(diagnose_module, "calibration", lambda *_: WEIGHTS)


@cache
def run_diagnosis(
    truth: Truth, effects: tuple[Effect, ...] = (), only_recorded: bool = False, threads: int = 1
) -> Diagnosis:
    simulation: Simulation = RecordedSimulation("/prediction") if only_recorded else SIMULATION
    kinds = ((truth, (1, 2), 5.0), (truth, (3,), 5.0), (wrong, (11, 12), 10.0))
    real, held_out, reference = ([recorded(of, seed, seconds) for seed in seeds] for of, seeds, seconds in kinds)
    if only_recorded:
        real, held_out, reference = ([add_predictions(r) for r in some] for some in (real, held_out, reference))
    return diagnose(
        simulation, "damper.py:force", real, held_out, reference, DiagnoseOptions(effects, threads, experiment=False)
    )


def sum_of_probabilities(found: Diagnosis) -> float:
    return found.probability_none + found.probability_unknown + sum(c.probability for c in found.causes)


def test_a_cause_is_named_with_its_parameter_despite_a_baseline_error() -> None:
    found = run_diagnosis(sprung)
    assert found.verdict == NAMED and found.composition.effects == ("gas_spring",)
    assert found.causes[0].effects == ("gas_spring",) and found.causes[0].probability > 0.5
    stiffness = next(e for e in found.composition.estimates[0] if e.name == "stiffness_N_m")
    assert stiffness.value == pytest.approx(STIFFNESS, rel=0.05) and not stiffness.at_bound
    assert stiffness.ci95[0] < stiffness.value < stiffness.ci95[1]
    assert "gas spring" in found.sentence
    assert sum_of_probabilities(found) == pytest.approx(1.0)


def test_the_planted_effect_is_removed_from_the_gap() -> None:
    found = run_diagnosis(sprung)
    stroke = recorded(sprung, 3, 5.0)
    planted = STIFFNESS * stroke.channel("position").values
    assert found.gap.corrected_N == pytest.approx(float(np.sqrt(np.mean(planted**2))), rel=0.1)
    assert found.gap.rms_N > found.gap.corrected_N
    assert found.gap.ci95_N[0] < found.gap.rms_N < found.gap.ci95_N[1]
    assert found.composition.gap_after_N < NOISE_N and found.composition.shrink > 0.85
    assert found.wrong is not None and found.wrong.effects[0] not in found.composition.effects
    others = [cause.shrink for cause in found.causes if cause.effects[0] not in found.composition.effects]
    assert found.wrong.shrink == np.nanmax(others)
    left = {cause.effects[0]: cause.gap_after_N for cause in found.causes}
    assert min(left["position_delay"], left["friction"], left["inertia"]) > 3.0 * NOISE_N
    assert [s.trace.name for s in found.held_out] == ["made3"]
    trace, augmented = found.held_out[0].trace, found.held_out[0].augmented
    assert np.std((trace.force - augmented)[trace.usable]) == pytest.approx(NOISE_N, rel=0.15)


def test_a_wrong_simulation_without_an_effect_has_no_gap() -> None:
    found = run_diagnosis(wrong)
    assert found.verdict == NO_GAP and found.probability_none > 0.5
    assert found.composition.effects == () and found.correction is not None
    assert found.gap.rms_N > 5.0 * NOISE_N > 10.0 * found.gap.corrected_N
    assert sum_of_probabilities(found) == pytest.approx(1.0)
    assert found.next_experiment is None and found.rest is None


def test_an_unknown_cause_is_reported_and_located() -> None:
    found = run_diagnosis(strange)
    assert found.verdict == UNKNOWN and found.probability_unknown > 0.5
    assert found.rest is not None and found.rest.regions
    assert found.composition.gap_after_N > 0.5 * found.gap.corrected_N
    assert found.ceiling_after_N < found.gap.corrected_N
    assert sum_of_probabilities(found) == pytest.approx(1.0)


def test_an_effect_of_the_user_explains_the_gap() -> None:
    found = run_diagnosis(strange, (Ripple(),))
    assert found.verdict == NAMED and found.composition.effects == ("ripple",)
    assert found.composition.estimates[0][0].value == pytest.approx(120.0, rel=0.05)


def test_recorded_predictions_are_sufficient() -> None:
    found = run_diagnosis(sprung, only_recorded=True)
    assert found.verdict == NAMED and found.composition.effects == ("gas_spring",)
    assert found.surrogate is not None and found.surrogate_cost_J == found.surrogate.cost_J
    assert found.surrogate_error == found.surrogate.difference_error
    assert found.composition.shrink > 0.85
    assert run_diagnosis(sprung).surrogate is None and run_diagnosis(sprung).surrogate_cost_J is None


def test_the_diagnosis_does_not_depend_on_the_number_of_threads() -> None:
    first, again = run_diagnosis(wrong), run_diagnosis(wrong, threads=2)
    assert again.gap == first.gap and again.figures == first.figures
    assert [(c.effects, c.probability, c.shrink) for c in again.causes] == [
        (c.effects, c.probability, c.shrink) for c in first.causes
    ]


def test_without_references_a_cause_that_no_calibration_absorbs_is_named() -> None:
    real, held_out = [recorded(late, seed, 5.0) for seed in (1, 2)], [recorded(late, 3, 5.0)]
    found = diagnose(SIMULATION, "damper.py:force", real, held_out, options=DiagnoseOptions(experiment=False))
    assert found.verdict == NAMED and found.composition.effects == ("position_delay",)
    assert found.composition.estimates[0][0].value == pytest.approx(0.004, abs=2e-4)
    assert found.gap.corrected_N == pytest.approx(found.gap.rms_N) and found.correction is None
    assert "position_delay" not in found.not_separable and "gas_spring" in found.not_separable


def test_a_simulation_of_the_wrong_sign_is_refused() -> None:
    backwards = FunctionSimulation("backwards", lambda t, x, i: -damper(t, x, i))
    with pytest.raises(GapError, match="sign"):
        diagnose(backwards, "backwards", [recorded(seconds=6.0)], [recorded(seed=2)], [])


def test_too_little_data_is_refused_before_the_fit() -> None:
    told: list[str] = []
    with pytest.raises(GapError, match="expected at least"):
        diagnose(
            SIMULATION,
            "m",
            [recorded(seconds=2.0)],
            [recorded(seed=2)],
            (),
            None,
            lambda what, share: told.append(what),
        )
    assert all("simulating" in what for what in told)


def test_an_effect_that_violates_its_contract_is_refused() -> None:
    class Breaking(Ripple):
        """Returns invalid forces."""

        def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
            return np.full(len(force), np.nan)

    with pytest.raises(GapError, match="ripple"):
        diagnose(SIMULATION, "m", [recorded()], [recorded(seed=2)], (), DiagnoseOptions((Breaking(),)))
