"""A drawn damper for `smallest_gap.py`: its recordings when new, and with an effect scaled to a gap.

Plant, excitation and sensors are those of the blind tests (`ces_rig.blind`), with the rich excitation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.recordings.recording import Recording
from ces_rig.blind.case_folder import log_sensors
from ces_rig.blind.draw import EffectFreeRecording, sense_with_effects
from ces_rig.blind.excitation import RICH, draw_drive
from ces_rig.dampers.effects import WithheldEffect
from ces_rig.withheld.plants import BlindPlant, available_effects, draw_effect, draw_plant
from ces_rig.withheld.scaling import rms, scale_to_gap

IDENTIFY, REFERENCE, REAL, HELD_OUT = ("i1", "i2"), ("f1", "f2"), ("r1", "r2"), ("h1",)
EXTRA_REAL = (("n1", "n2"), ("n3", "n4"))  # pairs without an effect, for false alarms
NEW_S, REAL_S = 20.0, 10.0  # [s] of a recording to identify on or a reference, and of the others
SIZING_S = 4.0  # [s] length of the part of the first real recording on which severities are searched


@dataclass(frozen=True)
class ChangedRecordings:
    """Real and held-out recordings with an effect; `gap_N` is the RMS of the force that it adds to the real ones."""

    real: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    gap_N: float


@dataclass(frozen=True)
class LadderDamper:
    """A plant with its effect-free recordings before noise, and the seeds of their noise, by name."""

    plant: BlindPlant
    free: Mapping[str, EffectFreeRecording]
    seeds: Mapping[str, int]

    @classmethod
    def draw(cls, kind: str, seed: int, new_s: float = NEW_S, real_s: float = REAL_S) -> LadderDamper:
        """Return the damper that kind and seed draw, run without effects."""
        rng = np.random.default_rng([seed, len(kind)])
        plant = draw_plant(kind, rng)
        drive = draw_drive(RICH, plant.current_A, rng)
        extra = [name for pair in EXTRA_REAL for name in pair]
        lengths = dict.fromkeys((*IDENTIFY, *REFERENCE), new_s) | dict.fromkeys((*REAL, *HELD_OUT, *extra), real_s)
        seeds = {name: int(rng.integers(2**31)) for name in lengths}
        commands = {name: drive.commands(lengths[name], seed) for name, seed in seeds.items()}
        free = {name: EffectFreeRecording.from_commands(plant, c) for name, c in commands.items()}
        return cls(plant, free, seeds)

    def new(self, names: Sequence[str]) -> list[Recording]:
        """Return recordings of the damper without effects."""
        return [log_sensors(self.free[name].true, name, self.seeds[name]) for name in names]

    def has(self, effect: str) -> bool:
        """Return whether this kind of damper can have the effect."""
        return effect in available_effects(self.plant.kind)

    def draw_effect(self, name: str) -> WithheldEffect:
        """Return the effect with the proportions that this damper draws; the same at every call."""
        return draw_effect(self.plant.kind, name, np.random.default_rng([self.seeds["i1"], *name.encode()]))

    def without_effect(self, pair: int) -> ChangedRecordings:
        """Return recordings of the damper as new, in the place of changed ones: the real ones, or an extra pair."""
        real = (REAL, *EXTRA_REAL)[pair]
        return ChangedRecordings(tuple(self.new(real)), tuple(self.new(HELD_OUT)), 0.0)

    def with_effect(self, effect: WithheldEffect, target_N: float) -> ChangedRecordings:
        """Return the recordings with the effect scaled to a gap of `target_N`; raises RigError if no severity does.

        The gap of the whole recordings differs from that of the part on which the severity is searched.
        """
        scaled = self._scale(effect, target_N)
        ideal = {name: sense_with_effects(self.free[name], (scaled,)) for name in (*REAL, *HELD_OUT)}
        logged = {name: log_sensors(one.true, name, self.seeds[name]) for name, one in ideal.items()}
        gap = rms(np.concatenate([ideal[name].effect_N for name in REAL]))
        return ChangedRecordings(tuple(logged[n] for n in REAL), tuple(logged[n] for n in HELD_OUT), gap)

    def _scale(self, effect: WithheldEffect, target_N: float) -> WithheldEffect:
        part = self.free[REAL[0]].commands.around_peak(SIZING_S)
        return scale_to_gap(self.plant, effect, target_N, part.time_s, part.stroke_m, part.command_A)
