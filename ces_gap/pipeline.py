"""The whole diagnosis: a simulation and recordings in; verdict, causes and remaining gap out.

Each stage is a function from records to a record:

    prepare_recordings -> learn_baseline -> search -> collect_findings -> score_held_out -> judge
    -> locate_gap -> propose_experiment -> Diagnosis
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ces_data.recording import Recording
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.baseline.twin import Twin
from ces_gap.calibrate.calibration import WORSE, FreedParameters, free_parameters
from ces_gap.calibrate.changed import changed_parameters
from ces_gap.calibrate.fitting import unexplained_N
from ces_gap.calibrate.free import NONE, choose_free
from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.effects.effect import Effect
from ces_gap.effects.library import library, require_sound
from ces_gap.effects.simulation_errors import SampleTiming, simulation_errors
from ces_gap.experiment.next_experiment import find_pairs, propose_experiment
from ces_gap.grid import rms
from ces_gap.inference.evidence import Baseline, learn_baseline
from ces_gap.inference.findings import bound_notes, collect_findings, timing_notes
from ces_gap.inference.held_out import HeldOutScores, apply_judgement, collect_evidence, score_held_out
from ces_gap.inference.judgement import Judgement, SearchFindings
from ces_gap.inference.odds import calibration
from ces_gap.inference.refinement import Refinement
from ces_gap.inference.search import EffectSearchResult, search
from ces_gap.inference.verdict import judge
from ces_gap.inputs.checks import check_traces, find_invisible_effects, seen_notes
from ces_gap.inputs.prepare import DiagnosisInput, prepare_recordings
from ces_gap.limits import EvidenceLimits, SearchLimits
from ces_gap.progress import OptionalSteps, Progress, ignore_progress
from ces_gap.regions.locate import NOWHERE, locate_gap
from ces_gap.report.parameters import with_changes, with_parameters
from ces_gap.trace import gap_N, own_error_N, usable_values
from ces_identify.simulations.simulation import ModelSimulation, Simulation

FREED = "parameters of the simulation"


@dataclass(frozen=True)
class DiagnoseOptions:
    """Options of a diagnosis."""

    effects: tuple[Effect, ...] = ()  # of the user, in addition to the library
    threads: int = 1  # of the fit
    seed: int = 1  # of the bootstrap
    tolerance: float | None = None  # share of the RMS force: a smaller gap is none (default `findings.tolerance_N`)
    experiment: bool = True  # whether to choose the next experiment
    fit: tuple[str, ...] = ()  # parameters of the simulation that compete, NAME or NAME=LOW..HIGH; all if empty


@dataclass(frozen=True)
class _Stages:
    """The result of each stage that every diagnosis needs."""

    inputs: DiagnosisInput
    invisible: tuple[tuple[str, str], ...]
    baseline: Baseline
    result: EffectSearchResult
    findings: SearchFindings
    scores: HeldOutScores
    judgement: Judgement
    freed: bool  # whether parameters changed the simulation


def diagnose(
    simulation: Simulation,
    spec: str,
    real: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    reference: Sequence[Recording] = (),
    options: DiagnoseOptions | None = None,
    progress: Progress = ignore_progress,
) -> Diagnosis:
    """Return the causes of the gap between `simulation`, named `spec`, and the `real` recordings.

    The result is validated on `held_out`, or on a part of `real`; `reference` recordings teach the baseline error.
    `progress` receives each step and the share of it that is done. Raises CesError if a diagnosis is not possible.
    """
    options, optional, original = options or DiagnoseOptions(), OptionalSteps(), simulation
    physics = (*library(), *options.effects)
    needs_twin = any(effect.edits for effect in physics)

    def prepare(one: Simulation, uncalibrated: tuple[Simulation, Twin | None] | None = None) -> DiagnosisInput:
        recordings = real, held_out, reference
        return prepare_recordings(one, *recordings, progress, options.threads, needs_twin, uncalibrated)

    inputs = prepare(simulation)
    for effect in options.effects:
        require_sound(effect, inputs.real[0])
    if options.fit:
        choose_free(simulation, options.fit, spec)  # a wrong word of the user ends here
    chosen = FreedParameters(simulation)
    if simulation.parameters and not reference and list(options.fit) != [NONE]:
        twin = None if inputs.twin_problem else inputs.twin
        asked = spec, real, bool(held_out), physics, twin, options.fit, progress
        chosen = optional.run(FREED, lambda: free_parameters(original, *asked), chosen)
    if chosen.freed:
        inputs, chosen = _keep_what_helps(inputs, prepare(chosen.simulation, (original, inputs.twin)), original, chosen)
        simulation = chosen.simulation
    errors = (SampleTiming(),) if chosen.competed else simulation_errors()  # parameters are the better calibration
    effects = (*physics, *(() if reference else errors))
    notes = check_traces([*inputs.real, *inputs.held_out, *inputs.reference], simulation, spec)
    if needs_twin and inputs.twin_problem:
        notes = (*notes, f"effects inside the simulated damper were not tried: {inputs.twin_problem}")
    seen = seen_notes([*inputs.real, *inputs.held_out], simulation, spec)
    invisible = find_invisible_effects(effects, inputs.real)
    progress("learning the baseline error", 0.0)
    baseline = learn_baseline(inputs)
    visible = [e for e in effects if e.name not in dict(invisible) and not (e.edits and inputs.twin_problem)]
    if reference and options.fit and list(options.fit) != [NONE] and isinstance(inputs.exact, DirectSimulator):
        ask = inputs.exact.simulation, spec, baseline.evidence, options.fit
        visible += optional.run(FREED, lambda: changed_parameters(*ask), [])
    share = SearchLimits.MIN_GAIN if inputs.reference else SearchLimits.MIN_GAIN_UNCORRECTED
    result = search(baseline.evidence, visible, Refinement(inputs.slow), options.threads, progress, share)
    progress("computing the ceiling", 0.0)
    weights = calibration(_mode(simulation, inputs))
    recorded, tolerance = inputs.exact is None, _tolerance(inputs, chosen, options)
    findings = collect_findings(baseline, result, inputs.best, weights, tolerance, recorded)
    scores = score_held_out(inputs, baseline, result, findings, options.seed, progress)
    judgement = judge(collect_evidence(findings, scores))
    scores = apply_judgement(scores, judgement)
    stages = _Stages(inputs, invisible, baseline, result, findings, scores, judgement, bool(chosen.freed))
    diagnosis = replace(_complete(stages, spec, options, progress), seen_notes=seen)
    diagnosis = with_parameters(diagnosis, chosen)
    if options.experiment and diagnosis.verdict == AMBIGUOUS and chosen.pairs:
        progress("choosing the next experiment", 0.0)
        plant, known = Plant(DirectSimulator(original), twin=inputs.twin), diagnosis.next_experiment
        among = inputs.real, chosen.pairs, unexplained_N(inputs.real)
        proposed = optional.run("next experiment", lambda: propose_experiment(plant, *among), None) or known
        diagnosis = replace(diagnosis, next_experiment=proposed)
    notes = (*notes, *seen, *optional.notes, *chosen.notes, *diagnosis.notes)
    return replace(with_changes(diagnosis) if reference else diagnosis, notes=notes)


def _keep_what_helps(
    inputs: DiagnosisInput, changed: DiagnosisInput, original: Simulation, chosen: FreedParameters
) -> tuple[DiagnosisInput, FreedParameters]:
    """Return the inputs with `changed` parameters if they explain held-out recordings better, else the `original` ones.

    Parameters beside an effect may be worse alone.
    """
    traces = changed.held_out
    before_N = gap_N(traces, [t.simulated_as_logged for t in traces], 0.0)
    if chosen.effect or gap_N(traces, [t.simulated for t in traces], 0.0) < before_N:
        return changed, chosen
    return inputs, FreedParameters(original, notes=(*chosen.notes, WORSE))


def _tolerance(inputs: DiagnosisInput, chosen: FreedParameters, options: DiagnoseOptions) -> float | None:
    """Return the share of the force up to which a gap is none: where parameters competed alone, twice their rest."""
    if options.tolerance is not None or not chosen.competed or (chosen.effect and not own_error_N(inputs.real)):
        return options.tolerance
    return (
        EvidenceLimits.VISIBLE
        * unexplained_N(inputs.real)
        / rms(usable_values(inputs.real, [t.force for t in inputs.real]))
    )


def _mode(simulation: Simulation, inputs: DiagnosisInput) -> str:
    """Return the kind of diagnosis for which probabilities are calibrated: key of `calibration.json`."""
    if not inputs.reference:
        return "no_references" if inputs.exact is not None else "predictions"
    return "identified" if isinstance(simulation.innermost, ModelSimulation) else "references"


def _complete(stages: _Stages, spec: str, options: DiagnoseOptions, progress: Progress) -> Diagnosis:
    """Return the diagnosis with the location of the gap and the next experiment; a note for each that fails."""
    inputs, baseline, result, optional = stages.inputs, stages.baseline, stages.result, OptionalSteps()
    findings, scores, judgement = stages.findings, stages.scores, stages.judgement
    progress("locating the gap", 0.0)
    location = optional.run(
        "location of the gap",
        lambda: locate_gap(
            result.evidence, scores.series, options.seed, judgement.verdict == UNKNOWN, of_original=stages.freed
        ),
        NOWHERE,
    )
    experiment = None
    if options.experiment and result.best is not None and judgement.verdict not in (NO_GAP, NAMED):
        progress("choosing the next experiment", 0.0)
        known, noise_N = result.evidence.traces, result.evidence.noise.rms_N
        experiment = optional.run(
            "next experiment",
            lambda: propose_experiment(
                baseline.plant, known, find_pairs(result, scores.composition.effects, judgement), noise_N, inputs.exact
            ),
            None,
        )
    return Diagnosis(
        verdict=judgement.verdict,
        no_gap_reason=judgement.reason,
        doubt=judgement.doubt,
        alternatives=judgement.alternatives,
        timed_N=scores.timed_N,
        visible_from_N=findings.visible_from_N,
        tolerance_N=findings.tolerance_N,
        sentence="",
        simulation=spec,
        gap=scores.gap,
        where=location.where,
        by_region=location.by_region,
        rest=location.rest,
        causes=scores.causes,
        composition=scores.composition,
        ceiling_after_N=scores.ceiling_after_N,
        indistinguishable=judgement.ties,
        not_separable=findings.absorbed,
        invisible=stages.invisible,
        probability_none=judgement.probabilities.none,
        probability_unknown=judgement.probabilities.unknown,
        next_experiment=experiment,
        is_recorded=inputs.exact is None,
        twin=inputs.twin,
        held_out=scores.series,
        notes=(
            *scores.notes,
            *optional.notes,
            *timing_notes(result, judgement),
            *bound_notes(scores.composition.composition, scores.composition.estimates),
        ),
        correction=baseline.correction,
        figures=findings.figures,
        probe=inputs.probe,
        rare=scores.rare if judgement.verdict in (NO_GAP, UNKNOWN) else scores.rare_left,
    )
