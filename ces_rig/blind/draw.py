"""Draws a planned case: a plant, withheld effects of the planned size, and a simulation with the planned error.

Not every draw is possible: a road may never reach the bump stop, however stiff it is. The case is then drawn again with
another plant, shape and drive, and finally with another effect of the same kind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from operator import itemgetter

import numpy as np

from ces_data.arrays import F
from ces_rig.blind.plan import BlindCase, Commands, draw_drive
from ces_rig.dampers.effects import WithheldEffect
from ces_rig.dampers.model import DamperModel
from ces_rig.errors import RigError
from ces_rig.sensors import Sensors, Truth
from ces_rig.withheld import plants

NOISE_N = Sensors().force.noise  # [N] RMS
REAL, REFERENCE, HELD_OUT = ("r1", "r2"), ("f1", "f2", "f3", "f4", "f5"), ("h1",)
ATTEMPTS = 3  # per set of effects
SEARCH_S = 4.0  # [s] length of the part of a recording on which sizes are searched
TOLERANCE = 0.1  # of the gap
MIN_SHARE = 0.4  # of the planned gap, in every recording


@dataclass(frozen=True)
class IdealRecording:
    """A recording before noise: the true signals, and `effect_N` (n,), the force that the effects add."""

    true: Truth
    effect_N: F


@dataclass(frozen=True)
class DrawnCase:
    """A drawn case: plant, withheld effects, `simulated` with wrong numbers; recordings and noise `seeds` by name."""

    case: BlindCase
    plant_name: str
    plant: DamperModel
    withheld: tuple[WithheldEffect, ...]
    simulated: DamperModel
    recordings: Mapping[str, IdealRecording]
    seeds: Mapping[str, int]


def draw_case(case: BlindCase, seconds: float, spare_effects: Sequence[tuple[str, ...]] = ()) -> DrawnCase:
    """Return the case that its seed draws; raises RigError if it is impossible, with `spare_effects` as well."""
    reason = ""
    choices = (case.effects, *spare_effects)
    for attempt in range(ATTEMPTS * len(choices)):
        try:
            return _try_draw(replace(case, effects=choices[attempt // ATTEMPTS]), seconds, attempt)
        except RigError as error:
            reason = str(error)
    raise RigError(f"case {case.number} ({case.kind}, {case.excitation}): cannot be drawn; last attempt: {reason}")


def _try_draw(case: BlindCase, seconds: float, attempt: int) -> DrawnCase:
    rng = np.random.default_rng([case.seed, attempt])
    designs = case.plants.items()
    suitable = [name for name, plant in designs if set(case.effects) <= set(plants.available_effects(plant.kind))]
    if not suitable:
        raise RigError(f"none of the plants {', '.join(case.plants)} can have {' and '.join(case.effects)}")
    name = suitable[int(rng.integers(len(suitable)))]
    plant = plants.draw_plant(case.plants[name].kind, rng, case.plants[name])
    drive = draw_drive(case.excitation, plant.current_A, rng)
    seeds = {role: int(rng.integers(2**31)) for role in (*REAL, *REFERENCE, *HELD_OUT)}
    commands = {role: drive.commands(seconds, seed) for role, seed in seeds.items()}
    shapes = [plants.draw_effect(plant.kind, effect, rng) for effect in case.effects]
    target = case.gap_to_noise * NOISE_N
    free = {role: EffectFreeRecording.from_commands(plant, c) for role, c in commands.items()}
    withheld, recordings = _size_effects(plant, shapes, target, {role: free[role] for role in REAL})
    recordings |= {role: sense_with_effects(free[role], withheld) for role in HELD_OUT}
    smallest = min(plants.rms(r.effect_N) for r in recordings.values())
    if shapes and smallest < MIN_SHARE * target:
        raise RigError(f"the effects make only {smallest:.3g} N of {target:.3g} N in one recording")
    recordings |= {role: sense_with_effects(free[role], ()) for role in REFERENCE}
    simulated, seed, error_N = plant, int(rng.integers(2**31)), case.baseline_ratio * target
    if error_N > 0.0:
        part = commands[REAL[0]].around_peak(SEARCH_S)
        simulated, _ = plants.perturb_to_gap(plant, error_N, seed, part.time_s, part.stroke_m, part.command_A)
    return DrawnCase(case, name, plant, withheld, simulated, recordings, seeds)


@dataclass(frozen=True)
class EffectFreeRecording:
    """A recording of the plant without effects: the true signals, and the force [N] (n,) expected from them."""

    plant: DamperModel
    commands: Commands
    true: Truth
    force_N: F

    @classmethod
    def from_commands(cls, plant: DamperModel, commands: Commands) -> EffectFreeRecording:
        """Run the plant."""
        true = plants.simulate_signals(plant, (), commands.time_s, commands.stroke_m, commands.command_A)
        return cls(plant, commands, true, plants.simulate_expected(plant, true))


def sense_with_effects(free: EffectFreeRecording, effects: Sequence[WithheldEffect]) -> IdealRecording:
    """Return the ideal recording of the plant with the effects."""
    if not effects:
        return IdealRecording(free.true, np.zeros_like(free.force_N))
    c = free.commands
    true = plants.simulate_signals(free.plant, effects, c.time_s, c.stroke_m, c.command_A)
    same = np.array_equal(true.stroke_m, free.true.stroke_m) and np.array_equal(true.coil_A, free.true.coil_A)
    return IdealRecording(true, true.force_N - (free.force_N if same else plants.simulate_expected(free.plant, true)))


def _size_effects(
    plant: DamperModel, shapes: Sequence[WithheldEffect], target_N: float, free: Mapping[str, EffectFreeRecording]
) -> tuple[tuple[WithheldEffect, ...], dict[str, IdealRecording]]:
    """Return the effects scaled to a common gap of `target_N` (RMS over all recordings), and the recordings with them.

    Each effect is first scaled alone on a short part. If the gap of all is then off by more than `TOLERANCE`, a common
    factor is searched. Raises RigError if no factor fits.
    """
    if not shapes:
        return (), {role: sense_with_effects(f, ()) for role, f in free.items()}
    part, share_N = free[REAL[0]].commands.around_peak(SEARCH_S), target_N / len(shapes) ** 0.5
    scaled = list(shapes)  # an effect stays as drawn if no severity makes its share in this part
    for k, shape in enumerate(shapes):
        with suppress(RigError):
            scaled[k] = plants.scale_to_gap(plant, shape, share_N, part.time_s, part.stroke_m, part.command_A)
    trials: list[tuple[float, tuple[WithheldEffect, ...], dict[str, IdealRecording]]] = []

    @cache  # the search begins at the factor 1 again
    def gap(factor: float) -> float:
        effects = tuple(replace(w, severity=factor * w.severity) for w in scaled)
        recordings = {role: sense_with_effects(f, effects) for role, f in free.items()}
        size = plants.rms(np.concatenate([r.effect_N for r in recordings.values()]))
        trials.append((abs(size - target_N), effects, recordings))
        return size

    if abs(gap(1.0) - target_N) > TOLERANCE * target_N:
        with suppress(RigError):  # the search is stricter than `TOLERANCE`
            plants.search_size(gap, target_N, "")
    error_N, effects, recordings = min(trials, key=itemgetter(0))
    if error_N > TOLERANCE * target_N:
        names = " and ".join(shape.name for shape in shapes)
        raise RigError(f"{names}: at best {error_N:.3g} N off a gap of {target_N:.3g} N")
    return effects, recordings
