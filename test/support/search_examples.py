"""Effects, a plant and planted evidence for the tests of the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from engine_plant import NOISE_N, SIMULATION, traced
from example_effects import CurrentOffset, Friction, Spring

from ces_data.arrays import F
from ces_gap.baseline.learner import make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant, TraceSimulator
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.refinement import Refinement
from ces_gap.inference.search import EffectSearchResult, search
from ces_gap.trace import Trace, TraceInputs

PLANT = Plant(DirectSimulator(SIMULATION))


def clean() -> list[Trace]:
    return [traced(seed=s, seconds=4.0) for s in (1, 2)]


class Offset(Effect):
    """A constant."""

    name, form = "offset", "constant"
    parameters = (EffectParameter("offset_N", -500.0, 500.0, (10.0,), "offset", magnitude=True),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0])


class CubicSpring(Spring):
    """A richer form of the spring."""

    form = "cubic"
    parameters = (*Spring.parameters, EffectParameter("cubic_N_m3", 0.0, 1e9, (1e5,), "of the cube"))

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] * inputs.position + values[1] * inputs.position**3)


EFFECTS: tuple[Effect, ...] = (Offset(), Spring(), CubicSpring(), Friction(), CurrentOffset())
OFFSET, SPRING, FRICTION = Setting(Offset(), (30.0,)), Setting(Spring(), (2500.0,)), Setting(Friction(), (40.0, 0.05))


def planted(
    *effects: Setting,
    seed: int = 5,
    traces: Sequence[Trace] | None = None,
    noise_N: float = NOISE_N,
    simulator: TraceSimulator = PLANT.simulation,
) -> Evidence:
    """Return the evidence of effects around the damper in white noise, without baseline error."""
    rng = np.random.default_rng(seed)
    real = [
        replace(t, force=PLANT.with_effects(Composition(effects), t) + noise_N * rng.standard_normal(len(t)))
        for t in traces or clean()
    ]
    nothing = [np.zeros((len(t), 1)) for t in real]
    return gather(real, Plant(simulator), make_white_noise(noise_N), nothing, np.zeros((1, 1)))


def run_search(evidence: Evidence, threads: int = 1) -> EffectSearchResult:
    return search(evidence, EFFECTS, Refinement(), threads)
