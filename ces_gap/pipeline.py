"""The whole diagnosis: a simulation and recordings in; verdict, causes and remaining gap out.

Each stage is a function from records to a record:

    prepare_recordings -> learn_baseline -> search -> decide -> score_held_out -> review -> ask_witness
    -> find_doubts -> locate_gap -> propose_experiment -> Diagnosis
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ces_gap.diagnosis import NAMED, NO_GAP, UNKNOWN, Diagnosis, Explanation
from ces_gap.effects.effect import Effect
from ces_gap.effects.library import library
from ces_gap.effects.simulation_errors import simulation_errors
from ces_gap.effects.user_effects import require_sound
from ces_gap.experiment.doubts import NO_DOUBTS, find_doubts, propose_experiment
from ces_gap.inference.anchored_surrogate import Refinement
from ces_gap.inference.comparison import MIN_GAIN_SHARE, MIN_GAIN_SHARE_UNCORRECTED
from ces_gap.inference.decide import Decision, decide, name_by_simpler_rules, timing_notes
from ces_gap.inference.held_out import HeldOutScores, score_held_out
from ces_gap.inference.learn_baseline import Baseline, learn_baseline
from ces_gap.inference.review import review
from ces_gap.inference.search import EffectSearchResult, search
from ces_gap.inference.verdict import calibration
from ces_gap.intake.checks import check_traces, find_invisible_effects, seen_notes
from ces_gap.intake.prepare import DiagnosisInput, prepare_recordings
from ces_gap.optional_steps import OptionalSteps
from ces_gap.progress import Progress, ignore_progress
from ces_gap.verdict_sentence import format_verdict
from ces_gap.where.gap_location import NOWHERE, locate_gap
from ces_gap.witness.weigh import weigh_witness
from ces_gap.witness.witness import Witness, ask_witness
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import ModelSimulation, Simulation


@dataclass(frozen=True)
class DiagnoseOptions:
    """Options of a diagnosis."""

    effects: tuple[Effect, ...] = ()  # of the user, in addition to the library
    threads: int = 1  # of the fit
    seed: int = 1  # of the bootstrap
    tolerance: float | None = None  # share of the RMS force: a smaller gap is none (default `gap_size.tolerance_N`)
    experiment: bool = True  # whether to choose the next experiment


@dataclass(frozen=True)
class _Findings:
    """What the search and the decision found, before any held-out recording is looked at."""

    inputs: DiagnosisInput
    baseline: Baseline
    result: EffectSearchResult
    decision: Decision
    invisible: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class _Judgement:
    """The verdict after review and witness, with the held-out scores."""

    verdict: str
    scores: HeldOutScores
    witness: Witness | None
    witness_says: str


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
    notes += seen_notes([*inputs.real, *inputs.held_out], simulation, spec)
    found = _find_causes(simulation, inputs, options, progress)
    judged = _judge(simulation, found, options, progress)
    diagnosis = _describe(spec, notes, found, judged, options, progress)
    return replace(diagnosis, sentence=format_verdict(diagnosis))


def _find_causes(
    simulation: Simulation, inputs: DiagnosisInput, options: DiagnoseOptions, progress: Progress
) -> _Findings:
    effects = (*library(), *options.effects, *(() if inputs.reference else simulation_errors()))
    invisible = find_invisible_effects(effects, inputs.real)
    progress("learning the baseline error", 0.0)
    baseline = learn_baseline(inputs)
    visible = [e for e in effects if e.name not in dict(invisible)]
    share = MIN_GAIN_SHARE if inputs.reference else MIN_GAIN_SHARE_UNCORRECTED
    result = search(baseline.evidence, visible, Refinement(inputs.slow), options.threads, progress, share)
    progress("computing the ceiling", 0.0)
    weights = calibration(_calibrated_for(simulation, inputs))
    return _Findings(
        inputs, baseline, result, decide(baseline, result, inputs.best, weights, options.tolerance), invisible
    )


def _judge(simulation: Simulation, found: _Findings, options: DiagnoseOptions, progress: Progress) -> _Judgement:
    inputs, baseline, result, decision = found.inputs, found.baseline, found.result, found.decision
    verdict, scores = review(
        decision.verdict, score_held_out(inputs, baseline, result, decision, options.seed, progress)
    )
    witness = ask_witness(simulation, inputs, baseline, progress)
    verdict, says = weigh_witness(verdict, scores.composition.effects, witness)
    return _Judgement(verdict, scores, witness, says)


def _describe(
    spec: str,
    notes: Sequence[str],
    found: _Findings,
    judged: _Judgement,
    options: DiagnoseOptions,
    progress: Progress,
) -> Diagnosis:
    """Return the diagnosis, with what is optional: doubts, location of the gap and the next experiment."""
    inputs, baseline, result, decision = found.inputs, found.baseline, found.result, found.decision
    verdict, scores, optional = judged.verdict, judged.scores, OptionalSteps()
    progress("comparing indistinguishable effects", 0.0)
    doubts = optional.run(
        "indistinguishable effects",
        lambda: find_doubts(baseline.plant, result, decision.interchangeable),
        replace(NO_DOUBTS, indistinguishable=decision.interchangeable),
    )
    progress("locating the gap", 0.0)
    location = optional.run(
        "location of the gap",
        lambda: locate_gap(result.evidence, scores.series, options.seed, with_rest=verdict == UNKNOWN),
        NOWHERE,
    )
    experiment = None
    if options.experiment and result.best is not None and verdict not in (NO_GAP, NAMED):
        progress("choosing the next experiment", 0.0)
        experiment = optional.run(
            "next experiment", lambda: propose_experiment(baseline.plant, result, doubts, inputs.exact), None
        )
    surrogate = inputs.surrogate if inputs.exact is None else None
    return Diagnosis(
        verdict=verdict,
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
        wrong=_best_outside(scores.causes, scores.composition),
        ceiling_after_N=scores.ceiling_after_N,
        indistinguishable=doubts.indistinguishable,
        not_separable=decision.absorbed,
        invisible=found.invisible,
        probability_none=decision.probabilities.none,
        probability_unknown=decision.probabilities.unknown,
        next_experiment=experiment,
        surrogate=surrogate,
        surrogate_cost_J=None if surrogate is None else surrogate.cost_J,
        surrogate_error=None if surrogate is None else surrogate.difference_error,
        held_out=scores.series,
        notes=(*notes, *optional.notes, *timing_notes(result, decision)),
        correction=baseline.correction,
        baselines=name_by_simpler_rules(result),
        figures=decision.figures,
        witness=judged.witness,
        witness_says=judged.witness_says,
    )


def _best_outside(causes: Sequence[Explanation], composition: Explanation) -> Explanation | None:
    """Return the effect outside the composition that alone leaves the least of the gap."""
    others = [c for c in causes if c.effects[0] not in composition.effects]
    return max(others, key=lambda c: c.shrink if math.isfinite(c.shrink) else -math.inf, default=None)


def _calibrated_for(simulation: Simulation, inputs: DiagnosisInput) -> str:
    """Return the kind of diagnosis for which probabilities are calibrated: key of `calibration.json`."""
    if not inputs.reference:
        return "no_references" if inputs.exact is not None else "predictions"
    return "identified" if isinstance(simulation.innermost, ModelSimulation) else "references"
