"""A planned case into a plant, the effects withheld in it at their planned size, and a simulation at its planned error.

Not every draw can be had: a road may never reach the bump stop, however stiff. Then the case is drawn again, with
another plant, shape and drive, and in the end with another effect of the same kind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ces_rig.blind.excitation import Commands, draw_drive
from ces_rig.blind.plan import BlindCase
from ces_rig.dampers.effects import WithheldEffect, with_severity
from ces_rig.errors import RigError
from ces_rig.experiment import Truth
from ces_rig.sensors import Sensors
from ces_rig.withheld.plants import (
    BlindPlant,
    available_effects,
    draw_effect,
    draw_plant,
    simulate_expected,
    simulate_signals,
)
from ces_rig.withheld.scaling import perturb_to_gap, scale_to_gap, search_size

Array = NDArray[np.float64]

NOISE_N = Sensors().force.noise  # [N] RMS
REAL, REFERENCE, HELD_OUT = ("r1", "r2"), ("f1", "f2"), ("h1",)
TRIES = 3
SEARCH_S = 4.0  # [s] of a recording in which sizes are searched
TOLERANCE = 0.1  # of the gap
FAIR = 0.4  # of the gap, that each recording must show


@dataclass(frozen=True)
class IdealRecording:
    """A recording before noise: `true` is what ideal sensors see, `effect_N` (n,) what the effects add to the force."""

    true: Truth
    effect_N: Array


@dataclass(frozen=True)
class DrawnCase:
    """A case as drawn: `withheld` in the plant, and `simulated`, a plant with wrong numbers; `recordings` and the seed
    of the sensors' noise by recording."""

    case: BlindCase
    plant: BlindPlant
    withheld: tuple[WithheldEffect, ...]
    simulated: BlindPlant
    recordings: Mapping[str, IdealRecording]
    seeds: Mapping[str, int]


def draw_case(case: BlindCase, seconds: float, spare_effects: Sequence[tuple[str, ...]] = ()) -> DrawnCase:
    """Return the case as its seed draws it; raises RigError if neither it nor one with `spare_effects` is possible."""
    reason = ""
    subjects = (case.effects, *spare_effects)
    for attempt in range(TRIES * len(subjects)):
        tried = replace(case, effects=subjects[attempt // TRIES])
        try:
            return _try_draw(tried, seconds, np.random.default_rng([case.seed, attempt]))
        except RigError as error:
            reason = str(error)
    raise RigError(f"case {case.number} ({case.kind}, {case.excitation}): cannot be had; the last try said: {reason}")


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def _try_draw(case: BlindCase, seconds: float, rng: Generator) -> DrawnCase:
    kind = _choose_plant_kind(case, rng)
    plant = draw_plant(kind, rng)
    drive = draw_drive(case.excitation, plant.current_A, rng)
    seeds = {role: int(rng.integers(2**31)) for role in (*REAL, *REFERENCE, *HELD_OUT)}
    commands = {role: drive.commands(seconds, seed) for role, seed in seeds.items()}
    shapes = [draw_effect(kind, name, rng) for name in case.effects]
    target = case.gap_to_noise * NOISE_N
    free = {role: EffectFreeRecording.from_commands(plant, c) for role, c in commands.items()}
    withheld, seen = _size_effects(plant, shapes, target, {role: free[role] for role in REAL})
    seen |= {role: sense_with_effects(free[role], withheld) for role in HELD_OUT}
    _require_fair(seen, target if shapes else 0.0)
    seen |= {role: sense_with_effects(free[role], ()) for role in REFERENCE}
    simulated = _perturb_by(plant, case.baseline_ratio * target, commands[REAL[0]], int(rng.integers(2**31)))
    return DrawnCase(case, plant, withheld, simulated, seen, seeds)


@dataclass(frozen=True)
class EffectFreeRecording:
    """A recording of the plant without effects: what is seen, and the force [N] (n,) expected for what was sensed."""

    plant: BlindPlant
    commands: Commands
    true: Truth
    force_N: Array

    @classmethod
    def from_commands(cls, plant: BlindPlant, commands: Commands) -> EffectFreeRecording:
        """Run the plant."""
        true = simulate_signals(plant, (), commands.time_s, commands.stroke_m, commands.command_A)
        return cls(plant, commands, true, simulate_expected(plant, true))


def sense_with_effects(free: EffectFreeRecording, effects: Sequence[WithheldEffect]) -> IdealRecording:
    """Return what ideal sensors see of the plant with the effects, and what the effects add for what was sensed."""
    if not effects:
        return IdealRecording(free.true, np.zeros_like(free.force_N))
    c = free.commands
    true = simulate_signals(free.plant, effects, c.time_s, c.stroke_m, c.command_A)
    same = np.array_equal(true.stroke_m, free.true.stroke_m) and np.array_equal(true.coil_A, free.true.coil_A)
    return IdealRecording(true, true.force_N - (free.force_N if same else simulate_expected(free.plant, true)))


def _require_fair(seen: Mapping[str, IdealRecording], target_N: float) -> None:
    """Raise RigError if a recording hardly shows the effects that are judged on it."""
    least = min(rms(s.effect_N) for s in seen.values())
    if least < FAIR * target_N:
        raise RigError(f"a recording shows {least:.3g} N of effects of {target_N:.3g} N")


def _choose_plant_kind(case: BlindCase, rng: Generator) -> str:
    able = [kind for kind in case.plants if set(case.effects) <= set(available_effects(kind))]
    if not able:
        raise RigError(f"none of the plants {', '.join(case.plants)} can have {' and '.join(case.effects)}")
    return able[int(rng.integers(len(able)))]


def _size_effects(
    plant: BlindPlant, shapes: Sequence[WithheldEffect], target_N: float, free: Mapping[str, EffectFreeRecording]
) -> tuple[tuple[WithheldEffect, ...], dict[str, IdealRecording]]:
    """Return the effects so large that together they make a gap of `target_N` (RMS over all recordings), and what is
    seen. Each is sized alone in a short part; if all of it is off by more than `TOLERANCE`, a common factor is sought.
    Raises RigError if none is found.
    """
    start = free[REAL[0]].commands.around_peak(SEARCH_S)
    each = target_N / max(1, len(shapes)) ** 0.5
    sized = tuple(_size_alone(plant, shape, each, start) for shape in shapes)
    tried: list[SizingTrial] = []

    def gap(factor: float) -> float:
        effects = tuple(with_severity(w, factor * w.severity) for w in sized)
        seen = {role: sense_with_effects(f, effects) for role, f in free.items()}
        reached = rms(np.concatenate([s.effect_N for s in seen.values()]))
        tried.append(SizingTrial(abs(reached - target_N), effects, seen))
        return reached

    if sized and abs(gap(1.0) - target_N) > TOLERANCE * target_N:
        with suppress(RigError):  # it wants to be closer than need be
            search_size(gap, target_N, "")
    best = (
        min(tried, key=lambda one: one.off_N)
        if sized
        else SizingTrial(0.0, (), {r: sense_with_effects(f, ()) for r, f in free.items()})
    )
    if best.off_N > TOLERANCE * target_N:
        names = " and ".join(shape.name for shape in shapes)
        raise RigError(f"{names}: {best.off_N:.3g} N off a gap of {target_N:.3g} N at best")
    return best.effects, best.recordings


@dataclass(frozen=True)
class SizingTrial:
    """Effects of some size, what is seen of them, and by how much [N] their gap is off."""

    off_N: float
    effects: tuple[WithheldEffect, ...]
    recordings: dict[str, IdealRecording]


def _size_alone(plant: BlindPlant, shape: WithheldEffect, target_N: float, commands: Commands) -> WithheldEffect:
    """Return the effect so large that it makes the gap here; as it was drawn if no size does, for it may elsewhere."""
    try:
        return scale_to_gap(plant, shape, target_N, commands.time_s, commands.stroke_m, commands.command_A)
    except RigError:
        return shape


def _perturb_by(plant: BlindPlant, target_N: float, commands: Commands, seed: int) -> BlindPlant:
    """Return the plant with numbers so wrong that its force is off by `target_N` (RMS)."""
    if target_N == 0.0:
        return plant
    start = commands.around_peak(SEARCH_S)
    return perturb_to_gap(plant, target_N, seed, start.time_s, start.stroke_m, start.command_A)[0]
