"""The verdict stage: figures, probabilities and verdict from the search result, on the parts left out."""

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

CLEAR_Z = 20.0  # z of a gain as large as the noise, in however few blocks


@dataclass(frozen=True)
class Decision:
    """The verdict and its basis; `rest_N` is the RMS [N] that the best explanation and the generic learner leave."""

    verdict: str
    figures: VerdictFigures
    probabilities: Probabilities
    interchangeable: tuple[tuple[str, ...], ...]
    rest_N: float


def decide(
    baseline: Baseline, result: EffectSearchResult, simulation: TraceSimulator, weights: Calibration
) -> Decision:
    """Return the decision; `simulation` reruns the best explanation."""
    rest = _learn_rest(baseline, result, simulation)
    figures = compute_figures(result, baseline.ceiling, rest)
    names = result.best.names if result.best is not None else ()
    odds = probabilities(figures, min_unexplained_shares(result), names, weights)
    groups = interchangeable_effects(result)
    return Decision(choose_verdict(result, odds, bool(groups), weights), figures, odds, groups, rest.learnt.noise.rms_N)


def compute_figures(result: EffectSearchResult, before: Ceiling, after: Ceiling) -> VerdictFigures:
    """Return the figures; the learner was fitted to the gap `before` and `after` the best explanation."""
    evidence, best, baseline = result.evidence, result.best, result.baseline_residual
    residual = best.left_out if best is not None else baseline
    gain = compute_paired_gain(evidence, baseline, residual)
    ceiling = compute_paired_gain(evidence, baseline, baseline - evidence.whiten(before.learnt.crossfitted))
    rest = compute_paired_gain(evidence, residual, residual - evidence.whiten(after.learnt.crossfitted))
    unexplained = (float(residual @ residual) - len(residual)) / result.gap_energy
    learnable = rest.energy / result.gap_energy
    return VerdictFigures(
        energy=(float(baseline @ baseline) - len(baseline)) / len(baseline),
        gain_z=max(gain.z, CLEAR_Z * gain.energy / len(residual)) if best is not None else 0.0,
        ceiling_z=ceiling.z,
        unexplained=unexplained if evidence.noise_known else learnable,
        learnable=learnable,
        learnable_z=rest.z,
        stuck=count_stuck_parameters(best) if best is not None else 0,
        drift=measure_parameter_drift(best) if best is not None else 0.0,
    )


def choose_verdict(result: EffectSearchResult, odds: Probabilities, replaceable: bool, weights: Calibration) -> str:
    """Return the verdict; `replaceable` if an effect of the best explanation has an alternative."""
    if odds.none > 1.0 - weights.least_gap:
        return NO_GAP
    if result.best is None or odds.unknown > (1.0 - odds.none) * (1.0 - weights.least_known):
        return UNKNOWN
    if replaceable or has_alternatives(result.best.names, odds):
        return AMBIGUOUS
    return NAMED


def name_by_simpler_rules(result: EffectSearchResult) -> dict[str, str]:
    """Return the effects that simpler rules would name, for comparison in blind tests."""
    n, none = len(result.baseline_residual), result.baseline_residual
    bic = min(result.alone, key=lambda f: n * np.log(f.residual @ f.residual) + len(f.searched) * np.log(n))
    flexible = max(result.alone, key=lambda f: (len(f.searched), -f.cost))

    def correlation(signature: NDArray[np.float64]) -> float:
        return float(abs(signature @ none) / max(float(np.linalg.norm(signature) * np.linalg.norm(none)), 1e-12))

    similar = max(result.alone, key=lambda f: correlation(none - f.residual))
    return {"signature_correlation": similar.names[0], "bic": bic.names[0], "most_flexible": flexible.names[0]}


def _learn_rest(baseline: Baseline, result: EffectSearchResult, simulation: TraceSimulator) -> Ceiling:
    """Return the generic learner fitted to the rest of the best explanation, cross-fitted over blocks."""
    if result.best is None:
        return baseline.ceiling
    plant, evidence = Plant(simulation, baseline.correction), result.evidence
    rows = zip(evidence.traces, evidence.alone, strict=True)
    forces = [plant.prepare_for(t).with_effects(result.best.composition, t, a) for t, a in rows]
    return learn_ceiling(evidence.traces, forces)
