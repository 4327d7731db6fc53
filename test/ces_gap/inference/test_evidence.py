"""Whitened evidence: equal to the dense inverse root, white noise, every tick in exactly one unit."""

from __future__ import annotations

import numpy as np
import pytest
from engine_plant import SIMULATION, damper, traced
from gap_traces import ar, ar_noise

from ces_data.arrays import F
from ces_gap.baseline.learner import NoiseModel, make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.inference import evidence as evidence_module
from ces_gap.inference.evidence import gather
from ces_gap.trace import Trace, TraceInputs

PLANT = Plant(DirectSimulator(SIMULATION))
TRACES = [traced(seed=1, seconds=1.6), traced(seed=2, seconds=1.6)]


def draw_values(seed: int, columns: int) -> list[F]:
    rng = np.random.default_rng(seed)
    return [rng.standard_normal((len(t), columns)) for t in TRACES]


def covariance_of(size: int, seed: int = 3) -> F:
    root = np.random.default_rng(seed).standard_normal((size, size))
    return 4.0 * root @ root.T


def inverse_root(matrix: F) -> F:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors / np.sqrt(values)) @ vectors.T


@pytest.mark.parametrize("noise", [make_white_noise(8.0), ar(8.0, 0.8)], ids=["white", "coloured"])
def test_marginalising_is_the_dense_inverse_root(noise: NoiseModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evidence_module, "MIN_MODE_VARIANCE", 0.0)
    features, covariance = draw_values(1, 5), covariance_of(5)
    values = draw_values(2, 2)
    evidence = gather(TRACES, PLANT, noise, features, covariance)
    whitened = evidence.whiten(values)
    expected = []
    for unit in evidence.units:
        spread = evidence.noise.whiten(features[unit.trace])[unit.ticks] @ np.linalg.cholesky(covariance)
        rows = evidence.noise.whiten(values[unit.trace])[unit.ticks]
        expected.append(inverse_root(np.eye(len(rows)) + spread @ spread.T) @ rows)
    np.testing.assert_allclose(whitened, np.concatenate(expected), atol=1e-9)


def test_noise_and_baseline_error_as_expected_become_white_with_unit_variance() -> None:
    rng = np.random.default_rng(7)
    noise, features, covariance = ar(8.0, 0.8), draw_values(1, 5), covariance_of(5)
    evidence = gather(TRACES, PLANT, noise, features, covariance)
    squares = []
    for _ in range(60):
        weights = [np.linalg.cholesky(covariance) @ rng.standard_normal(5) for _ in evidence.units]
        for unit, w in zip(evidence.units, weights, strict=True):
            error = features[unit.trace] @ w + ar_noise(len(features[unit.trace]), 8.0, 0.8, rng)
            rows = unit.project(evidence.noise.whiten(error))
            squares.append(float(rows @ rows) / len(rows))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("count", [1, 2])
def test_units_hold_every_clean_tick_once(count: int) -> None:
    noise = ar(8.0, 0.5)
    evidence = gather(TRACES[:count], PLANT, noise, draw_values(1, 3)[:count], covariance_of(3))
    assert len(evidence.units) >= 4
    for number, trace in enumerate(evidence.traces):
        ticks = np.concatenate([u.ticks for u in evidence.units if u.trace == number])
        np.testing.assert_array_equal(
            np.sort(ticks), np.flatnonzero(evidence.noise.usable_after_whitening(trace.usable))
        )
    assert np.bincount(evidence.unit_of_row).tolist() == [len(u.ticks) for u in evidence.units]


class ConstantCorrection:
    """A correction of 7 N."""

    def force(self, trace: Trace, inputs: TraceInputs, simulated: F) -> F:
        return np.full_like(simulated, 7.0)


def test_the_correction_is_in_the_plants_own_force() -> None:
    evidence = gather(
        TRACES, Plant(DirectSimulator(SIMULATION), ConstantCorrection()), make_white_noise(8.0), draw_values(1, 3), None
    )
    for trace, alone in zip(evidence.traces, evidence.alone, strict=True):
        np.testing.assert_allclose(alone, trace.simulated + 7.0)
        np.testing.assert_allclose(trace.simulated[trace.usable], damper_on(trace)[trace.usable], atol=15.0)


def damper_on(trace: Trace) -> F:
    return damper(trace.time_s, trace.inputs.position, trace.inputs.current)
