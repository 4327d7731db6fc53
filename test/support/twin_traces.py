"""Traces of a known network, which is its own simulation and twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hydraulic_models import make_hydraulic
from made_recordings import recording_of
from physical_models import PLAIN_VALVE

from ces_gap.baseline.twin import STEP_S, Twin, count_steps, make_run
from ces_gap.trace import Trace, make_trace

SECONDS, RATE_HZ = 10.0, 500.0
MADE = Twin(make_hydraulic(PLAIN_VALVE, air=0.0), STEP_S, 10.0 / 3.0)


def traced(twin: Twin | None = MADE, seed: int = 1, current_A: float | None = None, moving: bool = True) -> Trace:
    """A random stroke, a current in steps unless it is given, and the twin's force as the simulated one."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    position = np.zeros_like(time)
    for frequency in rng.uniform(0.4, 6.0, 12) if moving else ():
        position += 0.006 / frequency**0.7 * np.sin(2.0 * np.pi * (frequency * time + rng.random()))
    current = rng.choice([0.1, 0.5, 0.9], 31)[(3.0 * time).astype(int)]
    current = current if current_A is None else np.full_like(time, current_A)
    made = recording_of(time, f"made{seed}", position=position, current=current, force=np.zeros_like(time))
    bare = make_trace(made, np.zeros_like(time))
    if twin is None:
        return bare
    base = make_run(twin, bare).force()[:: count_steps(bare)]
    return replace(bare, simulated=twin.prepare_for(bare).recorded_force, simulated_at_base=base)
