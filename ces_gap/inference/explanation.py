"""Explanations: the parameters of fitted effects with intervals, and the gap that they leave on held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F
from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.effects.effect import Composition, EffectParameter
from ces_gap.grid import number_blocks
from ces_gap.inference.fit import NEAR_BOUND, EffectFit, bounds, column_norms
from ces_gap.trace import Trace

Interval = tuple[float, float]


@dataclass(frozen=True)
class Estimate:
    """A parameter's value with its 95 % interval (SI); `at_bound` if it is on a bound, `drifts` if folds disagree."""

    name: str
    value: float
    ci95: Interval
    at_bound: bool = False
    drifts: bool = False


@dataclass(frozen=True)
class Explanation:
    """One or several effects, with gap and shrink on held-out recordings, without measurement noise."""

    effects: tuple[str, ...]
    forms: tuple[str, ...]
    composition: Composition
    estimates: tuple[tuple[Estimate, ...], ...]  # by effect
    gap_after_N: float
    shrink: float
    shrink_ci95: Interval
    gain: float = 0.0  # cross-fitted share of the gap's energy explained on the fitted recordings
    gain_error: float = 0.0
    probability: float = 0.0


BLOCK_S = 0.5  # [s]
RESAMPLES = 500
MIN_SHOWN_SHARE = 0.05  # of the gap's energy


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
        shown = begun > MIN_SHOWN_SHARE * before.sum()
        shrinks = _compute_shrink(begun[shown], ended[shown]) if shown.any() else np.zeros(1)
        low, high = np.percentile(shrinks, [2.5, 97.5])
        return float(_compute_shrink(before.sum(), after.sum())), (float(low), float(high))


def cut_into_blocks(traces: Sequence[Trace], seed: int, max_noise_N: float = np.inf) -> Blocks:
    """Return the blocks of held-out recordings, whose noise is limited to `max_noise_N` RMS [N].

    The noise estimated from a recording's highest frequencies is only an upper bound: the damper may contribute to it.
    """
    number = number_blocks([t.time_s for t in traces], BLOCK_S)
    count = int(number[-1][-1]) + 1
    ticks = sum(np.bincount(n, t.usable.astype(np.float64), count) for t, n in zip(traces, number, strict=True))
    noise = sum(
        np.bincount(n, t.usable * min(t.noise_N, max_noise_N) ** 2, count) for t, n in zip(traces, number, strict=True)
    )
    resamples = np.random.default_rng(seed).integers(0, count, (RESAMPLES, count))
    return Blocks(tuple(traces), np.asarray(ticks), np.asarray(noise), tuple(number), resamples)


def _compute_shrink(before: F | np.float64, after: F | np.float64) -> F:
    """Return 1 - sqrt(after / before), 0 without a gap before."""
    is_gap = np.asarray(before) > 0.0
    return np.asarray(np.where(is_gap, 1.0 - _root(after) / _root(np.where(is_gap, before, 1.0)), 0.0))


def _root(energy: F | np.float64) -> F:
    return np.asarray(np.sqrt(np.maximum(energy, 0.0)))


DRIFT = 4.0  # standard errors: units that disagree by more make a parameter drift
Z95 = 1.96
MISFIT_ALIGNED = 0.25


@dataclass(frozen=True)
class HeldOutScorer:
    """Held-out recordings in `blocks`, with plants prepared for each: `quick` and `exact` ones."""

    blocks: Blocks
    quick: tuple[Plant, ...]
    exact: tuple[Plant, ...]
    alone: tuple[F, ...]  # the plant's force on each held-out trace
    before: F  # energy in each block of the gap of the original simulation

    def forces(self, fit: EffectFit, exact: bool) -> tuple[F, ...]:
        """Return the force [N] with the effects of a fit on each held-out trace."""
        plants = self.exact if exact or not fit.composition.reruns else self.quick
        rows = zip(plants, self.blocks.traces, self.alone, strict=True)
        return tuple(plant.with_effects(fit.composition, trace, alone) for plant, trace, alone in rows)

    def explain(self, fit: EffectFit | None = None, forces: Sequence[F] | None = None) -> Explanation:
        """Return the explanation by a fit whose `forces` [N] are known; by no effect, after the correction, if None."""
        after = self.blocks.energy(self.alone if forces is None else forces)
        score = self.blocks.rms(after)[0], *self.blocks.shrink(self.before, after)
        if fit is None:
            return Explanation((), (), Composition(), (), *score)
        return Explanation(
            fit.names, tuple(e.form for e in fit.effects), fit.composition, estimate_parameters(fit), *score
        )


def build_scorer(blocks: Blocks, plant: Plant, exact: TraceSimulator) -> HeldOutScorer:
    """Return the scorer of held-out blocks for a plant; `exact` is the simulation with which effects rerun exactly."""
    quick = tuple(plant.prepare_for(t) for t in blocks.traces)
    best = tuple(replace(plant, simulation=exact).prepare_for(t) for t in blocks.traces)
    alone = tuple(plant.alone(t) for t in blocks.traces)
    return HeldOutScorer(blocks, quick, best, alone, blocks.energy([t.simulated_as_logged for t in blocks.traces]))


def estimate_parameters(fit: EffectFit) -> tuple[tuple[Estimate, ...], ...]:
    """Return the parameters of each effect with intervals in SI units."""
    low, high = bounds(fit.effects)
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0) + _misfit_variance(fit))
    rows = zip(fit.searched.tolist(), errors.tolist(), low, high, _unit_disagreement(fit), strict=True)
    return tuple(tuple(_estimate(p, *next(rows)) for p in effect.parameters) for effect in fit.effects)


def _misfit_variance(fit: EffectFit) -> F:
    """Return the variance (p,) that the rest of the gap adds to the parameters.

    What the effects leave beyond the noise is no noise: errors of forms and simulation are the same in every block. A
    share of their RMS, `MISFIT_ALIGNED`, is assumed to lie along each parameter's signature, where no residual shows it
    (Brynjarsdottir and O'Hagan 2014).
    """
    left = max(float(fit.residual @ fit.residual) - len(fit.residual), 0.0)
    size = column_norms(fit.jacobian)
    scaled = fit.jacobian / size
    unit = np.diag(np.linalg.pinv(scaled.T @ scaled, rcond=1e-9)) / size**2
    return np.asarray(MISFIT_ALIGNED**2 * left * np.maximum(unit, 0.0))


def count_stuck_parameters(fit: EffectFit) -> int:
    """Return how many parameters are on a bound other than their neutral value."""
    return sum(e.at_bound for effect in estimate_parameters(fit) for e in effect)


def measure_parameter_drift(fit: EffectFit) -> float:
    """Return the largest disagreement between units on a parameter, in standard errors."""
    spread = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-30))
    return float(np.max(_unit_disagreement(fit) / spread)) if len(spread) else 0.0


def _unit_disagreement(fit: EffectFit) -> F:
    return np.asarray(np.abs(fit.by_unit - fit.searched).max(axis=0) * np.sqrt(max(len(fit.by_unit) - 1, 1)))


def _estimate(
    parameter: EffectParameter, searched: float, error: float, low: float, high: float, disagreement: float
) -> Estimate:
    ends = sorted(parameter.to_value(searched + sign * Z95 * error) for sign in (-1.0, 1.0))
    near = NEAR_BOUND * (high - low)
    neutral = parameter.to_search(parameter.neutral) if parameter.scale != "log" else np.nan
    at_bound = bool((searched - low < near or high - searched < near) and not abs(searched - neutral) < near)
    drifts = bool(disagreement > DRIFT * max(error, 1e-12))
    return Estimate(parameter.name, parameter.to_value(searched), (ends[0], ends[1]), at_bound, drifts)
