"""The whole diagnosis: a simulation and recordings in; verdict, causes and remaining gap out.

Each stage is a function from records to a record:

    prepare_recordings -> learn_baseline -> search -> collect_findings -> score_held_out -> judge
    -> locate_gap -> propose_experiment -> Diagnosis
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from ces_data.recording import Recording
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.baseline.twin import Twin
from ces_gap.calibrate.calibration import WORSE, FreedParameters, free_parameters
from ces_gap.calibrate.fitting import changed_parameters, unexplained_N
from ces_gap.calibrate.parameters import NONE, SimulationParameters, choose_free
from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.effects.effect import Effect
from ces_gap.effects.library import library, require_sound
from ces_gap.effects.simulation_errors import SampleTiming, simulation_errors
from ces_gap.experiment.next_experiment import NextExperiment, find_pairs, propose_experiment
from ces_gap.grid import rms
from ces_gap.inference.evidence import Baseline, learn_baseline
from ces_gap.inference.findings import bound_notes, collect_findings, timing_notes
from ces_gap.inference.held_out import HeldOutScores, apply_judgement, collect_evidence, score_held_out
from ces_gap.inference.judgement import Judgement, SearchFindings, calibration
from ces_gap.inference.refinement import Refinement
from ces_gap.inference.search import EffectSearchResult, search
from ces_gap.inference.verdict import judge
from ces_gap.inputs.checks import check_traces, find_invisible_effects, seen_notes
from ces_gap.inputs.prepare import DiagnosisInput, prepare_recordings
from ces_gap.limits import EvidenceLimits, SearchLimits
from ces_gap.progress import OptionalSteps, Progress, ignore_progress
from ces_gap.regions.locate import NOWHERE, locate_gap
from ces_gap.report.sentences import with_changes, with_parameters
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
class _Request:
    """What is to be diagnosed, and the steps that may fail without ending it."""

    simulation: Simulation
    spec: str
    real: Sequence[Recording]
    held_out: Sequence[Recording]
    reference: Sequence[Recording]
    options: DiagnoseOptions
    progress: Progress
    optional: OptionalSteps = field(default_factory=OptionalSteps)

    @property
    def physics(self) -> tuple[Effect, ...]:
        """Every form of every effect, without the simulation's own errors."""
        return (*library(), *self.options.effects)

    @property
    def needs_twin(self) -> bool:
        """Whether an effect lies inside the damper."""
        return any(effect.edits for effect in self.physics)

    @property
    def may_fit(self) -> bool:
        """Whether parameters of the simulation may change."""
        return list(self.options.fit) != [NONE]

    def prepare(
        self, simulation: Simulation, uncalibrated: tuple[Simulation, Twin | None] | None = None
    ) -> DiagnosisInput:
        """Return the inputs with a simulation, that of the request or with other parameters."""
        recordings = self.real, self.held_out, self.reference
        return prepare_recordings(
            simulation, *recordings, self.progress, self.options.threads, self.needs_twin, uncalibrated
        )


@dataclass(frozen=True)
class _Subject:
    """The inputs with the simulation in which `chosen` parameters have been changed, and that simulation."""

    inputs: DiagnosisInput
    simulation: Simulation
    chosen: FreedParameters


@dataclass(frozen=True)
class _Stages:
    """The result of each stage that every diagnosis needs."""

    invisible: tuple[tuple[str, str], ...]
    baseline: Baseline
    result: EffectSearchResult
    findings: SearchFindings
    scores: HeldOutScores
    judgement: Judgement


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
    request = _Request(simulation, spec, real, held_out, reference, options or DiagnoseOptions(), progress)
    subject = _calibrate(request, _prepare(request))
    notes, seen = _check(request, subject)
    stages = _explain_gap(request, subject)
    diagnosis = with_parameters(_complete(request, subject, stages), subject.chosen)
    diagnosis = _separate_parameters(request, subject, diagnosis)
    diagnosis = with_changes(diagnosis) if reference else diagnosis
    notes = (*notes, *seen, *request.optional.notes, *subject.chosen.notes, *diagnosis.notes)
    return replace(diagnosis, notes=notes, seen_notes=seen)


def _prepare(request: _Request) -> DiagnosisInput:
    """Return the inputs with the simulation as it is; raises GapError for an effect or a parameter that cannot be."""
    inputs = request.prepare(request.simulation)
    for effect in request.options.effects:
        require_sound(effect, inputs.real[0])
    if request.options.fit:
        choose_free(request.simulation, request.options.fit, request.spec)
    return inputs


def _calibrate(request: _Request, inputs: DiagnosisInput) -> _Subject:
    """Return the inputs with those parameters changed that explain the gap; not with references, which show its error.

    The original inputs stay if the changed ones do not explain held-out recordings better. Parameters beside an effect
    may be worse alone.
    """
    original, chosen = request.simulation, FreedParameters(request.simulation)
    if not original.parameters or request.reference or not request.may_fit:
        return _Subject(inputs, original, chosen)
    twin = None if inputs.twin_problem else inputs.twin
    asked = request.spec, request.real, bool(request.held_out), request.physics, twin, request.options.fit
    chosen = request.optional.run(FREED, lambda: free_parameters(original, *asked, request.progress), chosen)
    if not chosen.freed:
        return _Subject(inputs, original, chosen)
    changed = request.prepare(chosen.simulation, (original, inputs.twin))
    traces = changed.held_out
    before_N = gap_N(traces, [t.simulated_as_logged for t in traces], 0.0)
    if chosen.effect or gap_N(traces, [t.simulated for t in traces], 0.0) < before_N:
        return _Subject(changed, chosen.simulation, chosen)
    return _Subject(inputs, original, FreedParameters(original, notes=(*chosen.notes, WORSE)))


def _check(request: _Request, subject: _Subject) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return notes on the inputs, and those on recordings from which the simulation was identified."""
    inputs, simulation = subject.inputs, subject.simulation
    notes = check_traces([*inputs.real, *inputs.held_out, *inputs.reference], simulation, request.spec)
    if request.needs_twin and inputs.twin_problem:
        notes = (*notes, f"effects inside the simulated damper were not tried: {inputs.twin_problem}")
    return notes, seen_notes([*inputs.real, *inputs.held_out], simulation, request.spec)


def _explain_gap(request: _Request, subject: _Subject) -> _Stages:
    """Return what each stage from the baseline error to the verdict has found."""
    inputs, options, progress = subject.inputs, request.options, request.progress
    effects = _list_effects(request, subject)
    invisible = find_invisible_effects(effects, inputs.real)
    progress("learning the baseline error", 0.0)
    baseline = learn_baseline(inputs)
    visible = [e for e in effects if e.name not in dict(invisible) and not (e.edits and inputs.twin_problem)]
    visible += _find_changed_parameters(request, inputs, baseline)
    share = SearchLimits.MIN_GAIN if inputs.reference else SearchLimits.MIN_GAIN_UNCORRECTED
    result = search(baseline.evidence, visible, Refinement(inputs.slow), options.threads, progress, share)
    progress("computing the ceiling", 0.0)
    weights, is_recorded = calibration(_mode(subject.simulation, inputs)), inputs.exact is None
    tolerance = _tolerance(inputs, subject.chosen, options)
    findings = collect_findings(baseline, result, inputs.best, weights, tolerance, is_recorded)
    scores = score_held_out(inputs, baseline, result, findings, options.seed, progress)
    judgement = judge(collect_evidence(findings, scores))
    return _Stages(invisible, baseline, result, findings, apply_judgement(scores, judgement), judgement)


def _list_effects(request: _Request, subject: _Subject) -> tuple[Effect, ...]:
    """Return the effects that compete: without references also the simulation's own errors."""
    if request.reference:
        return request.physics
    is_calibrated = subject.chosen.competed  # by its parameters, which are the better calibration
    return (*request.physics, *((SampleTiming(),) if is_calibrated else simulation_errors()))


def _find_changed_parameters(
    request: _Request, inputs: DiagnosisInput, baseline: Baseline
) -> list[SimulationParameters]:
    """Return the parameters that the user names as an effect beside the correction from references, in its forms."""
    exact, words = inputs.exact, request.options.fit
    if not (request.reference and words and request.may_fit and isinstance(exact, DirectSimulator)):
        return []
    asked = exact.simulation, request.spec, baseline.evidence, words
    nothing: list[SimulationParameters] = []
    return request.optional.run(FREED, lambda: changed_parameters(*asked), nothing)


def _separate_parameters(request: _Request, subject: _Subject, diagnosis: Diagnosis) -> Diagnosis:
    """Return the diagnosis with the experiment that tells parameters from each other or from an effect, if any does."""
    pairs = subject.chosen.pairs
    if not (request.options.experiment and diagnosis.verdict == AMBIGUOUS and pairs):
        return diagnosis
    request.progress("choosing the next experiment", 0.0)
    real = subject.inputs.real
    plant = Plant(DirectSimulator(request.simulation), twin=subject.inputs.twin)
    proposed = request.optional.run(
        "next experiment", lambda: propose_experiment(plant, real, pairs, unexplained_N(real)), None
    )
    return replace(diagnosis, next_experiment=proposed or diagnosis.next_experiment)


def _tolerance(inputs: DiagnosisInput, chosen: FreedParameters, options: DiagnoseOptions) -> float | None:
    """Return the share of the force up to which a gap is none: where parameters competed alone, twice their rest."""
    if options.tolerance is not None or not chosen.competed or (chosen.effect and not own_error_N(inputs.real)):
        return options.tolerance
    force_N = rms(usable_values(inputs.real, [t.force for t in inputs.real]))
    return EvidenceLimits.VISIBLE * unexplained_N(inputs.real) / force_N


def _mode(simulation: Simulation, inputs: DiagnosisInput) -> str:
    """Return the kind of diagnosis for which probabilities are calibrated: key of `calibration.json`."""
    if not inputs.reference:
        return "no_references" if inputs.exact is not None else "predictions"
    return "identified" if isinstance(simulation.innermost, ModelSimulation) else "references"


def _complete(request: _Request, subject: _Subject, stages: _Stages) -> Diagnosis:
    """Return the diagnosis with the location of the gap and the next experiment; a note for each that fails."""
    inputs, result, optional = subject.inputs, stages.result, OptionalSteps()
    findings, scores, judgement = stages.findings, stages.scores, stages.judgement
    request.progress("locating the gap", 0.0)
    where = scores.series, request.options.seed, judgement.verdict == UNKNOWN, bool(subject.chosen.freed)
    location = optional.run("location of the gap", lambda: locate_gap(result.evidence, *where), NOWHERE)
    experiment = optional.run("next experiment", lambda: _propose_experiment(request, inputs, stages), None)
    return Diagnosis(
        verdict=judgement.verdict,
        no_gap_reason=judgement.reason,
        doubt=judgement.doubt,
        alternatives=judgement.alternatives,
        timed_N=scores.timed_N,
        visible_from_N=findings.visible_from_N,
        tolerance_N=findings.tolerance_N,
        sentence="",
        simulation=request.spec,
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
        correction=stages.baseline.correction,
        figures=findings.figures,
        probe=inputs.probe,
        rare=scores.rare if judgement.verdict in (NO_GAP, UNKNOWN) else scores.rare_left,
    )


def _propose_experiment(request: _Request, inputs: DiagnosisInput, stages: _Stages) -> NextExperiment | None:
    """Return the experiment that separates the effects that the verdict leaves open; None if it leaves none."""
    result, judgement = stages.result, stages.judgement
    if not request.options.experiment or result.best is None or judgement.verdict in (NO_GAP, NAMED):
        return None
    request.progress("choosing the next experiment", 0.0)
    traces, noise_N = result.evidence.traces, result.evidence.noise.rms_N
    pairs = find_pairs(result, stages.scores.composition.effects, judgement)
    return propose_experiment(stages.baseline.plant, traces, pairs, noise_N, inputs.exact)
