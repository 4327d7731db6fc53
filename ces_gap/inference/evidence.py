"""The evidence: whitened residuals of all recordings, in which the uncertainty of the baseline error is marginalised.

The baseline error is a dictionary Φ with weights w ~ N(ŵ, Σ) learned from references. Its mean is part of the plant.
Its uncertainty is integrated out: a residual of covariance σ²I + ΦΣΦᵀ is multiplied by the inverse root of that matrix,
separately for each unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F
from ces_gap.baseline.learner import (
    Ceiling,
    LearnedCorrection,
    NoiseModel,
    learn_ceiling,
    learn_correction,
    make_white_noise,
)
from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition
from ces_gap.grid import count_through, rms
from ces_gap.inputs.prepare import DiagnosisInput
from ces_gap.limits import EvidenceLimits, NoiseLimits
from ces_gap.trace import Trace, noise_floor_N, own_error_N, usable_values
from ces_observer.errors import CesError

UNITS = 4  # the data are divided into at least as many parts, each left out once
MIN_MODE_VARIANCE = 0.01  # of the noise's: a direction of the baseline error with less variance is ignored


@dataclass(frozen=True)
class EvidenceUnit:
    """A part of one trace that is left out as a whole: its ticks (r,) and the block (r,) of each.

    Along each of the `directions` (r, m), the share `removed_shares` (m,) of a signal is removed.
    """

    trace: int
    ticks: NDArray[np.int64]
    directions: F
    removed_shares: F
    block: NDArray[np.int64]

    def project(self, whitened: F) -> F:
        """Return the rows of values (n,) or (n, k) that are whitened by the noise, without the baseline error."""
        rows = whitened[self.ticks]
        if not len(self.removed_shares):
            return rows
        shares = self.removed_shares if rows.ndim == 1 else self.removed_shares[:, None]
        return rows - self.directions @ (shares * (self.directions.T @ rows))


@dataclass(frozen=True)
class Evidence:
    """Traces with the plant's force on each, the noise, and the units; whitened rows are in the order of the units."""

    traces: tuple[Trace, ...]
    plants: tuple[Plant, ...]  # the plant prepared for each trace
    alone: tuple[F, ...]
    noise: NoiseModel
    units: tuple[EvidenceUnit, ...]

    def forces(self, composition: Composition) -> list[F]:
        """Return the force [N] with the effects around the plant, on each trace; NaN if the simulation refuses them."""
        rows = zip(self.plants, self.traces, self.alone, strict=True)
        try:
            return [plant.with_effects(composition, trace, alone) for plant, trace, alone in rows]
        except CesError:
            return [np.full(len(trace), np.nan) for trace in self.traces]

    def whiten(self, values: Sequence[F]) -> F:
        """Return the whitened rows of values (n,) or (n, k) on each trace's grid."""
        whitened = [self.noise.whiten(v) for v in values]
        return np.concatenate([unit.project(whitened[unit.trace]) for unit in self.units])

    def residual(self, forces: Sequence[F]) -> F:
        """Return the whitened rows of measured force minus `forces`, each (n,) or (n, k)."""
        rows = zip(self.traces, forces, strict=True)
        return self.whiten([(trace.force - force.T).T for trace, force in rows])

    @property
    def unit_of_row(self) -> NDArray[np.int64]:
        """The unit of each whitened row."""
        return np.repeat(np.arange(len(self.units)), [len(u.ticks) for u in self.units])

    @property
    def block_of_row(self) -> NDArray[np.int64]:
        """The block of each whitened row, numbered through all units."""
        return np.concatenate(count_through([unit.block for unit in self.units]))


def gather(
    traces: Sequence[Trace], plant: Plant, noise: NoiseModel, features: Sequence[F] = (), covariance: F | None = None
) -> Evidence:
    """Return the evidence of some traces.

    `features` (n, q) describe the baseline error on each trace, `covariance` (q, q) is that of their weights [N²]; None
    without references: nothing is removed.
    """
    plants = tuple(plant.prepare_for(trace) for trace in traces)
    alone = tuple(plant.alone(trace) for trace in traces)
    parts = 1 if len(traces) >= UNITS else -(-UNITS // len(traces))
    units = []
    for number, trace in enumerate(traces):
        ticks = np.flatnonzero(noise.usable_after_whitening(trace.usable))
        rows = np.zeros((len(trace), 0)) if covariance is None else noise.whiten(features[number])
        for part in np.array_split(ticks, parts):
            directions, shares = _directions(rows[part], covariance)
            number_of_tick = (part / (EvidenceLimits.BLOCK_S * trace.rate_Hz)).astype(np.int64)
            block = np.unique(number_of_tick, return_inverse=True)[1]
            units.append(EvidenceUnit(number, part, directions, shares, block))
    return Evidence(tuple(traces), plants, alone, noise, tuple(units))


def _directions(rows: F, covariance: F | None) -> tuple[F, F]:
    """Return orthonormal directions (r, m) of the baseline error and the share to remove along each."""
    if covariance is None:
        return rows, np.zeros(0)
    values, vectors = np.linalg.eigh(covariance)
    spread = rows @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    variance, turn = np.linalg.eigh(spread.T @ spread)
    keep = variance > MIN_MODE_VARIANCE
    directions = spread @ (turn[:, keep] / np.sqrt(variance[keep]))
    return directions, 1.0 - 1.0 / np.sqrt(1.0 + variance[keep])


@dataclass(frozen=True)
class Baseline:
    """The plant without effects, its evidence, and the generic learner fitted to the gap (`ceiling`).

    `plant` is the fast simulation with the `correction` learned from references (None without references).
    `unseen_error_N` is the RMS error to expect at most on other recordings: the largest of n references, times 1 + 1/n;
    without references, what the simulation says of itself.
    """

    plant: Plant
    correction: LearnedCorrection | None
    evidence: Evidence
    ceiling: Ceiling
    unseen_error_N: float = 0.0


def least_noise_N(traces: Sequence[Trace]) -> float:
    """Return the RMS [N] that counts as noise: as measured, but not below the numerical error of simulations."""
    numerical_N = NoiseLimits.NUMERICAL_ERROR * rms(usable_values(traces, [t.force for t in traces]))
    return max(noise_floor_N(traces), numerical_N, NoiseLimits.MIN_N)


def learn_baseline(inputs: DiagnosisInput) -> Baseline:
    """Return the baseline learned from references; without any, the simulation is taken as it is.

    The noise is then white: what else the force contains is to be explained.
    """
    if not inputs.reference:
        ceiling = learn_ceiling(inputs.real, [t.simulated for t in inputs.real])
        noise = make_white_noise(least_noise_N(inputs.real))
        plant = Plant(inputs.cheap, twin=inputs.twin)
        return Baseline(plant, None, gather(inputs.real, plant, noise), ceiling, own_error_N(inputs.real))
    correction, learnt = learn_correction(inputs.reference)
    features = [correction.dictionary.features(t, t.inputs, t.simulated) for t in inputs.real]
    plant = Plant(inputs.cheap, correction, inputs.twin)
    evidence = gather(inputs.real, plant, learnt.noise, features, learnt.covariance)
    rows = zip(inputs.reference, learnt.crossfitted, strict=True)
    left = np.array([rms((t.force - t.simulated - learned)[t.usable]) for t, learned in rows])
    unseen_N = (1.0 + 1.0 / len(left)) * learnt.noise.rms_N * float(left.max()) / max(rms(left), NoiseLimits.MIN_N)
    return Baseline(plant, correction, evidence, learn_ceiling(evidence.traces, evidence.alone), unseen_N)
