"""The verdict stage: figures, probabilities and verdict from what the search found, on the parts left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.ceiling import Ceiling, learn_ceiling
from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.inference.alternatives import interchangeable_effects, min_unexplained_shares
from ces_gap.inference.comparison import compute_paired_gain
from ces_gap.inference.explanations import count_stuck_parameters, measure_parameter_drift
from ces_gap.inference.learn_baseline import Baseline
from ces_gap.inference.search import EffectSearchResult
from ces_gap.inference.verdict import (
    AMBIGUOUS,
    NAMED,
    NO_GAP,
    UNKNOWN,
    Calibration,
    Probabilities,
    VerdictFigures,
    has_alternatives,
    probabilities,
)

CLEAR_Z = 20.0  # z for which a gain as large as the noise counts, in however few blocks it arose


@dataclass(frozen=True)
class Decision:
    """The `verdict`, the `figures` and `probabilities` behind it, and groups of `interchangeable` effects.

    `rest_N` is the RMS [N] of what the best explanation and the generic learner together leave.
    """

    verdict: str
    figures: VerdictFigures
    probabilities: Probabilities
    interchangeable: tuple[tuple[str, ...], ...]
    rest_N: float


def decide(baseline: Baseline, found: EffectSearchResult, simulation: TraceSimulator, weights: Calibration) -> Decision:
    """Return what the search decides; `simulation` reruns the best explanation."""
    rest = _learn_rest(baseline, found, simulation)
    figures = compute_figures(found, baseline.ceiling, rest)
    names = found.best.names if found.best is not None else ()
    odds = probabilities(figures, min_unexplained_shares(found), names, weights)
    groups = interchangeable_effects(found)
    return Decision(choose_verdict(found, odds, bool(groups), weights), figures, odds, groups, rest.learnt.noise.rms_N)


def compute_figures(found: EffectSearchResult, before: Ceiling, after: Ceiling) -> VerdictFigures:
    """Return the figures, given what the learner makes of the gap, and of what the best explanation leaves."""
    evidence, best = found.evidence, found.best
    residual = best.left_out if best is not None else found.baseline_residual
    gained = compute_paired_gain(evidence, found.baseline_residual, residual)
    open_ = compute_paired_gain(
        evidence, found.baseline_residual, found.baseline_residual - evidence.whiten(before.learnt.crossfitted)
    )
    more = compute_paired_gain(evidence, residual, residual - evidence.whiten(after.learnt.crossfitted))
    left = (float(residual @ residual) - len(residual)) / found.gap_energy
    learnable = more.energy / found.gap_energy
    return VerdictFigures(
        energy=(float(found.baseline_residual @ found.baseline_residual) - len(found.baseline_residual))
        / len(found.baseline_residual),
        gain_z=max(gained.z, CLEAR_Z * gained.energy / len(residual)) if best is not None else 0.0,
        ceiling_z=open_.z,
        unexplained=left if evidence.noise_known else learnable,
        learnable=learnable,
        learnable_z=more.z,
        stuck=count_stuck_parameters(best) if best is not None else 0,
        drift=measure_parameter_drift(best) if best is not None else 0.0,
    )


def choose_verdict(found: EffectSearchResult, odds: Probabilities, replaceable: bool, weights: Calibration) -> str:
    """Return the verdict; `replaceable` if another effect can take the place of one of the best explanation."""
    if odds.none > 1.0 - weights.least_gap:
        return NO_GAP
    if found.best is None or odds.unknown > (1.0 - odds.none) * (1.0 - weights.least_known):
        return UNKNOWN
    if replaceable or has_alternatives(found.best.names, odds):
        return AMBIGUOUS
    return NAMED


def name_by_simpler_rules(found: EffectSearchResult) -> dict[str, str]:
    """Return what simpler ways of choosing would have named: for comparison in blind tests."""
    n, none = len(found.baseline_residual), found.baseline_residual
    bic = min(found.alone, key=lambda f: n * np.log(f.residual @ f.residual) + len(f.searched) * np.log(n))
    flexible = max(found.alone, key=lambda f: (len(f.searched), -f.cost))

    def correlation(signature: NDArray[np.float64]) -> float:
        return float(abs(signature @ none) / max(float(np.linalg.norm(signature) * np.linalg.norm(none)), 1e-12))

    similar = max(found.alone, key=lambda f: correlation(none - f.residual))
    return {"signature_correlation": similar.names[0], "bic": bic.names[0], "most_flexible": flexible.names[0]}


def _learn_rest(baseline: Baseline, found: EffectSearchResult, simulation: TraceSimulator) -> Ceiling:
    """Return what the learner makes of what the best explanation leaves, on blocks it did not see."""
    if found.best is None:
        return baseline.ceiling
    plant, evidence = Plant(simulation, baseline.correction), found.evidence
    rows = zip(evidence.traces, evidence.alone, strict=True)
    forces = [plant.prepare_for(t).with_effects(found.best.composition, t, a) for t, a in rows]
    return learn_ceiling(evidence.traces, forces)
