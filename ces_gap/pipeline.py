"""The whole diagnosis: a simulation and recordings in; verdict, causes and remaining gap out.

Each stage is a function from records to a record:

    prepare_recordings -> learn_baseline -> search -> decide -> score_held_out -> review -> refit_physical_model
    -> find_ambiguities -> locate_gap -> propose_experiment -> Diagnosis
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ces_data.recording import Recording
from ces_gap.diagnosis import NAMED, NO_GAP, UNKNOWN, Diagnosis, format_verdict
from ces_gap.effects.effect import Effect
from ces_gap.effects.library import library, require_sound
from ces_gap.effects.simulation_errors import simulation_errors
from ces_gap.experiment.next_experiment import NO_AMBIGUITIES, find_ambiguities, propose_experiment
from ces_gap.inference.evidence import Baseline, learn_baseline
from ces_gap.inference.fit import Refinement
from ces_gap.inference.held_out import HeldOutScores, review, score_held_out
from ces_gap.inference.search import MIN_GAIN_SHARE, MIN_GAIN_SHARE_UNCORRECTED, EffectSearchResult, search
from ces_gap.inference.verdict import Decision, calibration, decide, name_by_simpler_rules, timing_notes
from ces_gap.inputs.checks import check_traces, find_invisible_effects, seen_notes
from ces_gap.inputs.prepare import DiagnosisInput, prepare_recordings
from ces_gap.progress import OptionalSteps, Progress, ignore_progress
from ces_gap.refit import ModelRefits, refit_physical_model, weigh_refits
from ces_gap.regions.locate import NOWHERE, locate_gap
from ces_identify.simulations.simulation import ModelSimulation, Simulation


@dataclass(frozen=True)
class DiagnoseOptions:
    """Options of a diagnosis."""

    effects: tuple[Effect, ...] = ()  # of the user, in addition to the library
    threads: int = 1  # of the fit
    seed: int = 1  # of the bootstrap
    tolerance: float | None = None  # share of the RMS force: a smaller gap is none (default `verdict.tolerance_N`)
    experiment: bool = True  # whether to choose the next experiment


@dataclass(frozen=True)
class _Stages:
    """The result of each stage that every diagnosis needs; `verdict` is the one after review and refits."""

    inputs: DiagnosisInput
    invisible: tuple[tuple[str, str], ...]
    baseline: Baseline
    result: EffectSearchResult
    decision: Decision
    scores: HeldOutScores
    verdict: str
    refits: ModelRefits | None
    refit_finding: str


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
    options = options or DiagnoseOptions()
    inputs = prepare_recordings(simulation, real, held_out, reference, progress)
    for effect in options.effects:
        require_sound(effect, inputs.real[0])
    notes = check_traces([*inputs.real, *inputs.held_out, *inputs.reference], simulation, spec)
    seen = seen_notes([*inputs.real, *inputs.held_out], simulation, spec)
    effects = (*library(), *options.effects, *(() if inputs.reference else simulation_errors()))
    invisible = find_invisible_effects(effects, inputs.real)
    progress("learning the baseline error", 0.0)
    baseline = learn_baseline(inputs)
    visible = [e for e in effects if e.name not in dict(invisible)]
    share = MIN_GAIN_SHARE if inputs.reference else MIN_GAIN_SHARE_UNCORRECTED
    result = search(baseline.evidence, visible, Refinement(inputs.slow), options.threads, progress, share)
    progress("computing the ceiling", 0.0)
    weights = calibration(_mode(simulation, inputs))
    decision = decide(baseline, result, inputs.best, weights, options.tolerance)
    scores = score_held_out(inputs, baseline, result, decision, options.seed, progress)
    verdict, scores = review(decision.verdict, scores)
    refits = refit_physical_model(simulation, inputs, baseline, progress)
    verdict, finding = weigh_refits(verdict, scores.composition.effects, refits)
    stages = _Stages(inputs, invisible, baseline, result, decision, scores, verdict, refits, finding)
    diagnosis = replace(_complete(stages, spec, options, progress), seen_notes=seen)
    diagnosis = replace(diagnosis, notes=(*notes, *seen, *diagnosis.notes))
    return replace(diagnosis, sentence=format_verdict(diagnosis))


def _mode(simulation: Simulation, inputs: DiagnosisInput) -> str:
    """Return the kind of diagnosis for which probabilities are calibrated: key of `calibration.json`."""
    if not inputs.reference:
        return "no_references" if inputs.exact is not None else "predictions"
    return "identified" if isinstance(simulation.innermost, ModelSimulation) else "references"


def _complete(stages: _Stages, spec: str, options: DiagnoseOptions, progress: Progress) -> Diagnosis:
    """Return the diagnosis with ambiguities, location of the gap and next experiment; a note for each that fails."""
    inputs, baseline, result, optional = stages.inputs, stages.baseline, stages.result, OptionalSteps()
    decision, scores, alike = stages.decision, stages.scores, stages.decision.interchangeable
    surrogate = inputs.surrogate if inputs.exact is None else None
    outside = [c for c in scores.causes if c.effects[0] not in scores.composition.effects]
    progress("comparing indistinguishable effects", 0.0)
    ambiguities = optional.run(
        "indistinguishable effects",
        lambda: find_ambiguities(baseline.plant, result, alike),
        replace(NO_AMBIGUITIES, indistinguishable=alike),
    )
    progress("locating the gap", 0.0)
    location = optional.run(
        "location of the gap",
        lambda: locate_gap(result.evidence, scores.series, options.seed, with_rest=stages.verdict == UNKNOWN),
        NOWHERE,
    )
    experiment = None
    if options.experiment and result.best is not None and stages.verdict not in (NO_GAP, NAMED):
        progress("choosing the next experiment", 0.0)
        known, noise_N = result.evidence.traces, result.evidence.noise.rms_N
        experiment = optional.run(
            "next experiment",
            lambda: propose_experiment(baseline.plant, known, ambiguities.pairs, noise_N, inputs.exact),
            None,
        )
    return Diagnosis(
        verdict=stages.verdict,
        no_gap_reason=decision.no_gap_reason,
        visible_from_N=decision.visible_from_N,
        tolerance_N=decision.tolerance_N,
        sentence="",
        simulation=spec,
        gap=scores.gap,
        where=location.where,
        by_region=location.by_region,
        rest=location.rest,
        causes=scores.causes,
        composition=scores.composition,
        wrong=max(outside, key=lambda c: c.shrink if math.isfinite(c.shrink) else -math.inf, default=None),
        ceiling_after_N=scores.ceiling_after_N,
        indistinguishable=ambiguities.indistinguishable,
        not_separable=decision.absorbed,
        invisible=stages.invisible,
        probability_none=decision.probabilities.none,
        probability_unknown=decision.probabilities.unknown,
        next_experiment=experiment,
        surrogate=surrogate,
        surrogate_cost_J=None if surrogate is None else surrogate.cost_J,
        surrogate_error=None if surrogate is None else surrogate.difference_error,
        held_out=scores.series,
        notes=(*optional.notes, *timing_notes(result, decision)),
        correction=baseline.correction,
        baselines=name_by_simpler_rules(result),
        figures=decision.figures,
        refits=stages.refits,
        refit_finding=stages.refit_finding,
    )
