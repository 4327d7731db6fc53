"""Severity and size by the gap they make: searches over simulations for a wanted RMS in newtons."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, inf, log

import numpy as np
from numpy.typing import NDArray

from ces_rig.dampers.effects import WithheldEffect, with_severity
from ces_rig.errors import RigError
from ces_rig.withheld.plants import BlindPlant, gap_from, perturb, simulate_signals

Array = NDArray[np.float64]
Gap = Callable[[float], float]

TOLERANCE = 0.03  # of the wanted gap
MAX_RUNS = 20
HIGHEST = log(2e3)  # log severity: beyond, an effect that shows nothing never will
STRIDE = log(8.0)  # longest step of the search in log size


def scale_to_gap(
    plant: BlindPlant, withheld: WithheldEffect, target_N: float, time_s: Array, stroke_m: Array, command_A: Array
) -> WithheldEffect:
    """Return the effect at the severity that makes a gap of `target_N` RMS (3 %) under this excitation.

    The gap is the force as sensed less that of the plant without effects driven with what was sensed. Raises RigError
    if no severity in the physical range does: for example a valve's lag at a constant current.
    """
    free = simulate_signals(plant, (), time_s, stroke_m, command_A)

    def gap(severity: float) -> float:
        true = simulate_signals(plant, (with_severity(withheld, severity),), time_s, stroke_m, command_A)
        return gap_from(plant, free, true)

    found = search_size(gap, target_N, f"{plant.kind} plant: {withheld.name}")
    return with_severity(withheld, found)


def perturb_to_gap(
    plant: BlindPlant, target_N: float, seed: int | list[int], time_s: Array, stroke_m: Array, command_A: Array
) -> tuple[BlindPlant, float]:
    """Return the plant made wrong by `target_N` RMS (3 %), in the direction that `seed` draws, and the size of it."""
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
    """Log sizes and log gaps known to lie below and above the wanted gap; inf above where no damper could be."""

    low: float = -inf
    low_gap: float = -inf
    high: float = inf
    high_gap: float = inf

    def narrow(self, at: float, gap: float) -> None:
        """Take in a gap [log N less the wanted one] at a log size."""
        if gap < 0.0:
            self.low, self.low_gap = at, gap
        else:
            self.high, self.high_gap = at, gap

    def next(self) -> float:
        """Return the log size to try: false position between both, else a step as if the gap grew in proportion."""
        if self.high == inf:
            return self.low + (STRIDE if self.low_gap == -inf else min(1.1 * -self.low_gap, STRIDE))
        if self.low == -inf:
            return self.high - (STRIDE if self.high_gap == inf else min(1.1 * self.high_gap, STRIDE))
        if self.low_gap == -inf or self.high_gap == inf:
            return 0.5 * (self.low + self.high)
        share = -self.low_gap / (self.high_gap - self.low_gap)
        return self.low + min(max(share, 0.15), 0.85) * (self.high - self.low)


def search_size(gap: Gap, target_N: float, what: str) -> float:
    """Return the size at which `gap`, growing with size, is `target_N` within TOLERANCE; raises RigError if none is."""
    if not target_N > 0.0:
        raise RigError(f"{what}: wanted gap {target_N!r} N; expected a number above 0")
    at, bracket, largest, refusal = 0.0, Bracket(), 0.0, ""
    for _ in range(MAX_RUNS):
        try:
            found = gap(exp(at))
            largest = max(largest, found)
            off = log(found / target_N) if found > 1e-9 else -inf
        except RigError as error:
            off, refusal = inf, f"; beyond, {error}"
        if abs(off) < TOLERANCE:
            return exp(at)
        bracket.narrow(at, off)
        at = bracket.next()
        if at > HIGHEST:
            break
    raise RigError(
        f"{what}: a gap of {target_N:.4g} N cannot be reached here; the largest seen is {largest:.4g} N{refusal}"
    )
