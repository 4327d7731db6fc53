"""Effects that a recalibration of the simulation would explain as well are reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from engine_plant import NOISE_N, SIMULATION, F, traced
from example_effects import Spring

from ces_gap.baseline.learner import make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.effects.simulation_errors import ForceMap
from ces_gap.inference.evidence import gather
from ces_gap.inference.fit import Refinement
from ces_gap.inference.search import EffectSearchResult, find_absorbed_effects, search
from ces_gap.trace import Trace, TraceInputs

PLANT = Plant(DirectSimulator(SIMULATION))


class Chirps(Effect):
    """A force of elapsed time, which no map of stroke, speed and current holds."""

    name, form = "chirps", "time"
    parameters = (EffectParameter("size_N", 0.0, 300.0, (20.0,), "size", magnitude=True),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] * np.sin(20.0 * trace.time_s**1.2))


def searched(*settings: Setting, effects: tuple[Effect, ...]) -> EffectSearchResult:
    rng = np.random.default_rng(1)
    traces = [traced(seed=s) for s in (1, 2)]
    forces = [PLANT.with_effects(Composition(settings), t) + NOISE_N * rng.standard_normal(len(t)) for t in traces]
    real = [replace(t, force=f) for t, f in zip(traces, forces, strict=True)]
    return search(gather(real, PLANT, make_white_noise(NOISE_N)), effects, Refinement(), 1)


def test_effects_inside_the_map_are_reported() -> None:
    both = Setting(Spring(), (3000.0,)), Setting(Chirps(), (40.0,))
    assert find_absorbed_effects(searched(*both, effects=(Spring(), Chirps(), ForceMap()))) == ("spring",)
    assert find_absorbed_effects(searched(*both, effects=(Spring(), Chirps()))) == ()


def test_an_effect_that_explains_as_much_as_the_map_stands_against_it() -> None:
    found = searched(Setting(Spring(), (3000.0,)), effects=(Spring(), Chirps(), ForceMap()))
    assert found.best is not None and found.best.names == ("spring",)


def test_a_map_that_explains_more_than_any_effect_is_the_cause() -> None:
    off = Setting(ForceMap(), (20.0, 300.0, 0.0, -400.0, 30.0, 1500.0, 0.0, 0.0))
    found = searched(off, effects=(Spring(), Chirps(), ForceMap()))
    assert found.best is not None and found.best.names == ("calibration",)
    assert found.best.composition.settings[0].values[0] == np.clip(found.best.searched[0], 17.0, 23.0)
