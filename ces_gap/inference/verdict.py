"""The first verdict: the size of the gap, figures and probabilities from the search, on the parts left out.

`held_out.review` and `refit.weigh_refits` may weaken it afterwards; `pipeline.diagnose` calls all three.

The figures are comparable between plants. The probabilities come from a logistic model of them. It was calibrated on
cases of a plant unlike those of its evaluation (`calibration.json` names them). Likelihoods would not do as
probabilities: no form is exactly true.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F
from ces_gap.baseline.learner import Ceiling, learn_ceiling
from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.grid import rms
from ces_gap.inference.evidence import Baseline, Evidence
from ces_gap.inference.fit import EffectFit, count_stuck_parameters, measure_parameter_drift
from ces_gap.inference.search import (
    NEGLIGIBLE_SHARE,
    EffectSearchResult,
    compute_paired_gain,
    find_absorbed_effects,
    interchangeable_effects,
    min_unexplained_shares,
)
from ces_gap.trace import noise_floor_N, usable_values

NAMED, AMBIGUOUS, UNKNOWN, NO_GAP = "named", "ambiguous", "unknown", "no_gap"
POSSIBLE = 0.1  # probability at which an effect outside the composition makes the verdict ambiguous
CALIBRATION, TIMING = "calibration", "simulation_timing"
TOLERANCE_SHARE = 0.01  # of the RMS force: a smaller gap is none, unless the user asks for another tolerance
TOLERANCE_NOISES = 2.0  # times the noise: limit of that default, so that a gap clear of the noise is not overlooked
WITHIN_TOLERANCE, WITHIN_NOISE, WITHIN_TIMING, WITHIN_BASELINE = "tolerance", "noise", "timing", "baseline_error"
CLEAR = 1.5  # times noise and tolerance: a smaller gap is not named without references
MAX_MAP_REST = 0.2  # of the gap's energy: a smooth map absorbs a part of anything, so it must explain most to be named
CLEAR_Z = 20.0  # z of a gain as large as the noise, in however few blocks


@dataclass(frozen=True)
class GapSize:
    """The gap on the fitted recordings, RMS [N]: without noise, and after the simulation's timing was fitted as well.

    `noise_N` was measured, `force_N` is the RMS of the measured force; `corrected` if references taught a correction.
    """

    gap_N: float
    timed_N: float
    noise_N: float
    force_N: float
    corrected: bool


def measure_gap(baseline: Baseline, result: EffectSearchResult, rest_N: float) -> GapSize:
    """Return the size of the gap on the fitted recordings; noise that was not measured is at most the `rest_N` [N]."""
    evidence = result.evidence
    forces, noise_N = [t.force for t in evidence.traces], noise_floor_N(evidence.traces)
    if not all(t.measured_noise.known for t in evidence.traces):
        noise_N = max(noise_N, rest_N)
    timing = [f.composition for f in result.alone if f.effects[0].nuisance][:1]
    above = []
    for modelled in (evidence.alone, *map(evidence.forces, timing)):
        errors = [force - f for force, f in zip(forces, modelled, strict=True)]
        above.append(float(np.sqrt(max(rms(usable_values(evidence.traces, errors)) ** 2 - noise_N**2, 0.0))))
    force_N = rms(usable_values(evidence.traces, forces))
    return GapSize(above[0], min(above), noise_N, force_N, baseline.correction is not None)


def tolerance_N(size: GapSize, share: float | None) -> float:
    """Return the gap [N] that counts as none: a `share` of the RMS force, by default small beside force and noise."""
    if share is not None:
        return share * size.force_N
    return min(TOLERANCE_SHARE * size.force_N, TOLERANCE_NOISES * size.noise_N)


def find_no_gap_reason(size: GapSize, improbable: bool, limit_N: float) -> str:
    """Return why there is no gap, "" if there is one; `improbable` if the figures speak against one.

    Without references a gap larger than the noise is never called none, whatever the figures say.
    """
    if size.gap_N <= limit_N:
        return WITHIN_TOLERANCE
    if improbable and size.corrected:
        return WITHIN_BASELINE
    if improbable and size.timed_N <= size.noise_N:
        return WITHIN_NOISE if size.gap_N <= size.noise_N else WITHIN_TIMING
    return ""


def is_clear_of_the_simulation(size: GapSize, limit_N: float) -> bool:
    """True if a gap may be named: without references, a small one may be the simulation's own error."""
    return size.corrected or size.gap_N > CLEAR * max(size.noise_N, limit_N)


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
    tolerance_N: float
    absorbed: tuple[str, ...]


def decide(
    baseline: Baseline,
    result: EffectSearchResult,
    simulation: TraceSimulator,
    weights: Calibration,
    tolerance: float | None = None,
) -> Decision:
    """Return the decision; `simulation` reruns the best explanation, `tolerance` is the user's (share of the force)."""
    evidence, rest = result.evidence, baseline.ceiling
    plants = [Plant(simulation, baseline.correction).prepare_for(t) for t in evidence.traces]
    if result.best is not None:  # the generic learner, fitted to the rest of the best explanation
        rows = zip(plants, evidence.traces, evidence.alone, strict=True)
        composition = result.best.composition
        rest = learn_ceiling(evidence.traces, [plant.with_effects(composition, t, a) for plant, t, a in rows])

    def allowance(fit: EffectFit) -> float:
        return surrogate_energy(evidence, plants, fit)

    figures = compute_figures(result, baseline.ceiling, rest, 0.0 if result.best is None else allowance(result.best))
    names = result.best.names if result.best is not None else ()
    odds = probabilities(figures, min_unexplained_shares(result), names, weights)
    groups = interchangeable_effects(result, allowance)
    size = measure_gap(baseline, result, rest.learnt.noise.rms_N)
    limit_N = tolerance_N(size, tolerance)
    reason = find_no_gap_reason(size, odds.none > 1.0 - weights.least_gap, limit_N)
    verdict = NO_GAP if reason else choose_verdict(result, figures, odds, bool(groups), weights)
    absorbed = find_absorbed_effects(result)
    causes = [] if result.best is None else [e.name for e in result.best.effects if not e.nuisance]
    may_be_simulation = len(causes) > 1 and not set(causes).isdisjoint(absorbed)  # a recalibration would absorb it
    if verdict == NAMED and (may_be_simulation or not is_clear_of_the_simulation(size, limit_N)):
        verdict = AMBIGUOUS
    rest_N = rest.learnt.noise.rms_N
    return Decision(verdict, reason, figures, odds, groups, rest_N, evidence.noise.rms_N, limit_N, absorbed)


def surrogate_energy(evidence: Evidence, plants: Sequence[Plant], fit: EffectFit) -> float:
    """Return the whitened energy that a surrogate's error may leave behind the right effects; 0 if none is used.

    Only effects that run the simulation again are uncertain by it: at the recorded inputs the force is known.
    """
    rows = zip(plants, evidence.traces, evidence.alone, strict=True)
    error = evidence.whiten([p.error_with_effects(fit.composition, t, a) for p, t, a in rows])
    return float(error @ error)


def compute_figures(
    result: EffectSearchResult, before: Ceiling, after: Ceiling, allowance: float = 0.0
) -> VerdictFigures:
    """Return the figures; the learner was fitted to the gap `before` and `after` the best explanation.

    Up to the `allowance`, a whitened energy, what the best explanation leaves is the error of a surrogate.
    """
    evidence, best, baseline = result.evidence, result.best, result.baseline_residual
    timing = [f for f in result.alone if f.effects[0].nuisance and f.cost < baseline @ baseline]
    if timing:  # the simulation's timing is not a part of the gap where correcting it is a gain
        baseline = timing[0].left_out
    residual = best.left_out if best is not None else baseline
    gain = compute_paired_gain(evidence, baseline, residual)
    learnt = result.baseline_residual - evidence.whiten(before.learnt.crossfitted)
    ceiling = compute_paired_gain(evidence, baseline, learnt)
    rest = compute_paired_gain(evidence, residual, residual - evidence.whiten(after.learnt.crossfitted))
    left = float(residual @ residual) - len(residual)
    return VerdictFigures(
        energy=(float(baseline @ baseline) - len(baseline)) / len(baseline),
        gain_z=max(gain.z, CLEAR_Z * gain.energy / len(residual)) if best is not None else 0.0,
        ceiling_z=ceiling.z,
        unexplained=(left - min(allowance, max(left, 0.0))) / result.gap_energy,
        learnable=rest.energy / result.gap_energy,
        learnable_z=rest.z,
        stuck=count_stuck_parameters(best) if best is not None else 0,
        drift=measure_parameter_drift(best) if best is not None else 0.0,
    )


def choose_verdict(
    result: EffectSearchResult, figures: VerdictFigures, odds: Probabilities, replaceable: bool, weights: Calibration
) -> str:
    """Return the verdict on a gap; `replaceable` if an effect of the best explanation has an alternative."""
    if result.best is None or all(e.nuisance for e in result.best.effects):
        return UNKNOWN
    is_map = all(e.nuisance or e.prior_share > 0.0 for e in result.best.effects)
    is_improbable = odds.unknown > (1.0 - odds.none) * (1.0 - weights.least_known)
    if is_improbable or (is_map and figures.unexplained > MAX_MAP_REST):
        return UNKNOWN
    return AMBIGUOUS if replaceable or has_alternatives(result.best.names, odds) else NAMED


def name_by_simpler_rules(result: EffectSearchResult) -> dict[str, str]:
    """Return the effects that simpler rules would name, for comparison in blind tests."""
    n, none = len(result.baseline_residual), result.baseline_residual
    bic = min(result.alone, key=lambda f: n * np.log(f.residual @ f.residual) + len(f.searched) * np.log(n))
    flexible = max(result.alone, key=lambda f: (len(f.searched), -f.cost))

    def correlation(signature: NDArray[np.float64]) -> float:
        return float(abs(signature @ none) / max(float(np.linalg.norm(signature) * np.linalg.norm(none)), 1e-12))

    similar = max(result.alone, key=lambda f: correlation(none - f.residual))
    return {"signature_correlation": similar.names[0], "bic": bic.names[0], "most_flexible": flexible.names[0]}


def timing_notes(result: EffectSearchResult, decision: Decision) -> tuple[str, ...]:
    """Return a note on the simulation's timing where it is all or a part of the gap."""
    best = () if result.best is None else result.best.composition.settings
    fits = [f.composition.settings[0] for f in result.alone if f.effects[0].nuisance]
    found = [s for s in best if s.effect.nuisance] or (fits if decision.no_gap_reason == WITHIN_TIMING else [])
    if not found:
        return ()
    skew, spread = found[0].values
    side, how = "early" if skew > 0.0 else "late", "less" if spread > 0.0 else "more"
    return (
        f"timing: the simulated force comes {abs(skew):.2f} samples {side} and is {how} smoothed than the measured one "
        f"(by {abs(spread):.2f} samples²): an error of logging or resampling",
    )


@dataclass(frozen=True)
class VerdictFigures:
    """The basis of the verdict: whitened energies on units left out, as shares of the gap's energy above the noise.

    `energy` is the gap's energy over the noise's. `gain_z` and `ceiling_z` are the gains of the best explanation and of
    the generic learner over their standard errors. `unexplained` is the share that the best explanation leaves,
    `learnable` the part of it that the learner explains (equal if the noise is unknown), `learnable_z` over its
    standard error. `stuck` counts parameters on a bound; `drift` is the largest disagreement between units on a
    parameter, in standard errors.
    """

    energy: float
    gain_z: float
    ceiling_z: float
    unexplained: float
    learnable: float
    learnable_z: float
    stuck: int
    drift: float


@dataclass(frozen=True)
class Calibration:
    """Weights of the logistic model for `gap_features` and `unknown_features`, and `sharpness` of the choice of effect.

    The verdict is "no_gap" if the probability of a gap is below `least_gap`, "unknown" if that of a known effect is
    below `least_known`.
    """

    gap: tuple[float, ...]
    unknown: tuple[float, ...]
    sharpness: float
    least_gap: float
    least_known: float


@dataclass(frozen=True)
class Probabilities:
    """Probabilities of no gap, of an unknown cause and of each effect by name; they sum to 1."""

    none: float
    unknown: float
    effects: Mapping[str, float]


def calibration(mode: str = "references") -> Calibration:
    """Return the weights of a mode from `calibration.json`.

    Modes are "references" and "no_references" for a simulation that is run, "predictions" for recorded ones, and
    "identified" for a model identified from the references.
    """
    weights = json.loads((files("ces_gap.inference") / "calibration.json").read_text(encoding="utf-8"))[mode]
    gap, unknown = (tuple(map(float, weights[name])) for name in ("gap", "unknown"))
    return Calibration(gap, unknown, *(float(weights[name]) for name in ("sharpness", "least_gap", "least_known")))


def gap_features(figures: VerdictFigures) -> F:
    """Return the features of the probability of a gap."""
    z = max(figures.gain_z, figures.ceiling_z, figures.energy, 0.1)  # a large gap needs no explanation
    return np.array([1.0, np.log(max(figures.energy, 1e-3)), np.log(z)])


def unknown_features(figures: VerdictFigures) -> F:
    """Return the features of the probability of an unknown cause."""
    share = float(np.clip(figures.unexplained, NEGLIGIBLE_SHARE, 2.0))
    return np.array([1.0, np.log(share), float(np.clip(figures.learnable, 0.0, 1.0)), float(figures.stuck > 0)])


def probabilities(
    figures: VerdictFigures, unexplained: Mapping[str, float], composition: Sequence[str], weights: Calibration
) -> Probabilities:
    """Return the probabilities from the share that each effect leaves unexplained (`min_unexplained_shares`).

    The effects of the best `composition` count as leaving what the composition leaves.
    """
    none = 1.0 - _logistic(gap_features(figures) @ np.array(weights.gap))
    unknown = (1.0 - none) * _logistic(unknown_features(figures) @ np.array(weights.unknown))
    names = list(unexplained)
    left = np.log(np.maximum(np.array([unexplained[n] for n in names]), 0.0) + NEGLIGIBLE_SHARE)
    left[[n in composition for n in names]] = min(np.log(max(figures.unexplained, 0.0) + NEGLIGIBLE_SHARE), left.min())
    share = np.exp(-weights.sharpness * (left - left.min()))
    share *= (1.0 - none - unknown) / share.sum()
    return Probabilities(none, unknown, dict(zip(names, share.tolist(), strict=True)))


def has_alternatives(named: Sequence[str], odds: Probabilities) -> bool:
    """True if an effect that is not named is possible, too.

    A recalibration can absorb a part of any effect; an effect that explains as much with less stands against it.
    """
    return any(p >= POSSIBLE for name, p in odds.effects.items() if name not in (*named, CALIBRATION))


def _logistic(value: float) -> float:
    return float(1.0 / (1.0 + np.exp(-np.clip(value, -50.0, 50.0))))
