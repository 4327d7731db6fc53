"""Whole diagnoses on a cheap damper: named, no gap, unknown, recorded predictions; each step is computed once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from bands import make_band
from damper_models import plain_damper
from engine_plant import NOISE_N, RATE_HZ, SIMULATION, WEIGHTS, F, Truth, add_predictions, damper, recorded
from hydraulic_models import make_hydraulic
from physical_models import PLAIN_VALVE

from ces_data.recording import Recording
from ces_gap import pipeline
from ces_gap.baseline.twin import STEP_S, Twin
from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis, find_best_other
from ces_gap.effects.effect import Effect, EffectParameter
from ces_gap.effects.library import library_effect
from ces_gap.errors import GapError
from ces_gap.inference import evidence, findings
from ces_gap.inference.held_out import HeldOutScorer
from ces_gap.inputs import prepare
from ces_gap.limits import TwinLimits
from ces_gap.pipeline import DiagnoseOptions, diagnose
from ces_gap.progress import OptionalSteps
from ces_gap.trace import Trace, TraceInputs
from ces_identify.simulations.simulate import sample_force
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, RecordedSimulation, Simulation

STIFFNESS = 3000.0
QUICK = DiagnoseOptions(experiment=False)

FEW = ("friction", "coulomb_stribeck"), ("gas_spring", "linear"), ("position_delay", "shift"), ("inertia", "mass")


def wrong(time_s: F, position_m: F, current_A: F) -> F:
    """A real damper of which the simulation is a rough model, without an effect."""
    speed = np.gradient(position_m, time_s)
    bent = 60.0 * speed * np.abs(speed) + 30.0 * np.tanh(speed / 0.1)
    return np.asarray(1.05 * damper(time_s, position_m, current_A) + bent)


def sprung(time_s: F, position_m: F, current_A: F) -> F:
    """The same with a gas spring."""
    return wrong(time_s, position_m, current_A) + STIFFNESS * position_m


def strange(time_s: F, position_m: F, current_A: F) -> F:
    """The same with an effect that the library does not have."""
    speed = np.gradient(position_m, time_s)
    return np.asarray(wrong(time_s, position_m, current_A) + 120.0 * np.sin(speed / 0.08) * np.cos(4.0 * current_A))


def late(time_s: F, position_m: F, current_A: F) -> F:
    """The damper 4 ms behind its position."""
    return damper(time_s, np.interp(time_s - 0.004, time_s, position_m), current_A)


class Ripple(Effect):
    """An effect of the user: the one of `strange`."""

    name, form, needs = "ripple", "sine", "motion"
    parameters = (EffectParameter("ripple_N", 0.0, 500.0, (50.0,), "size", magnitude=True),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] * np.sin(inputs.speed / 0.08) * np.cos(4.0 * inputs.current))


@pytest.fixture(autouse=True)
def run_directly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the simulation directly on a busy machine too, with fixed weights of the verdict."""
    monkeypatch.setattr(TwinLimits, "SLOW_S", 60.0)
    monkeypatch.setattr(pipeline, "calibration", lambda *_: WEIGHTS)


@pytest.fixture
def few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small library, where its size proves nothing."""
    few = tuple(library_effect(*one) for one in FEW)
    monkeypatch.setattr(pipeline, "library", lambda: few)


def run_diagnosis(
    truth: Truth,
    effects: tuple[Effect, ...] = (),
    only_recorded: bool = False,
    threads: int = 1,
    references: bool = True,
) -> Diagnosis:
    simulation: Simulation = RecordedSimulation("/prediction") if only_recorded else SIMULATION
    seeds_of_references = (11, 12) if references else ()
    kinds = ((truth, (1, 2), 5.0), (truth, (3,), 5.0), (wrong, seeds_of_references, 6.0 if only_recorded else 8.0))
    real, held_out, reference = ([recorded(of, seed, seconds) for seed in seeds] for of, seeds, seconds in kinds)
    if only_recorded:
        real, held_out, reference = ([add_predictions(r) for r in some] for some in (real, held_out, reference))
    options = DiagnoseOptions(effects, threads, experiment=False)
    return diagnose(simulation, "damper.py:force", real, held_out, reference, options)


@cache
def diagnosis_of_sprung() -> Diagnosis:
    return run_diagnosis(sprung)


def sum_of_probabilities(diagnosis: Diagnosis) -> float:
    """Return the sum over what excludes each other: effects together count once."""
    together = diagnosis.composition.effects if diagnosis.is_combined else ()
    return sum(one.probability for one in diagnosis.possibilities if not {*one.effects} < {*together})


@pytest.mark.slow
def test_a_cause_is_named_with_its_parameter_despite_a_baseline_error() -> None:
    diagnosis = diagnosis_of_sprung()
    assert diagnosis.verdict == NAMED and diagnosis.composition.effects == ("gas_spring",)
    assert diagnosis.causes[0].effects == ("gas_spring",) and diagnosis.causes[0].probability > 0.5
    frame = pytest.importorskip("pandas") and diagnosis.to_frame()
    assert frame["effect"][0] == "gas_spring" and len(frame) == len(diagnosis.causes) + 2
    low, shrink, high = (frame[f"shrink{end}_percent"][0] for end in ("_low", "", "_high"))
    assert low < shrink < high
    assert "stiffness_N_m" in [*diagnosis.composition.to_frame()["parameter"]]
    stiffness = next(e for e in diagnosis.composition.estimates[0] if e.name == "stiffness_N_m")
    assert stiffness.value == pytest.approx(STIFFNESS, rel=0.05) and not stiffness.at_bound
    assert stiffness.ci95[0] < stiffness.value < stiffness.ci95[1]
    assert "gas spring" in diagnosis.sentence
    assert sum_of_probabilities(diagnosis) == pytest.approx(1.0)
    assert not diagnosis.is_recorded


@pytest.mark.slow
def test_the_planted_effect_is_removed_from_the_gap() -> None:
    diagnosis = diagnosis_of_sprung()
    planted = STIFFNESS * recorded(sprung, 3, 5.0).channel("position").values
    assert diagnosis.gap.corrected_N == pytest.approx(float(np.sqrt(np.mean(planted**2))), rel=0.1)
    assert diagnosis.gap.rms_N > diagnosis.gap.corrected_N
    assert diagnosis.gap.ci95_N[0] < diagnosis.gap.rms_N < diagnosis.gap.ci95_N[1]
    assert diagnosis.composition.gap_after_N < NOISE_N and diagnosis.composition.shrink > 0.85
    other = find_best_other(diagnosis, diagnosis.composition)
    assert other is not None and other.effects[0] not in diagnosis.composition.effects
    others = [cause.shrink for cause in diagnosis.causes if cause.effects[0] not in diagnosis.composition.effects]
    assert other.shrink == np.nanmax(others)
    left = {cause.effects[0]: cause.gap_after_N for cause in diagnosis.causes}
    assert min(left["position_delay"], left["friction"], left["inertia"]) > 3.0 * NOISE_N
    assert [s.trace.name for s in diagnosis.held_out] == ["made3"]
    trace, augmented = diagnosis.held_out[0].trace, diagnosis.held_out[0].augmented
    assert np.std((trace.force - augmented)[trace.usable]) == pytest.approx(NOISE_N, rel=0.15)


@pytest.mark.slow
def test_an_unknown_cause_is_reported_and_located() -> None:
    diagnosis = run_diagnosis(strange)
    assert diagnosis.verdict == UNKNOWN and diagnosis.probability_unknown > 0.5
    assert diagnosis.rest is not None and diagnosis.rest.regions
    assert diagnosis.composition.gap_after_N > 0.5 * diagnosis.gap.corrected_N
    assert diagnosis.ceiling_after_N < diagnosis.gap.corrected_N
    assert sum_of_probabilities(diagnosis) == pytest.approx(1.0)


@pytest.mark.slow
def test_a_wrong_simulation_without_an_effect_has_no_gap_whatever_the_threads(few_effects: None) -> None:
    diagnosis, again = run_diagnosis(wrong), run_diagnosis(wrong, threads=2)
    assert diagnosis.verdict == NO_GAP and diagnosis.probability_none > 0.5
    assert diagnosis.composition.effects == () and diagnosis.correction is not None
    assert diagnosis.gap.rms_N > 5.0 * NOISE_N > 10.0 * diagnosis.gap.corrected_N
    assert sum_of_probabilities(diagnosis) == pytest.approx(1.0)
    assert diagnosis.next_experiment is None and diagnosis.rest is None
    assert again.gap == diagnosis.gap and again.figures == diagnosis.figures and again.causes == diagnosis.causes
    for record in (diagnosis, diagnosis.gap, diagnosis.where, diagnosis.causes[0], diagnosis.held_out[0].trace):
        assert is_dataclass(record) and fields(record) and type(record).__dataclass_params__.frozen  # type: ignore[attr-defined]


def test_an_effect_of_the_user_explains_the_gap(few_effects: None) -> None:
    diagnosis = run_diagnosis(strange, (Ripple(),))
    assert diagnosis.verdict == NAMED and diagnosis.composition.effects == ("ripple",)
    assert diagnosis.composition.estimates[0][0].value == pytest.approx(120.0, rel=0.05)


@pytest.mark.slow
def test_recorded_predictions_are_sufficient(few_effects: None) -> None:
    diagnosis = run_diagnosis(sprung, only_recorded=True)
    assert diagnosis.verdict == NAMED and diagnosis.composition.effects == ("gas_spring",)
    assert diagnosis.is_recorded and diagnosis.twin is not None and diagnosis.twin.cost_J < 10.0
    assert diagnosis.composition.shrink > 0.85


def test_no_effect_is_put_inside_a_poor_twin(few_effects: None, monkeypatch: pytest.MonkeyPatch) -> None:
    poor = Twin(make_hydraulic(PLAIN_VALVE, air=0.0), STEP_S, 1.1 * TwinLimits.MAX_COST_J)
    monkeypatch.setattr(prepare, "find_twin", lambda *_: poor)
    diagnosis = run_diagnosis(late, (library_effect("leakage", "past_piston"),), references=False)
    assert diagnosis.composition.effects == ("position_delay",) and diagnosis.twin == poor
    assert not any("leakage" in cause.effects for cause in diagnosis.causes)
    assert (
        f"effects inside the simulated damper were not tried: its twin leaves J {poor.cost_J:.3g} %" in diagnosis.notes
    )


def test_without_references_a_cause_that_no_calibration_absorbs_is_named(few_effects: None) -> None:
    diagnosis = run_diagnosis(late, references=False)
    assert diagnosis.verdict == NAMED and diagnosis.composition.effects == ("position_delay",)
    assert diagnosis.composition.estimates[0][0].value == pytest.approx(0.004, abs=2e-4)
    assert diagnosis.gap.corrected_N == pytest.approx(diagnosis.gap.rms_N) and diagnosis.correction is None
    assert "position_delay" not in diagnosis.not_separable and "gas_spring" in diagnosis.not_separable


@pytest.mark.parametrize(
    ("error_N", "friction_N", "half_width_N", "verdict"),
    [
        (30.0, 0.0, 40.0, NO_GAP),  # within the model's own error of 36 N
        (30.0, 0.0, None, UNKNOWN),  # nothing is known of it: a model file without a band
        (5.0, 30.0, 40.0, AMBIGUOUS),  # within it, but an effect closes nearly all
        (20.0, 100.0, 40.0, NAMED),
    ],
)
def test_an_identified_model_knows_its_own_error(
    error_N: float, friction_N: float, half_width_N: float | None, verdict: str, few_effects: None
) -> None:
    parts = (half_width_N or 0.0, half_width_N or 0.0, *[0.0] * 5)  # the same everywhere
    band = None if half_width_N is None else make_band(parts=parts, constant_share=1.0)
    model = replace(plain_damper(), band=band)
    real: list[Recording] = []
    for plain in (recorded(seed=1), recorded(seed=2), recorded(seed=3)):
        position, force = (plain.channel(name) for name in ("position", "force"))
        x, time_s = position.values, (position.stamps_ns - position.stamps_ns[0]) * 1e-9
        error = np.sqrt(2.0) * error_N * np.sin(20.0 * time_s + 300.0 * x)
        added = error + friction_N * np.tanh(np.gradient(x, time_s) / 0.02)
        noise = np.random.default_rng(len(real)).normal(0.0, NOISE_N, len(x))
        values = np.nan_to_num(sample_force(model, plain)) + added + noise
        real.append(replace(plain, channels={**plain.channels, "force": replace(force, values=values)}))
    diagnosis = diagnose(
        ModelSimulation(model), "model.json", real[:2], real[2:], (), DiagnoseOptions(experiment=False)
    )
    assert diagnosis.verdict == verdict and (verdict != NO_GAP or "own error of 36.5 N" in diagnosis.sentence)
    assert diagnosis.composition.effects == (("friction",) if friction_N else diagnosis.composition.effects)


def count(monkeypatch: pytest.MonkeyPatch, places: list[Any], name: str) -> list[Any]:
    """Return a list that gets the arguments of every call."""
    calls: list[Any] = []
    for place in places:
        plain: Callable[..., Any] = getattr(place, name)
        monkeypatch.setattr(place, name, lambda *given, _plain=plain: (calls.append(given), _plain(*given))[1])
    return calls


@pytest.mark.slow
@pytest.mark.parametrize("references", [True, False])
def test_each_step_is_computed_once(monkeypatch: pytest.MonkeyPatch, few_effects: None, references: bool) -> None:
    """The ceiling is learnt from the gap and from the rest; each explanation has its held-out forces once."""
    ceilings = count(monkeypatch, [evidence, findings], "learn_ceiling")
    forces = count(monkeypatch, [HeldOutScorer], "forces")
    diagnosis = run_diagnosis(sprung, references=references)
    assert diagnosis.figures is not None and len(ceilings) == 2
    if references:
        assert diagnosis.verdict == NAMED and diagnosis.composition.effects == ("gas_spring",)
        compositions = [fit.composition for _, fit, _ in forces]
        assert len(compositions) >= len(FEW) and all(compositions.count(c) == 1 for c in compositions)


@pytest.mark.slow
def test_the_verdict_stands_if_no_experiment_can_be_simulated(few_effects: None) -> None:
    def short_memory(time_s: F, position_m: F, current_A: F) -> F:
        if time_s[-1] - time_s[0] > 9.0:
            raise GapError("at most 9 s can be simulated")
        return damper(time_s, position_m, current_A)

    def truth(time_s: F, position_m: F, current_A: F) -> F:
        return strange(time_s, position_m, current_A) + STIFFNESS * position_m

    simulation = FunctionSimulation("short_memory", short_memory)
    reference = [recorded(wrong, s, 8.0) for s in (11, 12)]
    real, held_out = [recorded(truth, s, 4.0) for s in (1, 2)], [recorded(truth, 3, 4.0)]
    diagnosis = diagnose(simulation, "short_memory", real, held_out, reference)
    assert diagnosis.verdict == UNKNOWN and diagnosis.composition.effects and diagnosis.next_experiment is None
    assert "next experiment not available: the simulation refuses all" in diagnosis.notes[-1]


def test_what_the_simulation_does_to_its_force_is_a_cause_with_a_name(few_effects: None) -> None:
    def late_force(time_s: F, position_m: F, current_A: F) -> F:
        return np.interp(time_s - 0.7 / RATE_HZ, time_s, damper(time_s, position_m, current_A))

    real, held_out = [recorded(seed=s, seconds=5.0) for s in (1, 2)], [recorded(seed=3, seconds=5.0)]
    diagnosis = diagnose(FunctionSimulation("late", late_force), "late", real, held_out, (), QUICK)
    assert diagnosis.verdict == NAMED and {*diagnosis.composition.effects} <= {"simulation_timing", "position_delay"}
    assert "caused by" in diagnosis.sentence and "the simulation's timing" in diagnosis.sentence
    assert diagnosis.composition.probability > 0.9


def test_a_rare_event_is_a_gap_with_a_place(few_effects: None) -> None:
    def struck(time_s: F, position_m: F, current_A: F) -> F:
        return damper(time_s, position_m, current_A) + 100.0 * (np.abs(time_s - 3.3) < 0.01)

    real, held_out = [recorded(seed=s, seconds=8.0) for s in (1, 2)], [recorded(struck, 3, 8.0)]
    diagnosis = diagnose(SIMULATION, "damper.py", real, held_out, (), QUICK)
    assert (
        diagnosis.gap.rms_N < diagnosis.tolerance_N
        and diagnosis.verdict == UNKNOWN
        and diagnosis.probability_none < 0.5
    )
    assert "A short deviation stands out" in diagnosis.sentence and "at 3.3" in diagnosis.sentence
    assert diagnose(SIMULATION, "damper.py", real, [recorded(seed=3)], (), QUICK).verdict == NO_GAP


@pytest.mark.parametrize("calls", [15, 22])
def test_a_simulation_that_fails_in_the_middle_loses_nothing_that_is_finished(few_effects: None, calls: int) -> None:
    def once_licensed(time_s: F, position_m: F, current_A: F) -> F:
        done.append(0)
        if len(done) > calls:
            raise RuntimeError("no licence")
        return damper(time_s, position_m, current_A)

    def truth(time_s: F, position_m: F, current_A: F) -> F:
        return damper(time_s, position_m, current_A) + 40.0 * np.tanh(np.gradient(position_m, time_s) / 0.02)

    done: list[int] = []
    real, held_out = [recorded(truth, s, 5.0) for s in (1, 2)], [recorded(truth, 3, 5.0)]
    diagnosis = diagnose(FunctionSimulation("once", once_licensed), "once", real, held_out)
    assert len(done) > calls and diagnosis.composition.effects == ("friction",) and diagnosis.verdict == NAMED
    notes = [note for note in diagnosis.notes if "no licence" in note]
    assert "the force with position_delay not available: once: raised RuntimeError: no licence" in notes


def test_too_little_data_is_refused_before_the_fit() -> None:
    told: list[str] = []
    with pytest.raises(GapError, match="expected at least"):
        diagnose(
            SIMULATION, "m", [recorded(seconds=2.0)], [recorded(seed=2)], (), None, lambda what, _: told.append(what)
        )
    assert all("simulating" in what for what in told)


def test_an_effect_that_violates_its_contract_is_refused() -> None:
    class Breaking(Ripple):
        """Returns invalid forces."""

        def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
            return np.full(len(force), np.nan)

    with pytest.raises(GapError, match="ripple"):
        diagnose(SIMULATION, "m", [recorded()], [recorded(seed=2)], (), DiagnoseOptions((Breaking(),)))


def test_an_optional_step_that_fails_becomes_a_note_and_what_nobody_foresaw_is_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def refuse() -> int:
        raise GapError("too short; record longer")

    steps = OptionalSteps()
    assert steps.run("map", lambda: 3, 0) == 3 and steps.notes == []
    assert steps.run("map", refuse, 7) == 7
    assert not caplog.records
    assert steps.run("inverse", lambda: {}["a"], 1.0) == 1.0
    assert steps.notes == ["map not available: too short; record longer", "inverse not available: KeyError: 'a'"]
    assert "Traceback" in caplog.text and "inverse" in caplog.text
