"""The static map: smooth in stroke, speed and current; effects inside it are reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from engine_plant import NOISE_N, SIMULATION, F, traced
from example_effects import Spring

from ces_gap.baseline.noise import make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.inference.evidence import gather
from ces_gap.inference.fit import fit_alone
from ces_gap.inference.static_map import find_absorbed_effects, static_features
from ces_gap.trace import Trace, TraceInputs

PLANT = Plant(DirectSimulator(SIMULATION))


class Chirps(Effect):
    """A force of elapsed time, which no map of stroke, speed and current holds."""

    name, form = "chirps", "time"
    parameters = (EffectParameter("size_N", 0.0, 300.0, (20.0,), "size", magnitude=True),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] * np.sin(20.0 * trace.time_s**1.2))


@pytest.mark.parametrize("constant", [None, 0.6])
def test_the_map_is_of_order_one_and_finite(constant: float | None) -> None:
    traces = [traced(seed=s, constant_A=constant) for s in (1, 2)]
    features = static_features(traces)
    assert [len(x) for x in features] == [len(t) for t in traces]
    together = np.concatenate([x[t.usable] for x, t in zip(features, traces, strict=True)])
    assert np.isfinite(together).all() and np.sqrt(np.mean(together**2, axis=0)).max() < 10.0
    assert np.linalg.matrix_rank(together) == together.shape[1]


def test_a_constant_current_has_no_columns() -> None:
    counts = [static_features([traced(constant_A=c)])[0].shape[1] for c in (None, 0.6)]
    assert counts[0] > counts[1] >= 5


@pytest.mark.parametrize("constant", [None, 0.6])
def test_a_wrong_calibration_is_projected_out_and_what_is_not_static_stays(constant: float | None) -> None:
    traces = [traced(seed=s, constant_A=constant) for s in (1, 2)]
    evidence = gather(traces, PLANT, make_white_noise(NOISE_N), static_features(traces), None)
    v, x = (np.array([getattr(t.inputs, n) for t in traces]) for n in ("speed", "position"))
    smooth = evidence.whiten([30.0 + 2000.0 * a + 300.0 * b for a, b in zip(x, v, strict=True)])
    assert np.abs(smooth).max() < 1e-6
    by_time = [20.0 * np.sin(90.0 * t.time_s**1.2) for t in traces]
    left = evidence.whiten(by_time)
    whole = np.concatenate([evidence.noise.whiten(by_time[u.trace])[u.ticks] for u in evidence.units])
    assert left @ left > 0.9 * (whole @ whole)


def test_effects_inside_the_map_are_reported() -> None:
    rng = np.random.default_rng(1)
    both = Composition((Setting(Spring(), (3000.0,)), Setting(Chirps(), (40.0,))))
    traces = [traced(seed=s) for s in (1, 2)]
    real = [replace(t, force=PLANT.with_effects(both, t) + NOISE_N * rng.standard_normal(len(t))) for t in traces]
    evidence = gather(real, PLANT, make_white_noise(NOISE_N), static_features(real), None)
    fits = [fit_alone(evidence, effect) for effect in (Spring(), Chirps())]
    assert fits[0].searched[0] > 0.0 and fits[1].searched[0] > 30.0
    assert find_absorbed_effects(evidence, fits) == ("spring",)
