"""The scoring stage: the gap on held-out recordings, and what each explanation leaves of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_gap.effects.effect import Composition
from ces_gap.inference.comparison import compute_paired_gain
from ces_gap.inference.decide import Decision
from ces_gap.inference.explanation import Explanation, Interval
from ces_gap.inference.explanations import HeldOutScorer, build_scorer
from ces_gap.inference.fit import EffectFit
from ces_gap.inference.learn_baseline import Baseline
from ces_gap.inference.search import EffectSearchResult
from ces_gap.inference.shrinkage import cut_into_blocks
from ces_gap.inference.verdict import CALIBRATION, NO_GAP
from ces_gap.intake.prepare import DiagnosisInput
from ces_gap.progress import Progress, ignore_progress
from ces_gap.sensor_noise.noise_estimate import NO_SOURCE
from ces_gap.trace import F, Trace

EXACT_CAUSES = 3  # as many of the first causes are always scored with the simulation itself


@dataclass(frozen=True)
class Gap:
    """The gap on the held-out recordings, RMS [N] without measurement noise.

    `rms_N` is that of the original simulation, `corrected_N` after the correction learned from references (equal to
    `rms_N` without references). `noise_floor_N` is what no model can explain, and `noise_source` says what showed
    it, as in `8.1 N from repeated cycles`. `cost_J` is thesis eq. 3.5.
    """

    rms_N: float
    ci95_N: Interval
    noise_floor_N: float
    cost_J: float
    corrected_N: float
    corrected_ci95_N: Interval
    noise_source: str = NO_SOURCE


@dataclass(frozen=True)
class HeldOutSeries:
    """One held-out recording for the plots: forces [N] (n,) of the corrected and of the augmented simulation."""

    trace: Trace
    corrected: F
    augmented: F


@dataclass(frozen=True)
class HeldOutScores:
    """The gap, the generic learner's gap after [N], each effect alone (ranked), the composition, and the forces.

    `nothing` is the explanation by no effect.
    """

    gap: Gap
    ceiling_after_N: float
    causes: tuple[Explanation, ...]
    composition: Explanation
    series: tuple[HeldOutSeries, ...]
    nothing: Explanation

    def without_composition(self) -> HeldOutScores:
        """Return the scores with no effect added to the simulation."""
        series = tuple(replace(s, augmented=s.corrected) for s in self.series)
        return replace(self, composition=self.nothing, series=series)


def score_held_out(
    inputs: DiagnosisInput,
    baseline: Baseline,
    result: EffectSearchResult,
    decision: Decision,
    seed: int,
    progress: Progress = ignore_progress,
) -> HeldOutScores:
    """Return the scores of each effect and of the best explanation; the latter is empty if there is no gap.

    The noise is limited to what the references, or the best explanation and the learner, leave.
    """
    limits = _limit_noise(inputs, result, decision)
    blocks = cut_into_blocks(inputs.held_out, seed, min(limits.values()))
    scorer = build_scorer(blocks, baseline.plant, inputs.best)
    best = None if decision.verdict == NO_GAP else result.best
    forces = tuple(scorer.alone if best is None else scorer.forces(best, True))
    together = scorer.nothing() if best is None else _add_gain(scorer.explain(best, forces), result, best)
    ceiling = blocks.energy(baseline.ceiling.add_to(blocks.traces, scorer.alone))
    return HeldOutScores(
        gap=replace(_gap(scorer, bool(inputs.reference)), noise_source=_find_noise_source(blocks.traces, limits)),
        ceiling_after_N=blocks.rms(ceiling)[0],
        causes=_causes(scorer, result, decision, {} if best is None else {best.composition: forces}, progress),
        composition=together,
        series=tuple(HeldOutSeries(*row) for row in zip(blocks.traces, scorer.alone, forces, strict=True)),
        nothing=scorer.nothing(),
    )


def _limit_noise(inputs: DiagnosisInput, result: EffectSearchResult, decision: Decision) -> dict[str, float]:
    """Return upper bounds of the noise [N] other than the measurement's own, by what they are."""
    reference_N = result.evidence.noise.rms_N if inputs.reference else np.inf
    return {"what the references leave": reference_N, "what a learner cannot explain": decision.rest_N}


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
    decision: Decision,
    known: dict[Composition, tuple[F, ...]],
    progress: Progress,
) -> tuple[Explanation, ...]:
    """Return each effect alone, most probable first; `known` are forces [N] that have been computed already."""
    odds, best = decision.probabilities.effects, result.best.names if result.best is not None else ()
    fits = [f for f in result.alone if f.names[0] in odds]
    imitable = (
        *decision.absorbed,
        CALIBRATION,
    )  # by an error of the simulation: after other effects of the composition
    ranked = sorted(fits, key=lambda f: (-odds[f.names[0]], f.names[0] not in best, f.names[0] in imitable, f.cost))
    causes = []
    for k, fit in enumerate(ranked):
        (name,) = fit.names
        progress(f"evaluating {name}", k / len(ranked))
        forces = known.get(fit.composition) or scorer.forces(fit, k < EXACT_CAUSES or name in best)
        causes.append(replace(_add_gain(scorer.explain(fit, forces), result, fit), probability=odds[name]))
    return tuple(causes)


def _add_gain(explanation: Explanation, result: EffectSearchResult, fit: EffectFit) -> Explanation:
    """Return the explanation with the share of the gap's energy that the fit gains on the units left out."""
    gain = compute_paired_gain(result.evidence, result.baseline_residual, fit.left_out)
    return replace(explanation, gain=gain.energy / result.gap_energy, gain_error=gain.error / result.gap_energy)


def _gap(scorer: HeldOutScorer, corrected: bool) -> Gap:
    blocks = scorer.blocks
    rms, ci95 = blocks.rms(scorer.before)
    rest, rest_ci95 = blocks.rms(blocks.energy(scorer.alone)) if corrected else (rms, ci95)
    noise = float(np.sqrt(blocks.noise.sum() / max(float(blocks.ticks.sum()), 1.0)))
    return Gap(rms, ci95, noise, _cost_J(blocks.traces), rest, rest_ci95)


def _cost_J(traces: Sequence[Trace]) -> float:
    """Return the cost J [%] of the original simulation (thesis eq. 3.5)."""
    force = np.concatenate([t.force[t.usable] for t in traces])
    simulated = np.concatenate([t.simulated_as_logged[t.usable] for t in traces])
    return 100.0 * float(np.linalg.norm(force - simulated) / max(float(np.linalg.norm(force - force.mean())), 1e-9))
