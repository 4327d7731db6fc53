"""The verdict stage: figures, probabilities and verdict from the search result, on the parts left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.ceiling import Ceiling, learn_ceiling
from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.inference.alternatives import interchangeable_effects, min_unexplained_shares
from ces_gap.inference.comparison import compute_paired_gain
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.explanations import count_stuck_parameters, measure_parameter_drift
from ces_gap.inference.learn_baseline import Baseline
from ces_gap.inference.search import EffectSearchResult
from ces_gap.inference.verdict import (
    AMBIGUOUS,
    NAMED,
    NO_GAP,
    TOLERANCE_SHARE,
    UNKNOWN,
    Calibration,
    GapSize,
    Probabilities,
    VerdictFigures,
    find_no_gap_reason,
    has_alternatives,
    is_clear_of_the_simulation,
    probabilities,
)
from ces_gap.trace import F

CLEAR_Z = 20.0  # z of a gain as large as the noise, in however few blocks


@dataclass(frozen=True)
class Decision:
    """The verdict and its basis.

    `no_gap_reason` is the reason for "no gap", "" otherwise. `rest_N` is the RMS [N] that the best explanation and the
    generic learner leave. `visible_from_N` is the RMS [N] below which an effect would hide behind noise and the
    simulation's own error.
    """

    verdict: str
    no_gap_reason: str
    figures: VerdictFigures
    probabilities: Probabilities
    interchangeable: tuple[tuple[str, ...], ...]
    rest_N: float
    visible_from_N: float


def decide(
    baseline: Baseline,
    result: EffectSearchResult,
    simulation: TraceSimulator,
    weights: Calibration,
    tolerance: float = TOLERANCE_SHARE,
) -> Decision:
    """Return the decision; `simulation` reruns the best explanation; a gap within `tolerance` of the force is none."""
    rest = _learn_rest(baseline, result, simulation)
    figures = compute_figures(result, baseline.ceiling, rest)
    names = result.best.names if result.best is not None else ()
    odds = probabilities(figures, min_unexplained_shares(result), names, weights)
    groups = interchangeable_effects(result)
    size = measure_gap(baseline, result, rest.learnt.noise.rms_N)
    reason = find_no_gap_reason(size, odds.none > 1.0 - weights.least_gap, tolerance)
    verdict = NO_GAP if reason else choose_verdict(result, odds, bool(groups), weights)
    if verdict == NAMED and not is_clear_of_the_simulation(size, tolerance):
        verdict = AMBIGUOUS
    rest_N = rest.learnt.noise.rms_N
    return Decision(verdict, reason, figures, odds, groups, rest_N, result.evidence.noise.rms_N)


def measure_gap(baseline: Baseline, result: EffectSearchResult, rest_N: float) -> GapSize:
    """Return the size of the gap on the fitted recordings; noise that was not measured is at most the `rest_N` [N]."""
    evidence = result.evidence
    force = np.concatenate([t.force[t.usable] for t in evidence.traces])
    noise_N = float(np.sqrt(np.mean([t.noise_N**2 for t in evidence.traces])))
    if not all(t.measured_noise.known for t in evidence.traces):
        noise_N = max(noise_N, rest_N)
    timing = next((f for f in result.alone if f.effects[0].nuisance), None)
    gaps = [_rms_gap(evidence, evidence.alone)]
    gaps += [] if timing is None else [_rms_gap(evidence, evidence.forces(timing.composition))]
    above = [float(np.sqrt(max(gap**2 - noise_N**2, 0.0))) for gap in gaps]
    return GapSize(above[0], min(above), noise_N, float(np.sqrt(np.mean(force**2))), baseline.correction is not None)


def _rms_gap(evidence: Evidence, forces: Sequence[F]) -> float:
    errors = [(t.force - f)[t.usable] for t, f in zip(evidence.traces, forces, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def compute_figures(result: EffectSearchResult, before: Ceiling, after: Ceiling) -> VerdictFigures:
    """Return the figures; the learner was fitted to the gap `before` and `after` the best explanation."""
    evidence, best = result.evidence, result.best
    baseline = _residual_after_timing(result)
    residual = best.left_out if best is not None else baseline
    gain = compute_paired_gain(evidence, baseline, residual)
    ceiling = compute_paired_gain(
        evidence, baseline, result.baseline_residual - evidence.whiten(before.learnt.crossfitted)
    )
    rest = compute_paired_gain(evidence, residual, residual - evidence.whiten(after.learnt.crossfitted))
    unexplained = (float(residual @ residual) - len(residual)) / result.gap_energy
    learnable = rest.energy / result.gap_energy
    return VerdictFigures(
        energy=(float(baseline @ baseline) - len(baseline)) / len(baseline),
        gain_z=max(gain.z, CLEAR_Z * gain.energy / len(residual)) if best is not None else 0.0,
        ceiling_z=ceiling.z,
        unexplained=unexplained,
        learnable=learnable,
        learnable_z=rest.z,
        stuck=count_stuck_parameters(best) if best is not None else 0,
        drift=measure_parameter_drift(best) if best is not None else 0.0,
    )


def _residual_after_timing(result: EffectSearchResult) -> F:
    """Return the whitened residual (r,) without effects, after the simulation's timing where that is a gain."""
    fits = [
        f
        for f in result.alone
        if f.effects[0].nuisance and f.cost < result.baseline_residual @ result.baseline_residual
    ]
    return fits[0].left_out if fits else result.baseline_residual


def choose_verdict(result: EffectSearchResult, odds: Probabilities, replaceable: bool, weights: Calibration) -> str:
    """Return the verdict on a gap; `replaceable` if an effect of the best explanation has an alternative."""
    if result.best is None or all(e.nuisance for e in result.best.effects):
        return UNKNOWN
    if odds.unknown > (1.0 - odds.none) * (1.0 - weights.least_known):
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
