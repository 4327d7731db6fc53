"""Plans of blind tests: a kind and a seed go in; stroke, current, a plant, effects and a simulation come out.

The excitation `rich` covers speeds, strokes and currents; `road` is a vehicle's stroke with a controller's current;
with `constant_current` the valve never moves. Not every draw is possible: a road may never reach the bump stop, however
stiff it is. The case is then drawn again with another plant, shape and drive, and finally with another effect of the
same kind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations
from operator import itemgetter
from typing import TypeVar

import numpy as np
from numpy.random import Generator
from scipy.signal import butter, sosfiltfilt

from ces_data.arrays import F
from ces_data.waveforms.currents import Binary, ConstantLevel, FilteredNoise, Prbs, StrokeFollowing
from ces_data.waveforms.strokes import Current, FrequencyModulated, NoiseStroke, RoadStroke, Shape, fade
from ces_rig.dampers.model import RigDamper, WithheldEffect
from ces_rig.errors import RigError
from ces_rig.sensors import GRID_S, Sensors, Truth
from ces_rig.withheld import plants

RICH, ROAD, CONSTANT = "rich", "road", "constant_current"
EXCITATIONS = (RICH, ROAD, CONSTANT)
REACH_M = (0.034, 0.046)  # [m] range of a case's largest stroke, below the bump stops of a sound damper
FADE_S = 0.4  # [s]
ACTUATOR_HZ = 30.0  # [Hz] bandwidth of the rig's actuator


@dataclass(frozen=True)
class Commands:
    """The commands of one recording on a uniform grid; arrays (n,)."""

    time_s: F
    stroke_m: F
    command_A: F

    def around_peak(self, seconds: float) -> Commands:
        """Return `seconds` of it around the largest stroke, or all if it is shorter."""
        count = min(round(seconds / GRID_S) + 1, len(self.time_s))
        first = min(max(int(np.argmax(np.abs(self.stroke_m))) - count // 2, 0), len(self.time_s) - count)
        part = slice(first, first + count)
        return Commands(self.time_s[:count], self.stroke_m[part], self.command_A[part])


@dataclass(frozen=True)
class Drive:
    """Stroke and current of a case; all recordings peak at `reach_m`: effects of large strokes appear in each."""

    shapes: tuple[Shape, ...]
    current: Current
    reach_m: float

    def commands(self, seconds: float, seed: int) -> Commands:
        """Return the commands of one recording; equal seeds give equal commands."""
        time = np.arange(round(seconds / GRID_S) + 1, dtype=np.float64) * GRID_S
        rng = np.random.default_rng([seed, 0])
        stroke = np.sum([shape.samples(time, rng) for shape in self.shapes], axis=0)
        stroke = sosfiltfilt(butter(4, ACTUATOR_HZ, fs=1.0 / GRID_S, output="sos"), stroke)
        stroke = stroke * fade(time, FADE_S)
        stroke *= self.reach_m / float(np.abs(stroke).max())
        return Commands(time, stroke, self.current.samples(time, stroke, np.random.default_rng([seed, 1])))


def draw_drive(kind: str, range_A: tuple[float, float], rng: Generator) -> Drive:
    """Return a drive of this kind with drawn settings and currents inside `range_A`."""
    shapes, current = _draw_parts(kind, *range_A, rng)
    return Drive(shapes, current, rng.uniform(*REACH_M))


def _draw_parts(kind: str, low: float, high: float, rng: Generator) -> tuple[tuple[Shape, ...], Current]:
    if kind == RICH:
        kinds: tuple[Current, ...] = (
            Binary(low, high, shortest_s=0.06, mean_s=rng.uniform(0.2, 0.5)),
            Prbs(low, high, hold_s=rng.uniform(0.08, 0.2)),
            FilteredNoise(low, high, cutoff_Hz=rng.uniform(2.0, 6.0)),
        )
        return _draw_two_noises(rng), kinds[int(rng.integers(len(kinds)))]
    if kind == ROAD:
        road = RoadStroke(road_class="CD"[int(rng.integers(2))], vehicle_m_s=rng.uniform(10.0, 22.0))
        if rng.random() < 0.5:
            return (road,), FilteredNoise(low, high, cutoff_Hz=rng.uniform(1.5, 5.0))
        return (road,), StrokeFollowing(low, high, stroke_m=rng.uniform(0.006, 0.016), lag_s=rng.uniform(0.005, 0.02))
    level = ConstantLevel(low + (high - low) * rng.uniform(0.1, 0.8))
    if rng.random() < 0.5:
        return _draw_two_noises(rng), level
    swept = FrequencyModulated(amplitude_m=rng.uniform(0.008, 0.014), low_Hz=1.0, high_Hz=rng.uniform(5.0, 9.0))
    slow = NoiseStroke(peak_to_peak_m=rng.uniform(0.020, 0.040), cutoff_Hz=1.5, order=4)
    return (swept, slow), level


def _draw_two_noises(rng: Generator) -> tuple[Shape, ...]:
    fast = NoiseStroke(peak_to_peak_m=rng.uniform(0.030, 0.050), cutoff_Hz=rng.uniform(8.0, 15.0))
    slow = NoiseStroke(peak_to_peak_m=rng.uniform(0.030, 0.050), cutoff_Hz=rng.uniform(1.0, 2.5), order=4)
    return fast, slow


T = TypeVar("T")

EFFECT, NONE, OUTSIDE, PAIR = "effect", "none", "outside", "pair"
KINDS = (EFFECT, NONE, OUTSIDE, PAIR)
GAPS = (4.0, 8.0, 12.0, 16.0)  # RMS of the effect's force over that of the force sensor's noise
ERRORS = (0.0, 1.0 / 3.0, 1.0)  # RMS of the simulation's own error over that of the effect's force
SHARES = {EFFECT: 0.60, NONE: 0.14, OUTSIDE: 0.12, PAIR: 0.14}  # of a sample
SPARE = 3  # sets of effects to draw from when those of a case cannot be drawn
INVISIBLE = {CONSTANT: frozenset({"valve_lag", "current_hysteresis", "current_crosstalk", "sticking_pilot"})}
"""Effects that have no influence under an excitation."""


@dataclass(frozen=True)
class BlindCase:
    """One case: none to two `effects`, `seed`; without an effect `gap_to_noise` sizes the simulation's error.

    `plants` are the designs by name around which its plant is drawn.
    """

    kind: str
    effects: tuple[str, ...]
    gap_to_noise: float
    baseline_ratio: float
    excitation: str
    plants: Mapping[str, RigDamper]
    number: int = 0
    seed: int = 0


@dataclass(frozen=True)
class Levels:
    """The levels that a plan combines: effects of the library and outside it, plants, kinds of case and so on."""

    effects: tuple[str, ...]
    outside: tuple[str, ...]
    plants: Mapping[str, RigDamper]
    kinds: tuple[str, ...] = KINDS
    gaps: tuple[float, ...] = GAPS
    errors: tuple[float, ...] = ERRORS
    excitations: tuple[str, ...] = EXCITATIONS


def plan_sample(levels: Levels, seed: int, count: int) -> list[BlindCase]:
    """Return `count` cases, shuffled: within each kind the numbers of cases per level differ by at most one."""
    rng = np.random.default_rng([seed, 1])
    cases = [
        case
        for kind, share in _share_out(levels.kinds, count).items()
        for case in _balance_levels(levels, kind, share, rng)
    ]
    return _number_cases(cases, seed, rng)


def list_spare_effects(case: BlindCase, levels: Levels) -> list[tuple[str, ...]]:
    """Return effects of the same kind, in random order, for the case that its own effects cannot be drawn."""
    rng = np.random.default_rng([case.seed, 3])
    others = [e for e in _list_effects(levels, case.kind, rng) if e != case.effects and is_visible(e, case.excitation)]
    return [others[i] for i in rng.permutation(len(others))[:SPARE]]


def is_visible(effects: Sequence[str], excitation: str) -> bool:
    """Return whether every effect has an influence under the excitation."""
    return not INVISIBLE.get(excitation, frozenset()) & set(effects)


def _balance_levels(levels: Levels, kind: str, count: int, rng: Generator) -> list[BlindCase]:
    """Return `count` cases; without an effect, half of the simulations are correct."""
    effects = _cycle_values(_list_effects(levels, kind, rng), count, rng)
    wrong = tuple(error for error in levels.errors if error > 0.0)
    ratios = (*wrong, *(0.0 for _ in wrong)) if kind == NONE and wrong else levels.errors
    gaps, errors = _cycle_values(levels.gaps, count, rng), _cycle_values(ratios, count, rng)
    excitations = _cycle_values(levels.excitations, count, rng)
    cases = [BlindCase(kind, *row, levels.plants) for row in zip(effects, gaps, errors, excitations, strict=True)]
    return [_make_visible(case, levels, rng) for case in cases]


def _make_visible(case: BlindCase, levels: Levels, rng: Generator) -> BlindCase:
    suitable = [e for e in levels.excitations if is_visible(case.effects, e)]
    if case.excitation in suitable:
        return case
    if not suitable:
        raise RigError(f"blind: {', '.join(case.effects)} cannot be seen under {', '.join(levels.excitations)}")
    return replace(case, excitation=suitable[int(rng.integers(len(suitable)))])


def _list_effects(levels: Levels, kind: str, rng: Generator) -> list[tuple[str, ...]]:
    """Return the effects that cases of this kind may withhold, pairs in random order."""
    if kind == NONE:
        return [()]
    if kind == PAIR:
        pairs = list(combinations(sorted(levels.effects), 2))
        return [pairs[i] for i in rng.permutation(len(pairs))]
    return [(name,) for name in (levels.effects if kind == EFFECT else levels.outside)]


def _cycle_values(values: Sequence[T], count: int, rng: Generator) -> list[T]:
    """Return `count` values: rounds through all of them, each in its own random order."""
    rounds = -(-count // max(1, len(values)))
    return [values[i] for _ in range(rounds) for i in rng.permutation(len(values))][:count]


def _share_out(kinds: Sequence[str], count: int) -> Mapping[str, int]:
    """Return the number of cases of each kind (largest remainder method)."""
    total = sum(SHARES[kind] for kind in kinds)
    exact = {kind: count * SHARES[kind] / total for kind in kinds}
    counts = {kind: int(share) for kind, share in exact.items()}
    for kind in sorted(kinds, key=lambda k: counts[k] - exact[k])[: count - sum(counts.values())]:
        counts[kind] += 1
    return counts


def _number_cases(cases: Sequence[BlindCase], seed: int, rng: Generator) -> list[BlindCase]:
    seeds = np.random.default_rng([seed, 2]).integers(2**62, size=len(cases))
    order = rng.permutation(len(cases))
    return [replace(cases[i], number=n + 1, seed=int(seeds[n])) for n, i in enumerate(order)]


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
    plant: RigDamper
    withheld: tuple[WithheldEffect, ...]
    simulated: RigDamper
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

    plant: RigDamper
    commands: Commands
    true: Truth
    force_N: F

    @classmethod
    def from_commands(cls, plant: RigDamper, commands: Commands) -> EffectFreeRecording:
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
    plant: RigDamper, shapes: Sequence[WithheldEffect], target_N: float, free: Mapping[str, EffectFreeRecording]
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
