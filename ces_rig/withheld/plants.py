"""Plants for blind tests, and the signals that ideal sensors record of them with effects.

    plant = draw_plant("hydraulic", rng)
    effect = scale_to_gap(plant, draw_effect(plant.kind, "friction", rng), 40.0, time_s, stroke_m, command_A)
    true = simulate_signals(plant, [effect], time_s, stroke_m, command_A)  # then ces_rig.sensors.measure_signals
    yaml.safe_dump(perturb(plant, 0.3, rng).description())  # a simulation: ces_rig.experiments.virtual.load_rig

The plant itself has no effects; its description simulates it exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import exp, inf, log

import numpy as np
from numpy.random import Generator

from ces_data.arrays import F
from ces_rig.dampers.model import EFFECTS, OUTSIDE, DamperKind, Proportions, RigDamper, WithheldEffect
from ces_rig.dampers.stepper import KINDS, simulate
from ces_rig.errors import RigError
from ces_rig.sensors import GRID_S, Truth
from ces_rig.withheld import environment
from ces_rig.withheld.environment import SENSING, SURROUNDINGS

PLANTS = tuple(KINDS)


def list_spreads(kind: str) -> dict[str, Proportions]:
    """Return the distributions of the proportions of every effect that this kind of plant can have, by effect."""
    return {**_require_kind(kind).spreads, **environment.SPREADS}


def available_effects(kind: str) -> tuple[str, ...]:
    """Return the effects that this kind of plant can have, of the library and outside it."""
    spreads = list_spreads(kind)
    return tuple(name for name in EFFECTS + OUTSIDE if name in spreads)


def draw_plant(kind: str, rng: Generator, design: RigDamper | None = None) -> RigDamper:
    """Return a damper with log-normally drawn numbers around a `design`, by default that of the kind.

    Raises RigError for a kind not in PLANTS.
    """
    damper_kind = _require_kind(kind)
    middle = damper_kind.design if design is None else design
    factors = {path: float(np.exp(spread * rng.standard_normal())) for path, spread in damper_kind.varied.items()}
    return middle.with_numbers({path: f * middle.number(path) for path, f in factors.items()})


def draw_effect(kind: str, name: str, rng: Generator) -> WithheldEffect:
    """Return the effect at severity 1 with drawn proportions; raises RigError if this kind of plant cannot have it."""
    spreads = list_spreads(kind)
    if name not in spreads:
        raise RigError(f"{kind} plant: no effect '{name}'; it can have {', '.join(available_effects(kind))}")
    return WithheldEffect(name, 1.0, {key: spread.draw(rng) for key, spread in spreads[name].items()})


def perturb(plant: RigDamper, size: float, rng: Generator) -> RigDamper:
    """Return the plant with wrong numbers, by about 20 % at `size` 1; equal states of `rng` give equal directions."""
    wrong = KINDS[plant.kind].wrong
    factors = {paths: float(np.exp(size * deviation * rng.standard_normal())) for paths, deviation in wrong.items()}
    numbers = {path: f * plant.number(path) for paths, f in factors.items() for path in paths}
    return plant.with_numbers(numbers)


def physical_numbers(plant: RigDamper, withheld: WithheldEffect) -> dict[str, float]:
    """Return the true physical numbers of the effect: the numbers that it gives the plant, or the sensor."""
    if withheld.name in environment.SPREADS:
        return environment.numbers(withheld, plant.current_A[1])
    return KINDS[plant.kind].changes[withheld.name](plant.damper, withheld.severity, withheld.proportions)


def simulate_signals(
    plant: RigDamper, effects: Sequence[WithheldEffect], time_s: F, stroke_m: F, command_A: F
) -> Truth:
    """Return the signals of ideal sensors; `time_s` is a grid of GRID_S, `stroke_m` the true stroke, all (n,).

    Effects inside the damper change its equations; those around it act while it runs, those of the sensors then in
    their order. Raises RigError if a number leaves its physical range, the stroke leaves the damper, or the grid is
    wrong.
    """
    if len(time_s) < 10 or not np.allclose(np.diff(time_s), GRID_S, rtol=0.0, atol=1e-9):
        raise RigError(f"plant: bad times; expected at least 10 times on a grid of {GRID_S:g} s")
    acting = [effect for effect in effects if effect.severity > 0.0]
    around = {e.name: physical_numbers(plant, e) for e in acting if e.name in SURROUNDINGS}
    model = plant
    for effect in acting:
        if effect.name not in environment.SPREADS:
            model = model.with_numbers(physical_numbers(model, effect))
    if around:
        force, coil, temperature = environment.run_surrounded(model, around, GRID_S, stroke_m, command_A)
    else:
        run = simulate(model, GRID_S, stroke_m, command_A)
        force, coil, temperature = run.tared_N, run.coil_A, run.temperature_degC
    true = Truth(time_s, stroke_m, command_A, coil, force, temperature)
    for effect in acting:
        if effect.name in SENSING:
            true = SENSING[effect.name](true, physical_numbers(plant, effect))
    return true


def simulate_expected(plant: RigDamper, true: Truth) -> F:
    """Return the force [N] (n,) of the plant without effects, driven with the recorded position and coil current."""
    return simulate(plant.without_coil(), GRID_S, true.stroke_m, true.coil_A).tared_N


def gap_from(plant: RigDamper, free: Truth, true: Truth) -> float:
    """Return the RMS [N] of `true`'s force less that without effects; equal signals in `free` save a simulation."""
    unmoved = np.array_equal(true.stroke_m, free.stroke_m) and np.array_equal(true.coil_A, free.coil_A)
    without = free.force_N if unmoved else simulate_expected(plant, true)
    return rms(true.force_N - without)


def _require_kind(kind: str) -> DamperKind:
    if kind not in KINDS:
        raise RigError(f"plant kind '{kind}' is unknown; expected one of {', '.join(KINDS)}")
    return KINDS[kind]


TOLERANCE = 0.03  # of the required gap
MAX_RUNS = 20
MAX_LOG_SIZE = log(2e3)
MAX_STRIDE = log(8.0)  # longest step of the search in log size


def scale_to_gap(
    plant: RigDamper, withheld: WithheldEffect, target_N: float, time_s: F, stroke_m: F, command_A: F
) -> WithheldEffect:
    """Return the effect at the severity that makes a gap of `target_N` RMS (within 3 %) under this excitation.

    `gap_from` defines the gap. Raises RigError if no severity in the physical range makes it, for example a valve's
    lag at constant current.
    """
    free = simulate_signals(plant, (), time_s, stroke_m, command_A)

    def gap(severity: float) -> float:
        true = simulate_signals(plant, (replace(withheld, severity=severity),), time_s, stroke_m, command_A)
        return gap_from(plant, free, true)

    return replace(withheld, severity=search_size(gap, target_N, f"{plant.kind} plant: {withheld.name}"))


def perturb_to_gap(
    plant: RigDamper, target_N: float, seed: int | list[int], time_s: F, stroke_m: F, command_A: F
) -> tuple[RigDamper, float]:
    """Return the plant with an error of `target_N` RMS (within 3 %) in a direction drawn from `seed`, and its size."""
    base = simulate_signals(plant, (), time_s, stroke_m, command_A).force_N

    def perturb_plant(size: float) -> RigDamper:
        return perturb(plant, size, np.random.default_rng(seed))

    def gap(size: float) -> float:
        return rms(simulate_signals(perturb_plant(size), (), time_s, stroke_m, command_A).force_N - base)

    size = search_size(gap, target_N, f"{plant.kind} plant: perturbation")
    return perturb_plant(size), size


def rms(values: F) -> float:
    """Return the root mean square of `values` (n,)."""
    return float(np.sqrt(np.mean(values**2)))


@dataclass
class Bracket:
    """Log sizes and log gaps below and above the required gap; `high_gap` is inf where no damper was possible."""

    low: float = -inf
    low_gap: float = -inf
    high: float = inf
    high_gap: float = inf

    def narrow(self, at: float, gap: float) -> None:
        """Update the bracket by a log gap, relative to the required one, at a log size."""
        if gap < 0.0:
            self.low, self.low_gap = at, gap
        else:
            self.high, self.high_gap = at, gap

    def next(self) -> float:
        """Return the next log size: false position inside the bracket, or a step as if the gap were proportional."""
        if self.high == inf:
            return self.low + min(1.1 * -self.low_gap, MAX_STRIDE)
        if self.low == -inf:
            return self.high - min(1.1 * self.high_gap, MAX_STRIDE)
        if self.low_gap == -inf or self.high_gap == inf:
            return 0.5 * (self.low + self.high)
        share = -self.low_gap / (self.high_gap - self.low_gap)
        return self.low + min(max(share, 0.15), 0.85) * (self.high - self.low)


def search_size(gap: Callable[[float], float], target_N: float, what: str) -> float:
    """Return the size at which the growing function `gap` is `target_N` within TOLERANCE; raises RigError if none."""
    if not target_N > 0.0:
        raise RigError(f"{what}: gap of {target_N!r} N requested; expected a number above 0")
    at, bracket, largest, refusal = 0.0, Bracket(), 0.0, ""
    for _ in range(MAX_RUNS):
        try:
            size = gap(exp(at))
            largest = max(largest, size)
            off = log(size / target_N) if size > 1e-9 else -inf
        except RigError as error:
            off, refusal = inf, f"; at larger sizes: {error}"
        if abs(off) < TOLERANCE:
            return exp(at)
        bracket.narrow(at, off)
        at = bracket.next()
        if at > MAX_LOG_SIZE:
            break
    raise RigError(f"{what}: a gap of {target_N:.4g} N cannot be reached here; the largest is {largest:.4g} N{refusal}")
