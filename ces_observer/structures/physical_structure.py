"""What the structures with physics inside share: how far they extrapolate, their steady force, and their proof."""

from __future__ import annotations

from abc import abstractmethod
from math import inf
from typing import ClassVar, Self

from ces_observer.proof.energy import CLAIM, EnergyCertificate
from ces_observer.structures.reach import INPUTS, widen
from ces_observer.structures.side_forces import SideForces
from ces_observer.structures.structure import OperatingRange, Ranges, Structure
from ces_observer.structures.valve_path import ValvePath

LONG_TICK = OperatingRange(1e-6, dict.fromkeys(INPUTS, (-inf, inf)), (-inf, inf))  # in which every lag dies out


class PhysicalStructure(Structure):
    """A structure of increasing curves, solved implicitly; `method` says how its force was bounded."""

    extrapolates: ClassVar[bool] = True
    unproved: ClassVar[str] = "its force is not proved to be bounded for every input"
    method: ClassVar[str]

    valve: ValvePath
    side: SideForces
    reach: float

    @property
    def max_lag(self) -> int:
        """Longest lag of any signal in ticks."""
        return self.valve.max_lag

    @property
    def outside(self) -> str:
        """What becomes of inputs outside the envelope."""
        return f"used as they are up to {self.reach:g} times the envelope, and clamped beyond"

    def steady_force(self, within: OperatingRange, speed_m_s: float, current_A: float) -> float:
        """Return the force [N] at mid-stroke of full strokes at constant speed and current, here in one long tick."""
        low, high = within.inputs["position"]
        run = self.at_full_strokes(0.5 * (high - low)).make_predictor(LONG_TICK)
        return run.tick(0.5 * (low + high), speed_m_s, current_A)

    @abstractmethod
    def at_full_strokes(self, half_m: float) -> Self:
        """Return the model with the yield forces that its springs have in the middle of strokes to +-`half_m` [m]."""

    def certify(self, within: OperatingRange) -> EnergyCertificate:
        """Return the proved bounds on |force| [N]."""
        envelope, any_input = map(self.bound_force, (within.inputs, widen(within.inputs, self.reach)))
        return EnergyCertificate(envelope, any_input, CLAIM, self.method)

    @abstractmethod
    def bound_force(self, inputs: Ranges) -> float:
        """Return a bound on |force| [N] for inputs in their ranges, infinite if there is none."""


def yield_at_mid_stroke(stiffness_N_m: float, yield_N: float, half_m: float) -> float:
    """Return the force [N] of a yielding spring in the middle of strokes to +-`half_m` [m].

    It leaves an end with the force -min(yield, stiffness half): without yielding there, it is relaxed in the middle.
    """
    return min(max(stiffness_N_m * half_m - yield_N, 0.0), yield_N)
