"""Effects, planted traces and fits for the tests of fitting."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from engine_plant import NOISE_N, SIMULATION, traced

from ces_gap.baseline.learner import make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.trace import Trace

PLANT = Plant(DirectSimulator(SIMULATION))


class Useless(Effect):
    """Changes nothing, whatever its parameter."""

    name, form = "useless", "none"
    parameters = (EffectParameter("nothing", 0.0, 1.0, (0.5,), "nothing"),)


@cache
def clean() -> tuple[Trace, ...]:
    return tuple(traced(seed=s, seconds=4.0) for s in (1, 2))


def planted(composition: Composition, noise_N: float = NOISE_N, seed: int = 5) -> Evidence:
    """Evidence of the plant with a composition, in white noise, without baseline error."""
    rng = np.random.default_rng(seed)
    traces = [
        replace(t, force=PLANT.with_effects(composition, t) + noise_N * rng.standard_normal(len(t))) for t in clean()
    ]
    return gather(traces, PLANT, make_white_noise(noise_N), [np.zeros((len(t), 1)) for t in traces], np.zeros((1, 1)))


def one(effect: Effect, *values: float) -> Composition:
    return Composition((Setting(effect, values),))
