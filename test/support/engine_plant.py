"""A cheap damper in memory with planted truths, for tests of the diagnosis' engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from made_recordings import recording_of

from ces_data.arrays import F
from ces_data.recording import Channel, Recording
from ces_gap.inference.judgement import OddsWeights
from ces_gap.trace import Trace, open_trace
from ces_identify.simulations.simulation import FunctionSimulation

Truth = Callable[[F, F, F], F]  # time [s], position [m], current [A] -> force [N], each (n,)

RATE_HZ = 500.0
NOISE_N = 8.0
WEIGHTS = OddsWeights((-2.0, 1.5, 2.5), (3.0, 2.5, 3.0, 0.5), 3.0, 0.5, 0.5)  # plain ones, none of the package's


def damper(time_s: F, position_m: F, current_A: F) -> F:
    """Yield force and viscosity, both grown by the current; softer in compression."""
    speed = np.gradient(position_m, time_s)
    force = (200.0 + 700.0 * current_A) * np.tanh(speed / 0.06) + (300.0 + 500.0 * current_A) * speed
    return np.asarray(np.where(speed > 0.0, 0.7, 1.0) * force)


SIMULATION = FunctionSimulation("damper", damper)


@lru_cache(maxsize=100)
def recorded(truth: Truth = damper, seed: int = 1, seconds: float = 8.0, constant_A: float | None = None) -> Recording:
    """A random stroke of a few hertz, a stepping current (or a constant one), the truth's force in white noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    position = np.zeros_like(time)
    for frequency in rng.uniform(0.3, 6.0, 12):
        position += 0.01 / frequency**0.7 * np.sin(2.0 * np.pi * (frequency * time + rng.random()))
    level = rng.choice([0.1, 0.4, 0.8, 1.2], int(seconds / 0.5) + 1)[(time / 0.5).astype(int)]
    current = level if constant_A is None else np.full_like(time, constant_A)
    force = truth(time, position, current) + NOISE_N * rng.standard_normal(len(time))
    return recording_of(time, f"made{seed}", position=position, current=current, force=force)


@lru_cache(maxsize=100)
def traced(truth: Truth = damper, seed: int = 1, seconds: float = 8.0, constant_A: float | None = None) -> Trace:
    """The same as a trace beside the damper's simulation."""
    return open_trace(SIMULATION, recorded(truth, seed, seconds, constant_A))


def add_predictions(recording: Recording) -> Recording:
    """Return the recording with the damper's predictions as a channel, as a bag with a simulator's topic has them."""
    channel = Channel("sim_force", "N", recording.channel("position").stamps_ns, SIMULATION.force(recording))
    return replace(recording, channels={**recording.channels, "sim_force": channel})
