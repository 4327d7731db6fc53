"""Searches, by simulation, the severity of an effect or the size of an error for a gap of a required RMS [N]."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import exp, inf, log

import numpy as np
from numpy.typing import NDArray

from ces_rig.dampers.effects import WithheldEffect
from ces_rig.errors import RigError
from ces_rig.withheld.plants import BlindPlant, gap_from, perturb, simulate_signals

Array = NDArray[np.float64]
Gap = Callable[[float], float]

TOLERANCE = 0.03  # of the required gap
MAX_RUNS = 20
MAX_LOG_SIZE = log(2e3)
MAX_STRIDE = log(8.0)  # longest step of the search in log size


def scale_to_gap(
    plant: BlindPlant, withheld: WithheldEffect, target_N: float, time_s: Array, stroke_m: Array, command_A: Array
) -> WithheldEffect:
    """Return the effect at the severity that makes a gap of `target_N` RMS (within 3 %) under this excitation.

    `plants.gap_N` defines the gap. Raises RigError if no severity in the physical range makes it, for example a valve's
    lag at constant current.
    """
    free = simulate_signals(plant, (), time_s, stroke_m, command_A)

    def gap(severity: float) -> float:
        true = simulate_signals(plant, (replace(withheld, severity=severity),), time_s, stroke_m, command_A)
        return gap_from(plant, free, true)

    return replace(withheld, severity=search_size(gap, target_N, f"{plant.kind} plant: {withheld.name}"))


def perturb_to_gap(
    plant: BlindPlant, target_N: float, seed: int | list[int], time_s: Array, stroke_m: Array, command_A: Array
) -> tuple[BlindPlant, float]:
    """Return the plant with an error of `target_N` RMS (within 3 %) in a direction drawn from `seed`, and its size."""
    base = simulate_signals(plant, (), time_s, stroke_m, command_A).force_N

    def perturb_plant(size: float) -> BlindPlant:
        return perturb(plant, size, np.random.default_rng(seed))

    def gap(size: float) -> float:
        return rms(simulate_signals(perturb_plant(size), (), time_s, stroke_m, command_A).force_N - base)

    size = search_size(gap, target_N, f"{plant.kind} plant: perturbation")
    return perturb_plant(size), size


def rms(values: Array) -> float:
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


def search_size(gap: Gap, target_N: float, what: str) -> float:
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
