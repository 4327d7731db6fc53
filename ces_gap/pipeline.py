"""The whole diagnosis: a simulation and recordings go in, verdict, causes and what they leave come out.

A pipeline of stages, each a function from records to a record, in the room where it belongs:

    prepare_recordings -> learn_baseline -> search -> decide -> find_doubts -> score_held_out -> locate_gap -> Diagnosis
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ces_gap.diagnosis import NAMED, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.effects.effect import Effect
from ces_gap.effects.library import library
from ces_gap.effects.user_effects import require_sound
from ces_gap.experiment.doubts import find_doubts, propose_experiment
from ces_gap.inference.anchored_surrogate import Refinement
from ces_gap.inference.decide import decide, name_by_simpler_rules
from ces_gap.inference.held_out import score_held_out
from ces_gap.inference.learn_baseline import learn_baseline
from ces_gap.inference.search import search
from ces_gap.inference.static_map import find_absorbed_effects
from ces_gap.inference.verdict import calibration
from ces_gap.intake.checks import check_traces, find_invisible_effects
from ces_gap.intake.prepare import prepare_recordings
from ces_gap.progress import Progress, ignore_progress
from ces_gap.sentence import format_verdict
from ces_gap.where.gap_location import locate_gap
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation


@dataclass(frozen=True)
class DiagnoseOptions:
    """`effects` of the user's own beside the library's; `threads` to fit with; `seed` of resampling.

    `experiment` False leaves out the search for the next experiment.
    """

    effects: tuple[Effect, ...] = ()
    threads: int = 1
    seed: int = 1
    experiment: bool = True


def diagnose(
    simulation: Simulation,
    spec: str,
    real: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    reference: Sequence[Recording] = (),
    options: DiagnoseOptions | None = None,
    progress: Progress = ignore_progress,
) -> Diagnosis:
    """Return what causes the gap between `simulation` (`spec` is how it was named) and the `real` recordings.

    Judged on `held_out` (a part of `real` if none), the simulation's own error learnt from `reference`. `progress` is
    told what is being done and the share of that step. Raises CesError for what cannot be diagnosed.
    """
    how = options or DiagnoseOptions()
    inputs = prepare_recordings(simulation, real, held_out, reference, progress)
    for effect in how.effects:
        require_sound(effect, inputs.real[0])
    notes = check_traces([*inputs.real, *inputs.held_out, *inputs.reference], simulation, spec)
    effects = (*library(), *how.effects)
    unseen = find_invisible_effects(effects, inputs.real)

    progress("learning the simulation's own error", 0.0)
    baseline = learn_baseline(inputs)
    visible = [e for e in effects if e.name not in dict(unseen)]
    found = search(baseline.evidence, visible, Refinement(inputs.slow), how.threads, progress)

    progress("asking the generic learner", 0.0)
    decision = decide(baseline, found, inputs.best, calibration())
    progress("comparing twins", 0.0)
    doubts = find_doubts(baseline.plant, found, decision.interchangeable)

    scores = score_held_out(inputs, baseline, found, decision, how.seed, progress)
    progress("locating the gap", 0.0)
    location = locate_gap(found.evidence, scores.series, how.seed, with_rest=decision.verdict == UNKNOWN)
    experiment = None
    if how.experiment and found.best is not None and decision.verdict not in (NO_GAP, NAMED):
        progress("choosing the next experiment", 0.0)
        experiment = propose_experiment(baseline.plant, found, doubts, inputs.exact)

    played_back = inputs.surrogate if inputs.exact is None else None
    diagnosis = Diagnosis(
        verdict=decision.verdict,
        sentence="",
        simulation=spec,
        gap=scores.gap,
        where=location.where,
        by_region=location.by_region,
        rest=location.rest,
        causes=scores.causes,
        composition=scores.composition,
        wrong=next((c for c in scores.causes if c.effects[0] not in scores.composition.effects), None),
        ceiling_after_N=scores.ceiling_after_N,
        indistinguishable=doubts.indistinguishable,
        not_separable=() if inputs.reference else find_absorbed_effects(found.evidence, found.alone),
        invisible=unseen,
        probability_none=decision.probabilities.none,
        probability_unknown=decision.probabilities.unknown,
        next_experiment=experiment,
        surrogate=played_back,
        surrogate_cost_J=None if played_back is None else played_back.cost_J,
        held_out=scores.series,
        notes=notes,
        correction=baseline.correction,
        baselines=name_by_simpler_rules(found),
        figures=decision.figures,
    )
    return replace(diagnosis, sentence=format_verdict(diagnosis))
