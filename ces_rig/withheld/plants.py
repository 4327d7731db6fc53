"""Plants for blind tests, and the signals that ideal sensors record of them with effects.

    plant = draw_plant("hydraulic", rng)
    effect = scale_to_gap(plant, draw_effect(plant.kind, "friction", rng), 40.0, time_s, stroke_m, command_A)
    true = simulate_signals(plant, [effect], time_s, stroke_m, command_A)  # then ces_rig.experiment.measure_signals
    yaml.safe_dump(perturb(plant, 0.3, rng).model.description())           # a simulation: ces_rig.simulation.load_rig

The plant itself has no effects; its description simulates it exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ces_rig.dampers.effects import EFFECTS, OUTSIDE, Proportions, WithheldEffect
from ces_rig.dampers.kinds import KINDS, DamperKind, DamperModel
from ces_rig.errors import RigError
from ces_rig.experiment import GRID_S, Truth
from ces_rig.withheld import sensing, surroundings

Array = NDArray[np.float64]
PLANTS = tuple(KINDS)


@dataclass(frozen=True)
class BlindPlant:
    """A drawn damper of a kind, without effects."""

    kind: str
    model: DamperModel

    @property
    def current_A(self) -> tuple[float, float]:
        """The working range [A] of the current, which commands should cover."""
        return self.model.current_A


def list_spreads(kind: str) -> dict[str, Proportions]:
    """Return the distributions of the proportions of every effect that this kind of plant can have, by effect."""
    return {**_require_kind(kind).spreads, **sensing.SPREADS, **surroundings.SPREADS}


def available_effects(kind: str) -> tuple[str, ...]:
    """Return the effects that this kind of plant can have, of the library and outside it."""
    spreads = list_spreads(kind)
    return tuple(name for name in EFFECTS + OUTSIDE if name in spreads)


def draw_plant(kind: str, rng: Generator) -> BlindPlant:
    """Return a drawn damper of the kind; raises RigError for a kind that is not in PLANTS."""
    return BlindPlant(kind, _require_kind(kind).draw_plant(rng))


def draw_effect(kind: str, name: str, rng: Generator) -> WithheldEffect:
    """Return the effect at severity 1 with drawn proportions; raises RigError if this kind of plant cannot have it."""
    spreads = list_spreads(kind)
    if name not in spreads:
        raise RigError(f"{kind} plant: no effect '{name}'; it can have {', '.join(available_effects(kind))}")
    return WithheldEffect(name, 1.0, {key: spread.draw(rng) for key, spread in spreads[name].items()})


def perturb(plant: BlindPlant, size: float, rng: Generator) -> BlindPlant:
    """Return the plant with several wrong parameters, by about 20 % each at size 1; size 0 changes nothing.

    Equal states of `rng` give equal directions of error, so that `size` can be searched.
    """
    wrong = KINDS[plant.kind].wrong
    factors = {paths: float(np.exp(size * deviation * rng.standard_normal())) for paths, deviation in wrong.items()}
    numbers = {path: f * plant.model.number(path) for paths, f in factors.items() for path in paths}
    return BlindPlant(plant.kind, plant.model.with_numbers(numbers))


def physical_numbers(plant: BlindPlant, withheld: WithheldEffect) -> dict[str, float]:
    """Return the true physical numbers of the effect: the numbers that it gives the plant, or the sensor."""
    if withheld.name in sensing.SENSING:
        return sensing.numbers(withheld, plant.current_A[1])
    if withheld.name in surroundings.SPREADS:
        return surroundings.numbers(withheld, plant.current_A[1])
    return KINDS[plant.kind].numbers(plant.model, withheld)


def simulate_signals(
    plant: BlindPlant, effects: Sequence[WithheldEffect], time_s: Array, stroke_m: Array, command_A: Array
) -> Truth:
    """Return the signals of ideal sensors; `time_s` is a grid of GRID_S, `stroke_m` the true stroke, all (n,).

    Effects inside the damper change its equations; those around it act while it runs, those of the sensors then in
    their order. Raises RigError if a
    number leaves its physical range, the stroke leaves the damper, or the grid is wrong.
    """
    if len(time_s) < 10 or not np.allclose(np.diff(time_s), GRID_S, rtol=0.0, atol=1e-9):
        raise RigError(f"plant: bad times; expected at least 10 times on a grid of {GRID_S:g} s")
    acting = [effect for effect in effects if effect.severity > 0.0]
    around = {e.name: physical_numbers(plant, e) for e in acting if e.name in surroundings.SPREADS}
    model = plant.model
    for effect in acting:
        if effect.name not in sensing.SENSING and effect.name not in around:
            model = model.with_numbers(KINDS[plant.kind].numbers(model, effect))
    if around:
        run = surroundings.run_surrounded(plant.kind, model, around, GRID_S, stroke_m, command_A)
    else:
        run = model.run(GRID_S, stroke_m, command_A)
    force, coil, temperature = run
    true = Truth(time_s, stroke_m, command_A, coil, force, temperature)
    for effect in acting:
        if effect.name in sensing.SENSING:
            true = sensing.SENSING[effect.name](true, physical_numbers(plant, effect))
    return true


def simulate_expected(plant: BlindPlant, true: Truth) -> Array:
    """Return the force [N] (n,) of the plant without effects, driven with the recorded position and coil current."""
    return plant.model.without_coil().run(GRID_S, true.stroke_m, true.coil_A)[0]


def gap_N(
    plant: BlindPlant, effects: Sequence[WithheldEffect], time_s: Array, stroke_m: Array, command_A: Array
) -> float:
    """Return the RMS [N] of the recorded force minus that of the plant without effects, driven with the recording."""
    free = simulate_signals(plant, (), time_s, stroke_m, command_A)
    return gap_from(plant, free, simulate_signals(plant, effects, time_s, stroke_m, command_A))


def gap_from(plant: BlindPlant, free: Truth, true: Truth) -> float:
    """Return `gap_N` of the signals `true`; the signals `free` without effects often save a simulation."""
    unmoved = np.array_equal(true.stroke_m, free.stroke_m) and np.array_equal(true.coil_A, free.coil_A)
    without = free.force_N if unmoved else simulate_expected(plant, true)
    return float(np.sqrt(np.mean((true.force_N - without) ** 2)))


def _require_kind(kind: str) -> DamperKind:
    if kind not in KINDS:
        raise RigError(f"plant kind '{kind}' is unknown; expected one of {', '.join(KINDS)}")
    return KINDS[kind]
