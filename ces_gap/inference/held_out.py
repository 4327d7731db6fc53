"""The scoring stage: what the gap is on held-out recordings, and what each explanation leaves of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.effects.effect import Composition
from ces_gap.inference.comparison import compute_paired_gain
from ces_gap.inference.decide import Decision
from ces_gap.inference.explanation import Explanation, Interval
from ces_gap.inference.explanations import HeldOutScorer, build_scorer
from ces_gap.inference.fit import EffectFit
from ces_gap.inference.learn_baseline import Baseline
from ces_gap.inference.search import EffectSearchResult
from ces_gap.inference.shrinkage import cut_into_blocks
from ces_gap.inference.verdict import NO_GAP
from ces_gap.intake.prepare import DiagnosisInput
from ces_gap.progress import Progress, ignore_progress
from ces_gap.trace import Trace

F = NDArray[np.float64]

EXACT_CAUSES = 3  # causes whose shrink is computed with the simulation itself, however slow


@dataclass(frozen=True)
class Gap:
    """The gap on the held-out recordings, RMS [N] with measurement noise taken out.

    `rms_N` of the simulation as given; `corrected_N` once the baseline's own error, learnt from references, is added
    (equal to `rms_N` without references). `noise_floor_N` is what no model can explain. `cost_J` is thesis eq. 3.5.
    """

    rms_N: float
    ci95_N: Interval
    noise_floor_N: float
    cost_J: float
    corrected_N: float
    corrected_ci95_N: Interval


@dataclass(frozen=True)
class HeldOutSeries:
    """One held-out recording for the plots: forces [N] (n,) of simulation as given, corrected, and with the effects."""

    trace: Trace
    corrected: F
    augmented: F


@dataclass(frozen=True)
class HeldOutScores:
    """The gap, what the generic learner leaves of it [N], what each effect alone explains (ranked) and all together.

    `series` holds the forces on each held-out recording.
    """

    gap: Gap
    ceiling_after_N: float
    causes: tuple[Explanation, ...]
    composition: Explanation
    series: tuple[HeldOutSeries, ...]


def score_held_out(
    inputs: DiagnosisInput,
    baseline: Baseline,
    found: EffectSearchResult,
    decision: Decision,
    seed: int,
    progress: Progress = ignore_progress,
) -> HeldOutScores:
    """Return the scores of every cause and of the best explanation, of none if the verdict is that there is no gap.

    Noise counts as no more than the references, or the best explanation and the learner, leave.
    """
    taught_N = found.evidence.noise.rms_N if inputs.reference else np.inf
    blocks = cut_into_blocks(inputs.held_out, seed, min(taught_N, decision.rest_N))
    scorer = build_scorer(blocks, baseline.plant, inputs.best)
    best = None if decision.verdict == NO_GAP else found.best
    forces = tuple(scorer.alone if best is None else scorer.forces(best, True))
    together = scorer.nothing() if best is None else _with_gain(scorer.explain(best, forces), found, best)
    ceiling = blocks.energy(baseline.ceiling.add_to(blocks.traces, scorer.alone))
    return HeldOutScores(
        gap=_gap(scorer, bool(inputs.reference)),
        ceiling_after_N=blocks.rms(ceiling)[0],
        causes=_causes(scorer, found, decision, {} if best is None else {best.composition: forces}, progress),
        composition=together,
        series=tuple(HeldOutSeries(*row) for row in zip(blocks.traces, scorer.alone, forces, strict=True)),
    )


def _causes(
    scorer: HeldOutScorer,
    found: EffectSearchResult,
    decision: Decision,
    known: dict[Composition, tuple[F, ...]],
    progress: Progress,
) -> tuple[Explanation, ...]:
    """Return each effect alone, the most probable first; `known` are forces [N] that need not be computed again."""
    odds, inside = decision.probabilities.effects, found.best.names if found.best is not None else ()
    ranked = sorted(found.alone, key=lambda f: (-odds[f.names[0]], f.names[0] not in inside, f.cost))
    causes = []
    for k, fit in enumerate(ranked):
        (name,) = fit.names
        progress(f"judging {name}", k / len(ranked))
        forces = known.get(fit.composition) or scorer.forces(fit, k < EXACT_CAUSES or name in inside)
        causes.append(replace(_with_gain(scorer.explain(fit, forces), found, fit), probability=odds[name]))
    return tuple(causes)


def _with_gain(explained: Explanation, found: EffectSearchResult, fit: EffectFit) -> Explanation:
    """Return the explanation with the share of the gap's energy that the fit gains on the parts left out."""
    gained = compute_paired_gain(found.evidence, found.baseline_residual, fit.left_out)
    return replace(explained, gain=gained.energy / found.gap_energy, gain_error=gained.error / found.gap_energy)


def _gap(scorer: HeldOutScorer, corrected: bool) -> Gap:
    blocks = scorer.blocks
    rms, ci95 = blocks.rms(scorer.before)
    rest, rest_ci95 = blocks.rms(blocks.energy(scorer.alone)) if corrected else (rms, ci95)
    noise = float(np.sqrt(blocks.noise.sum() / max(float(blocks.ticks.sum()), 1.0)))
    return Gap(rms, ci95, noise, _cost_J(blocks.traces), rest, rest_ci95)


def _cost_J(traces: Sequence[Trace]) -> float:
    """Return the cost J [%] of the simulation as given (thesis eq. 3.5)."""
    force = np.concatenate([t.force[t.usable] for t in traces])
    given = np.concatenate([t.simulated_as_logged[t.usable] for t in traces])
    return 100.0 * float(np.linalg.norm(force - given) / max(float(np.linalg.norm(force - force.mean())), 1e-9))
