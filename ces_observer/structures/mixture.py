"""The weighted mean of models of one damper, of any other structures: its members, and their proofs together.

`ces_observer.tick.mixture` has its equation. The weights are positive and sum to one. So the force of this convex
combination is at most the weighted sum of its members' bounds, and it has forgotten its past when all of them have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import fsum
from typing import Self

from ces_observer import structures
from ces_observer.errors import ModelError
from ces_observer.flat import ArrayLayout
from ces_observer.limits import NumberLimits
from ces_observer.proof.certificate import Certificate
from ces_observer.proof.intervals import up
from ces_observer.records import OneOf, bounded, items, part
from ces_observer.structures.structure import INPUTS, OperatingRange, Range, Ranges, Structure
from ces_observer.tick import mixture as tick
from ces_observer.tick.model import K_STRUCTURE, P_STRUCTURE, S_STRUCTURE
from ces_observer.tick.structure import MIXTURE

MIN_MEMBERS = 2
ROUNDING = 1e-9  # of the sum of the weights
CLAIM = "a convex combination of models, each proved stable; |F| <= force_bound_N, the weighted sum of their bounds"
METHOD = "weights above 0 that sum to 1; for the members"


def _members() -> dict[str, type[Structure]]:
    return {name: structure for name, structure in structures.STRUCTURES.items() if name != Mixture.name}


@dataclass(frozen=True)
class WeightedModel:
    """A model in the mean: its weight, its structure, and the range [N] in which its own force is held."""

    weight: float = bounded(NumberLimits.MIN_WEIGHT, 1.0)
    body: Structure = part(kind=OneOf(_members, "structure"), inline=True)
    force_envelope_N: Range = bounded(-NumberLimits.MAX_NUMBER, NumberLimits.MAX_NUMBER)

    def within(self, whole: OperatingRange) -> OperatingRange:
        """Return the operating range of the member in a mixture with that of the whole."""
        return replace(whole, force_N=self.force_envelope_N)


@dataclass(frozen=True)
class MixtureCertificate(Certificate):
    """The proofs of the members, each with the member."""

    members: tuple[tuple[WeightedModel, Certificate], ...]
    claim: str
    method: str

    @property
    def forgets_s(self) -> float:  # type: ignore[override]  # computed
        """The longest time [s] of its members: their differences are weighted as their forces are."""
        return max(proof.forgets_s for _, proof in self.members)

    @property
    def holds(self) -> bool:
        """True if every member is proved stable."""
        return all(proof.holds for _, proof in self.members)

    @property
    def force_N(self) -> float:
        """Bound on the force [N] for inputs in the envelope, infinite if a member is not proved stable."""
        total = 0.0
        for member, proof in self.members:
            total = up(total + up(member.weight * proof.force_N))
        return total

    @property
    def bounds(self) -> Mapping[str, float]:
        """The bound on the force, and how long the past counts."""
        return {"force_bound_N": self.force_N, "forgets_s": self.forgets_s}

    @property
    def doubt(self) -> str:
        """Why a member is not proved."""
        return next((f"{member.body.option}: {proof.doubt}" for member, proof in self.members if not proof.holds), "")

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """The proved numbers for display."""
        names = ", ".join(member.body.option for member, _ in self.members)
        force = ("force bound", f"{self.force_N:.6g} N, the sum of theirs")
        return (("members", f"{names}: each proved"), force, self.past_row)


@dataclass(frozen=True)
class Mixture(Structure):
    """The weighted mean of its members."""

    name, section, option, rank, is_offered = "mixture", "mixture", "mixture", 90, False
    number, runs = MIXTURE, (tick.mixture_reset, tick.mixture_tick)
    unproved = "one of the models in its mean is not proved stable"

    members: tuple[WeightedModel, ...] = items(MIN_MEMBERS, tick.MAX_MEMBERS)

    def checked(self) -> Self:
        """Return it; raises ModelError unless the weights sum to one."""
        total = fsum(member.weight for member in self.members)
        if abs(total - 1.0) > ROUNDING:
            raise ModelError(f"the weights of the members sum to {total:.12g}; expected 1")
        return self

    def check_over(self, inputs: Ranges) -> None:
        """Raise ModelError if a member does not fit the ranges of inputs."""
        for member in self.members:
            member.body.check_over(inputs)

    @property
    def size(self) -> str:
        """The size, in words."""
        alike: dict[tuple[str, str], list[float]] = {}
        for member in self.members:
            alike.setdefault((member.body.option, member.body.size), []).append(member.weight)
        sizes = [
            f"{fsum(weights):.2f} {option} ({f'{len(weights)} times ' if len(weights) > 1 else ''}{size})"
            for (option, size), weights in alike.items()
        ]
        return f"mean of {len(self.members)} models: {', '.join(sizes)}"

    @property
    def uses(self) -> Sequence[str]:
        """The inputs that a member uses."""
        return [name for name in INPUTS if any(name in member.body.uses for member in self.members)]

    @property
    def forgets_by_proof(self) -> bool:  # type: ignore[override]  # as its members
        """True if every member does."""
        return all(member.body.forgets_by_proof for member in self.members)

    @property
    def extrapolates(self) -> bool:  # type: ignore[override]  # of other structures, all or none do
        """True if a member does: then each member gets the inputs as they are, and clamps for itself."""
        return any(member.body.extrapolates for member in self.members)

    @property
    def outside(self) -> str:
        """What becomes of inputs outside the envelope."""
        ways = [member.body.outside for member in self.members]
        names = {way: [one.body.option for one in self.members if one.body.outside == way] for way in ways}
        return super().outside if len(names) < 2 else "; ".join(f"{way} ({', '.join(names[way])})" for way in names)

    def steady_force(self, within: OperatingRange, speed_m_s: float, current_A: float) -> float | None:
        """Return the exact force [N] at mid-stroke at constant speed and current, if each member has one."""
        total = 0.0
        for member in self.members:
            force = member.body.steady_force(member.within(within), speed_m_s, current_A)
            if force is None:
                return None
            low, high = member.force_envelope_N
            total += member.weight * min(max(force, low), high)
        return total

    def fill(self, layout: ArrayLayout, within: OperatingRange) -> None:
        """Write the members into a layout, the arrays of one behind those of the other."""
        layout.reserve(P_STRUCTURE, tick.N_MIXTURE, S_STRUCTURE, K_STRUCTURE)
        layout.n[tick.MIXTURE_MEMBERS] = len(self.members)
        layout.n[tick.MIXTURE_WEIGHTS] = layout.table(member.weight for member in self.members)
        at = layout.n[tick.MIXTURE_PLACES] = layout.indices([0] * (4 * len(self.members)))
        for member in self.members:
            own = member.body.lay_out(member.within(within))
            layout.n[at + tick.OWN_P] = layout.table(own.p)
            layout.n[at + tick.OWN_N] = layout.indices(own.n)
            layout.n[at + tick.OWN_S] = layout.state(own.states)
            layout.n[at + tick.OWN_K] = layout.memory(own.flags)
            at += 4

    def certify(self, within: OperatingRange) -> MixtureCertificate:
        """Return the members' certificates together."""
        proofs = tuple((member, member.body.certify(member.within(within))) for member in self.members)
        methods = dict.fromkeys(f"{member.body.option} ({proof.method})" for member, proof in proofs)
        return MixtureCertificate(proofs, CLAIM, f"{METHOD}: {', '.join(methods)}")

    def is_stable(self, within: OperatingRange) -> bool:
        """Return whether all members are proved stable."""
        return all(member.body.is_stable(member.within(within)) for member in self.members)
