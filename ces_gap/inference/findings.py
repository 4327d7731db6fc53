"""What the search found, as numbers: the size of the gap, figures and probabilities on the fitted recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ces_gap.baseline.learner import Ceiling, learn_ceiling
from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.effects.effect import Composition
from ces_gap.grid import rms
from ces_gap.inference.evidence import Baseline, Evidence
from ces_gap.inference.fit import EffectFit, Estimate, count_stuck_parameters
from ces_gap.inference.judgement import (
    GapSize,
    Judgement,
    OddsWeights,
    SearchFindings,
    VerdictFigures,
    Within,
    probabilities,
)
from ces_gap.inference.search import (
    EffectSearchResult,
    compute_paired_gain,
    find_absorbed_effects,
    interchangeable_effects,
    min_unexplained_shares,
)
from ces_gap.limits import EvidenceLimits, VerdictLimits
from ces_gap.trace import gap_N, noise_floor_N, own_error_N, usable_values


def collect_findings(
    baseline: Baseline,
    result: EffectSearchResult,
    simulation: TraceSimulator,
    weights: OddsWeights,
    tolerance: float | None = None,
    is_recorded: bool = False,
) -> SearchFindings:
    """Return the findings; `simulation` reruns the best explanation, `tolerance` is the user's (share of the force)."""
    evidence, best, ceiling_after = result.evidence, result.best, baseline.ceiling
    plants = [replace(baseline.plant, simulation=simulation).prepare_for(t) for t in evidence.traces]
    if best is not None:  # the generic learner, fitted to the rest of the best explanation
        forces = replace(evidence, plants=tuple(plants)).forces(best.composition)
        refused = not all(np.isfinite(force).all() for force in forces)
        ceiling_after = learn_ceiling(evidence.traces, evidence.forces(best.composition) if refused else forces)

    def allowance(fit: EffectFit) -> float:
        return twin_error_energy(evidence, plants, fit)

    force_N = rms(usable_values(evidence.traces, [t.force for t in evidence.traces]))
    figures, size = compute_figures(result, baseline.ceiling, ceiling_after), measure_gap(result)
    together, twin_error = ((), 0.0) if best is None else (best.names, allowance(best) / result.gap_energy)
    return SearchFindings(
        figures=figures,
        odds=probabilities(figures, min_unexplained_shares(result), together, weights, twin_error),
        weights=weights,
        size=size,
        rest_N=ceiling_after.learnt.noise.rms_N,
        visible_from_N=max(evidence.noise.rms_N, baseline.unseen_error_N),
        tolerance_N=tolerance_N(size.noise_N, force_N, tolerance),
        has_references=baseline.correction is not None,
        interchangeable=interchangeable_effects(result, allowance),
        absorbed=find_absorbed_effects(result),
        is_map=best is not None and is_map(best),
        twin_error=twin_error,
        is_recorded=is_recorded,
    )


def is_map(fit: EffectFit) -> bool:
    """Return whether a fit is a calibration, with nothing but the simulation's timing beside it."""
    maps = [e for e in fit.effects if e.prior_share > 0.0]
    return bool(maps) and all(e in maps or e.nuisance for e in fit.effects)


def measure_gap(result: EffectSearchResult) -> GapSize:
    """Return the size of the gap on the fitted recordings, without the noise that was measured."""
    evidence = result.evidence
    noise_N = noise_floor_N(evidence.traces)
    timing = [f.composition for f in result.alone if f.effects[0].nuisance][:1]
    above = [gap_N(evidence.traces, forces, noise_N) for forces in (evidence.alone, *map(evidence.forces, timing))]
    is_known = all(t.measured_noise.known for t in evidence.traces)
    logged_N = noise_floor_N(evidence.traces, as_logged=True)
    return GapSize(above[0], min(above), logged_N, is_known, own_error_N(evidence.traces))


def tolerance_N(noise_N: float, force_N: float, share: float | None) -> float:
    """Return the gap [N] that counts as none: a `share` of the RMS force, by default small beside force and noise."""
    if share is None:
        return min(VerdictLimits.TOLERANCE * force_N, EvidenceLimits.VISIBLE * noise_N)
    return share * force_N


def twin_error_energy(evidence: Evidence, plants: Sequence[Plant], fit: EffectFit) -> float:
    """Return the whitened energy that the twin's error may leave behind the right effects; 0 if none is used.

    Only effects that run the simulation again are uncertain by it: at the recorded inputs the force is known.
    """
    rows = zip(plants, evidence.traces, evidence.alone, strict=True)
    error = evidence.whiten([p.error_with_effects(fit.composition, t, a) for p, t, a in rows])
    return float(error @ error)


def compute_figures(result: EffectSearchResult, before: Ceiling, after: Ceiling) -> VerdictFigures:
    """Return the figures; the learner was fitted to the gap `before` and `after` the best explanation."""
    evidence, best, baseline = result.evidence, result.best, result.baseline_residual
    timing = [f for f in result.alone if f.effects[0].nuisance and f.cost < baseline @ baseline]
    if timing and not (best is not None and timing[0].names[0] in best.names):  # corrected: no part of the gap
        baseline = timing[0].left_out
    residual = best.left_out if best is not None else baseline
    gain = compute_paired_gain(evidence, baseline, residual)
    learnt = result.baseline_residual - evidence.whiten(before.learnt.crossfitted)
    ceiling = compute_paired_gain(evidence, baseline, learnt)
    learnable = compute_paired_gain(evidence, residual, residual - evidence.whiten(after.learnt.crossfitted))
    left = float(residual @ residual) - len(residual)
    return VerdictFigures(
        energy=(float(baseline @ baseline) - len(baseline)) / len(baseline),
        gain_z=max(gain.z, EvidenceLimits.CLEAR_Z * gain.energy / len(residual)) if best is not None else 0.0,
        ceiling_z=ceiling.z,
        unexplained=left / result.gap_energy,
        learnable=learnable.energy / result.gap_energy,
        stuck=count_stuck_parameters(best) if best is not None else 0,
    )


def timing_notes(result: EffectSearchResult, judgement: Judgement) -> tuple[str, ...]:
    """Return a note on the simulation's timing where it is all or a part of the gap."""
    best = () if result.best is None else result.best.composition.settings
    fits = [f.composition.settings[0] for f in result.alone if f.effects[0].nuisance]
    settings = [s for s in best if s.effect.nuisance] or (fits if judgement.reason == Within.TIMING else [])
    if not settings:
        return ()
    skew, spread = settings[0].values
    side, how = "early" if skew > 0.0 else "late", "less" if spread > 0.0 else "more"
    return (
        f"timing: the simulated force comes {abs(skew):.2f} samples {side} and is {how} smoothed than the measured one "
        f"(by {abs(spread):.2f} samples²), as by a filter, logging or resampling",
    )


def bound_notes(composition: Composition, estimates: Sequence[Sequence[Estimate]]) -> tuple[str, ...]:
    """Return a note on each parameter at a bound, and on each outside the usual range of dampers."""
    notes = []
    for setting, of_effect in zip(composition.settings, estimates, strict=True):
        if setting.effect.nuisance or setting.effect.prior_share > 0.0:  # no physics
            continue
        for p, estimate in zip(setting.effect.parameters, of_effect, strict=True):
            low, high = p.usual or (p.low, p.high)
            name, value = f"{setting.name}: {p.name}", estimate.value
            if estimate.at_bound:
                side = "more" if value - p.low > p.high - value else "less"
                notes.append(f"{name} is at its bound of {value:.3g}: read it as {value:.3g} or {side}")
            elif not low <= value <= high:
                notes.append(f"{name} of {value:.3g} is outside the usual range of dampers, {low:g} to {high:g}")
    return tuple(notes)
