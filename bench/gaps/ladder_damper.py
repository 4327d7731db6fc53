"""A drawn damper for `smallest_gap.py`: its recordings when new, and with an effect scaled to a gap; rows and tables.

Plant, excitation and sensors are those of the blind tests (`ces_rig.blind`), with the rich excitation. The diagnoses
are rows of a file.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isfinite, nan
from operator import attrgetter
from pathlib import Path
from statistics import median

import numpy as np

from bench.markdown import markdown
from ces_data.recording import Recording
from ces_gap.diagnosis import NO_GAP
from ces_rig.blind.cases import SENSORS
from ces_rig.blind.draw import NOISE_N, EffectFreeRecording, sense_with_effects
from ces_rig.blind.plan import RICH, draw_drive
from ces_rig.dampers.effects import WithheldEffect
from ces_rig.dampers.model import DamperModel
from ces_rig.sensors import measure_signals
from ces_rig.withheld.plants import available_effects, draw_effect, draw_plant, rms, scale_to_gap

IDENTIFY, REFERENCE, REAL, HELD_OUT = ("i1", "i2"), ("f1", "f2"), ("r1", "r2"), ("h1",)
EXTRA_REAL = (("n1", "n2"), ("n3", "n4"))  # pairs without an effect, for false alarms
NEW_S, REAL_S = 20.0, 10.0  # [s] of a recording to identify on or a reference, and of the others
SIZING_S = 4.0  # [s] length of the part of the first real recording on which severities are searched
GAPS_N = tuple(2.0 * 2.0 ** (0.5 * k) for k in range(14))  # [N] rungs of the ladder, a factor of 1.41 apart
POLYNOMIAL, AUTO, NONE = "polynomial", "auto", "none"
SIMULATIONS = (POLYNOMIAL, AUTO)


@dataclass(frozen=True)
class ChangedRecordings:
    """Real and held-out recordings with an effect; `gap_N` is the RMS of the force that it adds to the real ones."""

    real: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    gap_N: float


@dataclass(frozen=True)
class LadderDamper:
    """A plant with its effect-free recordings before noise, and the seeds of their noise, by name."""

    plant: DamperModel
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
        return [measure_signals(self.free[name].true, SENSORS, self.seeds[name], name) for name in names]

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
        logged = {name: measure_signals(one.true, SENSORS, self.seeds[name], name) for name, one in ideal.items()}
        gap = rms(np.concatenate([ideal[name].effect_N for name in REAL]))
        return ChangedRecordings(tuple(logged[n] for n in REAL), tuple(logged[n] for n in HELD_OUT), gap)

    def _scale(self, effect: WithheldEffect, target_N: float) -> WithheldEffect:
        part = self.free[REAL[0]].commands.around_peak(SIZING_S)
        return scale_to_gap(self.plant, effect, target_N, part.time_s, part.stroke_m, part.command_A)


@dataclass(frozen=True)
class LadderRow:
    """One diagnosis: damper, simulation and its structure, effect, rung and true gap [N], and what the diagnosis says.

    `error_N` is the RMS of the simulation's error on the references, `corrected_N` what the learned correction leaves.
    """

    damper: str
    simulation: str
    structure: str
    effect: str
    rung: int
    gap_N: float
    verdict: str
    first: str
    error_N: float
    corrected_N: float

    @property
    def finds_gap(self) -> bool:
        return self.verdict != NO_GAP

    @property
    def finds_effect(self) -> bool:
        """Whether the most probable cause of a gap that it sees is the right one."""
        return self.finds_gap and self.first == self.effect


class RowFile:
    """Rows in a file of JSON lines, read once and appended to."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = path.read_text("utf-8").splitlines() if path.exists() else []
        self.rows = [LadderRow(**json.loads(line)) for line in lines]

    def of(self, damper: str, simulation: str, effect: str) -> list[LadderRow]:
        """Return the rows of one ladder."""
        key = (damper, simulation, effect)
        return [row for row in self.rows if (row.damper, row.simulation, row.effect) == key]

    def append(self, row: LadderRow) -> None:
        self.rows.append(row)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(row)) + "\n")


FOUND = (attrgetter("finds_gap"), attrgetter("finds_effect"))


def smallest_N(rows: Sequence[LadderRow], passes: Callable[[LadderRow], bool]) -> float:
    """Return the smallest gap [N] of one ladder above which every tested gap passes.

    NaN if the largest fails, or if the rung below was not tested, as in an interrupted run.
    """
    rungs = {row.rung: row for row in rows}
    failed = max((rung for rung, row in rungs.items() if not passes(row)), default=-1)
    return rungs[failed + 1].gap_N if failed + 1 in rungs else nan


def tables(rows: Sequence[LadderRow]) -> str:
    """Return the Markdown tables: the smallest gaps of each ladder, their medians, and the errors of the models."""
    return "\n\n".join([_model_table(rows), _ladder_table(rows)])


def _model_table(rows: Sequence[LadderRow]) -> str:
    header = ("damper", "simulation", "its error on the references N", "left by the correction N", "false alarms")
    body = []
    for damper, simulation in sorted({(r.damper, r.simulation) for r in rows if r.effect == NONE}, reverse=True):
        same = [r for r in rows if (r.damper, r.simulation, r.effect) == (damper, simulation, NONE)]
        alarms = f"{sum(r.finds_gap for r in same)} of {len(same)}"
        named = f"{simulation} ({same[0].structure})"
        body.append((damper, named, f"{same[0].error_N:.1f}", f"{same[0].corrected_N:.1f}", alarms))
    return markdown([header, *body])


def _ladder_table(rows: Sequence[LadderRow]) -> str:
    """Return a row for each effect of each damper with both simulations, and the median ratios."""
    header = ["damper, effect"]
    for what in ("gap", "effect"):
        header += [f"{what} found from N: polynomial", AUTO, "ratio"]
    body: list[list[str]] = []
    ratios: list[list[float]] = [[], []]
    for damper, effect in sorted({(r.damper, r.effect) for r in rows if r.effect != NONE}):
        body.append([f"{damper}, {effect}"])
        for passes, found in zip(FOUND, ratios, strict=True):
            same = [r for r in rows if (r.damper, r.effect) == (damper, effect)]
            pair = [smallest_N([r for r in same if r.simulation == s], passes) for s in SIMULATIONS]
            share = pair[1] / pair[0]
            found.extend([share] if isfinite(share) else [])
            body[-1] += [*map(_format_gap, pair), f"{share:.2f}" if isfinite(share) else ""]
    medians = [f"{median(r):.2f} ({len(r)})" if r else "" for r in ratios]
    return markdown([header, *body, ["median ratio (of pairs)", "", "", medians[0], "", "", medians[1]]])


def _format_gap(gap_N: float) -> str:
    return f"{gap_N:.1f} ({gap_N / NOISE_N:.1f}×)" if isfinite(gap_N) else "not found"
