"""The gap on held-out recordings, what each explanation leaves of it, and the evidence of both for the verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F
from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.effects.effect import Composition
from ces_gap.grid import number_blocks
from ces_gap.inference.evidence import Baseline, Evidence
from ces_gap.inference.explanation import Explanation, share_probabilities
from ces_gap.inference.fit import Z95, EffectFit, Interval, estimate_parameters, fit_from
from ces_gap.inference.judgement import (
    CALIBRATION,
    NO_GAP,
    ClosedShare,
    GapSize,
    Judgement,
    SearchFindings,
    VerdictEvidence,
)
from ces_gap.inference.rare import RareDeviation, find_rare_deviation
from ces_gap.inference.search import EffectSearchResult, compute_paired_gain
from ces_gap.inputs.prepare import DiagnosisInput
from ces_gap.limits import EvidenceLimits, RareLimits, VerdictLimits
from ces_gap.progress import OptionalSteps, Progress, ignore_progress
from ces_gap.sensor_noise import NO_SOURCE
from ces_gap.trace import Trace, gap_N, noise_floor_N, own_error_N, usable_values

RESAMPLES = 500
SAME_BAND = 0.95  # of the noise as logged: where more reaches the grid, the difference is not told
EXACT_CAUSES = 3  # as many of the first causes are always scored with the simulation itself


@dataclass(frozen=True, repr=False)
class Gap:
    """The gap on the held-out recordings, RMS [N] without measurement noise.

    `rms_N` is that of the original simulation, `corrected_N` after the correction learned from references (equal to
    `rms_N` without references). `noise_floor_N` is the noise of the measured force as logged, of which
    `noise_in_band_N` reaches the grid of the comparison and is subtracted; `noise_source` says what showed it, as in
    `8.1 N from repeated cycles`. `cost_J` is thesis eq. 3.5.
    """

    rms_N: float
    ci95_N: Interval
    noise_floor_N: float
    cost_J: float
    corrected_N: float
    corrected_ci95_N: Interval
    noise_source: str = NO_SOURCE
    noise_known: bool = True  # False if no source limits the noise of a recording
    noise_in_band_N: float = math.nan

    def __repr__(self) -> str:
        low, high = self.ci95_N
        return f"<Gap of {self.rms_N:.3g} N RMS ({low:.3g} to {high:.3g}), J {self.cost_J:.3g} %>"

    @property
    def noise_in_band(self) -> str:
        """Which part of the noise the gaps are without, in a few words; empty if it is all of it."""
        narrower = self.noise_in_band_N < SAME_BAND * self.noise_floor_N
        return f"{self.noise_in_band_N:.1f} N of it in the band of the comparison " if narrower else ""


@dataclass(frozen=True)
class HeldOutSeries:
    """One held-out recording for the plots: forces [N] (n,) of the corrected and of the augmented simulation."""

    trace: Trace
    corrected: F
    augmented: F


@dataclass(frozen=True)
class HeldOutScores:
    """The gap, the generic learner's gap after [N], each effect alone (ranked), the composition, and the forces.

    `nothing` is the explanation by no effect, `timed_N` the gap after the simulation's timing was fitted.
    """

    gap: Gap
    ceiling_after_N: float
    causes: tuple[Explanation, ...]
    composition: Explanation
    series: tuple[HeldOutSeries, ...]
    nothing: Explanation
    timed_N: float
    notes: tuple[str, ...] = ()  # on forces that the simulation refused
    rare: RareDeviation | None = None  # of the measured force from the corrected simulation
    rare_left: RareDeviation | None = None  # of the measured force from the best explanation


def score_held_out(
    inputs: DiagnosisInput,
    baseline: Baseline,
    result: EffectSearchResult,
    findings: SearchFindings,
    seed: int,
    progress: Progress = ignore_progress,
) -> HeldOutScores:
    """Return the scores of each effect and of the best explanation.

    The noise is limited to what the references, or the best explanation and the learner, leave.
    """
    reference_N = result.evidence.noise.rms_N if inputs.reference else np.inf
    limits = {"what the references leave": reference_N, "what a learner cannot explain": findings.rest_N}
    blocks = cut_into_blocks(inputs.held_out, seed, min(limits.values()))
    scorer = build_scorer(blocks, baseline.plant, inputs.best)
    if not inputs.is_corrected:
        scorer = replace(scorer, corrected=scorer.before)
    best, timing = result.best, [f for f in result.alone if f.effects[0].nuisance][:1]
    forces = tuple(scorer.alone if best is None else scorer.forces(best, True))
    nothing = scorer.explain()
    together = nothing if best is None else _add_gain(scorer.explain(best, forces), result, best)
    if best is not None and len(best.effects) > 1:
        progress("refitting without each effect", 0.0)
        together = replace(together, without_N=gaps_without_each(scorer, result.evidence, best))
    timed = [scorer.explain(f, scorer.forces(f, True)).gap_after_N for f in timing]
    ceiling = blocks.energy(baseline.ceiling.add_to(blocks.traces, scorer.alone))
    computed = {} if best is None else {best.composition: forces}
    alone, least_N = (*result.evidence.alone, *scorer.alone), findings.tolerance_N
    least_N = max(least_N, RareLimits.HIDDEN * findings.visible_from_N if findings.has_references else 0.0)
    rare, rare_left = _find_rare(inputs, baseline, blocks.traces, alone, least_N), None
    if best is not None and np.isfinite(together.gap_after_N):
        largest_N = max(nothing.gap_after_N, 0.0 if rare is None else abs(rare.mean_N))
        least_N = max(least_N, math.sqrt(VerdictLimits.TENTH) * largest_N)  # less is immaterial beside it
        modelled = (*result.evidence.forces(best.composition), *forces)
        rare_left = _find_rare(inputs, baseline, blocks.traces, modelled, least_N)
    return HeldOutScores(
        gap=_gap(scorer, _find_noise_source(blocks.traces, limits)),
        ceiling_after_N=blocks.rms(ceiling)[0],
        causes=_causes(scorer, result, findings, computed, progress),
        composition=together,
        series=tuple(HeldOutSeries(*row) for row in zip(blocks.traces, scorer.alone, forces, strict=True)),
        nothing=nothing,
        timed_N=min([nothing.gap_after_N, *timed]),
        notes=tuple(scorer.optional.notes),
        rare=rare,
        rare_left=rare_left,
    )


def _find_rare(
    inputs: DiagnosisInput, baseline: Baseline, held_out: Sequence[Trace], forces: Sequence[F], least_N: float
) -> RareDeviation | None:
    """Return the largest local deviation from `forces` [N] (n,) on fitted and held-out recordings.

    It is at least `least_N`, and more than the references have and than the RMS shows.
    """
    errors = [t.force - baseline.plant.alone(t) for t in inputs.reference]
    on_references = [np.where(t.usable, error, np.nan) for t, error in zip(inputs.reference, errors, strict=True)]
    parts = (inputs.real, forces[: len(inputs.real)]), (held_out, forces[len(inputs.real) :])
    largest_N = max(gap_N(traces, some, noise_floor_N(traces)) for traces, some in parts)
    return find_rare_deviation(
        (*inputs.real, *held_out), forces, on_references, max(least_N, RareLimits.HIDDEN * largest_N)
    )


def gaps_without_each(scorer: HeldOutScorer, evidence: Evidence, fit: EffectFit) -> tuple[float, ...]:
    """Return the held-out gap [N] that is left without each effect of a fit, the others refitted to the `evidence`."""
    owner, gaps = np.repeat(np.arange(len(fit.effects)), [len(e.parameters) for e in fit.effects]), []
    for k in range(len(fit.effects)):
        others = fit_from(evidence, (*fit.effects[:k], *fit.effects[k + 1 :]), fit.searched[owner != k])
        gaps.append(scorer.explain(others, scorer.forces(others, True)).gap_after_N)
    return tuple(gaps)


def _find_noise_source(traces: Sequence[Trace], limits: dict[str, float]) -> str:
    """Return what limits the noise of most of the held-out time, in a few words."""
    limit = min(limits, key=lambda name: limits[name])
    seconds: dict[str, float] = {}
    for trace in traces:
        source = limit if limits[limit] < trace.noise_N else trace.measured_noise.describe_source()
        seconds[source] = seconds.get(source, 0.0) + float(trace.usable.sum()) * trace.step_s
    return max(seconds, key=lambda name: seconds[name])


def _causes(
    scorer: HeldOutScorer,
    result: EffectSearchResult,
    findings: SearchFindings,
    computed: dict[Composition, tuple[F, ...]],
    progress: Progress,
) -> tuple[Explanation, ...]:
    """Return each effect alone, most probable first; `computed` are forces [N] that have been computed already."""
    odds, best = findings.odds.effects, result.best.names if result.best is not None else ()
    fits = [f for f in result.alone if f.names[0] in odds]
    imitable = (*findings.absorbed, CALIBRATION)  # errors of the simulation: after other effects of the composition
    ranked = sorted(fits, key=lambda f: (-odds[f.names[0]], f.names[0] not in best, f.names[0] in imitable, f.cost))
    causes = []
    for k, fit in enumerate(ranked):
        (name,) = fit.names
        progress(f"evaluating {name}", k / len(ranked))
        forces = computed.get(fit.composition) or scorer.forces(fit, k < EXACT_CAUSES or name in best)
        causes.append(replace(_add_gain(scorer.explain(fit, forces), result, fit), probability=odds[name]))
    return tuple(causes)


def _add_gain(explanation: Explanation, result: EffectSearchResult, fit: EffectFit) -> Explanation:
    """Return the explanation with the share of the gap's energy that the fit gains on the units left out."""
    gain = compute_paired_gain(result.evidence, result.baseline_residual, fit.left_out)
    return replace(explanation, gain=gain.energy / result.gap_energy, gain_error=gain.error / result.gap_energy)


def _gap(scorer: HeldOutScorer, noise_source: str) -> Gap:
    blocks = scorer.blocks
    rms, ci95 = blocks.rms(scorer.before)
    corrected_N, corrected_ci95_N = blocks.rms(scorer.corrected)
    noise_N = float(np.sqrt(blocks.noise.sum() / max(float(blocks.ticks.sum()), 1.0)))
    logged_N = noise_N * noise_floor_N(blocks.traces, as_logged=True) / max(noise_floor_N(blocks.traces), 1e-12)
    force = usable_values(blocks.traces, [t.force for t in blocks.traces])
    simulated = usable_values(blocks.traces, [t.simulated_as_logged for t in blocks.traces])
    cost_J = 100.0 * float(np.linalg.norm(force - simulated) / max(float(np.linalg.norm(force - force.mean())), 1e-9))
    is_known = all(t.measured_noise.known for t in blocks.traces)
    return Gap(rms, ci95, logged_N, cost_J, corrected_N, corrected_ci95_N, noise_source, is_known, noise_N)


def collect_evidence(search: SearchFindings, scores: HeldOutScores) -> VerdictEvidence:
    """Return the evidence for the verdict."""
    gap, composition = scores.gap, scores.composition
    return VerdictEvidence(
        search=search,
        held_out=GapSize(
            min(gap.rms_N, gap.corrected_N),
            scores.timed_N,
            gap.noise_floor_N,
            gap.noise_known,
            own_error_N([s.trace for s in scores.series]),
        ),
        held_out_ci95_N=gap.corrected_ci95_N,
        composition=composition.effects,
        closed=closed_share(gap, composition),
        closed_alone={c.effects[0]: closed_share(gap, c) for c in scores.causes},
        learnt=closed_share(gap, replace(composition, gap_after_N=scores.ceiling_after_N)).value,
        is_undetermined=has_undetermined_effect(composition),
        in_band_N=gap.noise_in_band_N,
        is_rare=scores.rare is not None,
        leaves_rare=scores.rare_left is not None,
    )


def closed_share(gap: Gap, explanation: Explanation) -> ClosedShare:
    """Return the share of the held-out gap's energy, after the correction, that an explanation closes."""
    before_N = gap.corrected_N if gap.corrected_N > 0.0 else math.nan
    left = [explanation.gap_after_N / before_N, *(1.0 - shrink for shrink in explanation.shrink_ci95)]
    return ClosedShare(*(1.0 - share**2 for share in left))


def apply_judgement(scores: HeldOutScores, judgement: Judgement) -> HeldOutScores:
    """Return the scores with the final probabilities, the most probable effect first.

    There is no composition if there is no gap, or if it enlarges the gap.
    """
    together, odds = scores.composition, judgement.probabilities.effects
    if judgement.verdict == NO_GAP or together.gap_after_N >= scores.gap.corrected_N:
        series = tuple(replace(s, augmented=s.corrected) for s in scores.series)
        scores, together = replace(scores, series=series), scores.nothing
    causes, together = share_probabilities(odds, scores.causes, together)
    return replace(scores, causes=causes, composition=together)


def has_undetermined_effect(composition: Explanation) -> bool:
    """True if the 95 % interval of an effect's magnitude includes that it is not there, and it is not needed.

    Several magnitudes of one effect may be uncertain each and certain together, so they are not tested one by one.
    Where an effect saturates, as a relief valve that is wide open, the interval is wide for a size that is surely not
    zero (Hauck and Donner 1977): then counts what is left without the effect.
    """
    c, alone = composition, composition.gain > Z95 * composition.gain_error > 0.0
    needed = [gap_N > VerdictLimits.CLEARLY_MORE * c.gap_after_N for gap_N in c.without_N] or [alone] * len(c.effects)
    for setting, estimates, is_needed in zip(c.composition.settings, c.estimates, needed, strict=True):
        sizes = [(p, e) for p, e in zip(setting.effect.parameters, estimates, strict=True) if p.magnitude]
        includes_none = all(e.ci95[0] <= min(p.neutral, p.high) <= e.ci95[1] for p, e in sizes)
        if not is_needed and len(sizes) == 1 and includes_none:
            return True
    return False


@dataclass(frozen=True)
class Blocks:
    """Held-out recordings in blocks: usable `ticks` (b,) and expected energy of the noise (b,) [N²] in each."""

    traces: tuple[Trace, ...]
    ticks: F
    noise: F
    number: tuple[NDArray[np.int64], ...]  # block of each tick, by trace
    resamples: NDArray[np.int64]  # (RESAMPLES, b) blocks of each resample

    def energy(self, forces: Sequence[F]) -> F:
        """Return the energy [N²] of measured minus modelled force in each block (b,), less that of the noise."""
        total = np.zeros(len(self.ticks))
        for trace, force, number in zip(self.traces, forces, self.number, strict=True):
            error = np.where(trace.usable, trace.force - force, 0.0)
            total += np.bincount(number, error**2, len(total))
        return np.asarray(total - self.noise)

    def rms(self, energy: F) -> tuple[float, Interval]:
        """Return the RMS [N] of an energy (b,) and its 95 % interval."""
        means = energy[self.resamples].sum(1) / np.maximum(self.ticks[self.resamples].sum(1), 1.0)
        low, high = np.percentile(_root(means), [2.5, 97.5])
        return float(_root(energy.sum() / max(float(self.ticks.sum()), 1.0))), (float(low), float(high))

    def shrink(self, before: F, after: F) -> tuple[float, Interval]:
        """Return 1 - RMS after / RMS before of two energies (b,) and its 95 % interval; 0 without a gap before.

        Resamples that happen to hold hardly any of the gap, as between rare contacts of a stop, show no shrink.
        """
        begun, ended = before[self.resamples].sum(1), after[self.resamples].sum(1)
        shown = begun > EvidenceLimits.MIN_SHOWN * before.sum()
        shrinks = _compute_shrink(begun[shown], ended[shown]) if shown.any() else np.zeros(1)
        low, high = np.percentile(shrinks, [2.5, 97.5])
        return float(_compute_shrink(before.sum(), after.sum())), (float(low), float(high))


def cut_into_blocks(traces: Sequence[Trace], seed: int, max_noise_N: float = np.inf) -> Blocks:
    """Return the blocks of held-out recordings, whose noise is limited to `max_noise_N` RMS [N].

    The noise estimated from a recording's highest frequencies is only an upper bound: the damper may contribute to it.
    """
    number = number_blocks([t.time_s for t in traces], EvidenceLimits.BLOCK_S)
    count = int(number[-1][-1]) + 1
    rows = list(zip(traces, number, strict=True))
    ticks = sum(np.bincount(n, t.usable.astype(np.float64), count) for t, n in rows)
    noise = sum(np.bincount(n, t.usable * min(t.noise_N, max_noise_N) ** 2, count) for t, n in rows)
    resamples = np.random.default_rng(seed).integers(0, count, (RESAMPLES, count))
    return Blocks(tuple(traces), np.asarray(ticks), np.asarray(noise), tuple(number), resamples)


def _compute_shrink(before: F | np.float64, after: F | np.float64) -> F:
    """Return 1 - sqrt(after / before), 0 without a gap before."""
    is_gap = np.asarray(before) > 0.0
    return np.asarray(np.where(is_gap, 1.0 - _root(after) / _root(np.where(is_gap, before, 1.0)), 0.0))


def _root(energy: F | np.float64) -> F:
    return np.asarray(np.sqrt(np.maximum(energy, 0.0)))


@dataclass(frozen=True)
class HeldOutScorer:
    """Held-out recordings in `blocks`, with plants prepared for each: `quick` and `exact` ones."""

    blocks: Blocks
    quick: tuple[Plant, ...]
    exact: tuple[Plant, ...]
    alone: tuple[F, ...]  # the plant's force on each held-out trace
    before: F  # energy in each block of the gap of the original simulation
    corrected: F  # the same after the correction: what effects shrink
    optional: OptionalSteps = field(default_factory=OptionalSteps)

    def forces(self, fit: EffectFit, exact: bool) -> tuple[F, ...]:
        """Return the force [N] with the effects of a fit on each held-out trace; NaN if the simulation refuses it."""
        plants = self.exact if exact or not fit.composition.reruns else self.quick
        rows = list(zip(plants, self.blocks.traces, self.alone, strict=True))
        return self.optional.run(
            f"the force with {' and '.join(fit.names)}",
            lambda: tuple(plant.with_effects(fit.composition, trace, alone) for plant, trace, alone in rows),
            tuple(np.full(len(trace), np.nan) for trace in self.blocks.traces),
        )

    def explain(self, fit: EffectFit | None = None, forces: Sequence[F] | None = None) -> Explanation:
        """Return the explanation by a fit whose `forces` [N] are known; by no effect, after the correction, if None."""
        after = self.blocks.energy(self.alone if forces is None else forces)
        score = self.blocks.rms(after)[0], *self.blocks.shrink(self.corrected, after)
        if fit is None:
            return Explanation((), (), Composition(), (), *score)
        forms = tuple(e.form for e in fit.effects)
        return Explanation(fit.names, forms, fit.composition, estimate_parameters(fit), *score)


def build_scorer(blocks: Blocks, plant: Plant, exact: TraceSimulator) -> HeldOutScorer:
    """Return the scorer of held-out blocks for a plant; `exact` is the simulation with which effects rerun exactly."""
    quick = tuple(plant.prepare_for(t) for t in blocks.traces)
    best = tuple(replace(plant, simulation=exact).prepare_for(t) for t in blocks.traces)
    alone = tuple(plant.alone(t) for t in blocks.traces)
    before = blocks.energy([t.simulated_as_logged for t in blocks.traces])
    return HeldOutScorer(blocks, quick, best, alone, before, blocks.energy(alone))
