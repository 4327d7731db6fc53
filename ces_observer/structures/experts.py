"""Gated experts: their parameters and proof that they forget; `ces_observer.tick.experts` has the equation.

The shares depend on the inputs alone, are never negative and sum to one. The slope of a tanh lies in [0, 1], so for the
same inputs the change of the output lies in the hull of the gains a_i and a_i + d_i times the change of the past force:
if all of them are at most `gain` < 1, two pasts come closer by this factor in every tick, whatever the inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Self

from ces_observer.errors import ModelError
from ces_observer.flat import ArrayLayout
from ces_observer.limits import FileLimits
from ces_observer.proof.certificate import Contraction, contraction_s
from ces_observer.proof.intervals import largest, up
from ces_observer.records import items, part
from ces_observer.structures import lagged_signals as lagged
from ces_observer.structures.structure import OperatingRange, Structure, require_length
from ces_observer.tick import experts as tick
from ces_observer.tick.lagged import K_LAGGED, lagged_reset
from ces_observer.tick.model import S_STRUCTURE
from ces_observer.tick.structure import EXPERTS

ROWS, NUMBERS = ("gate", "linear", "bend"), ("past", "past_bend", "room")  # of an expert
CLAIM = (
    "|dF/dF(k-1)| <= gain < 1 for any past and inputs; "
    "|F| <= drive_N for a past of zeros and every input in the input envelope"
)
METHOD = "hull of the gains of all experts, whose shares depend on inputs alone; interval arithmetic, outward rounding"


@dataclass(frozen=True)
class Expert:
    """One expert: `gate`, `linear` and `bend` have a coefficient for each input, then a constant.

    `past` and `past_bend` are the gains of the last force beside and within the tanh, `room` the size of the tanh.
    """

    gate: tuple[float, ...] = lagged.weight()
    linear: tuple[float, ...] = lagged.weight()
    bend: tuple[float, ...] = lagged.weight()
    past: float = lagged.weight()
    past_bend: float = lagged.weight()
    room: float = lagged.spread()


@dataclass(frozen=True)
class Experts(Structure):
    """Gated experts on `inputs` and the past force `past_force`."""

    name, section, option, rank = "gated_experts", "experts", "experts", 4
    number, runs = EXPERTS, (lagged_reset, tick.experts_tick)

    inputs: tuple[lagged.Regressor, ...] = items(1, FileLimits.MAX_ITEMS)
    past_force: lagged.Regressor = part()
    scale_N: float = lagged.spread("N")
    experts: tuple[Expert, ...] = items(1, FileLimits.MAX_ITEMS)

    @property
    def uses(self) -> Sequence[str]:
        """The inputs among its inputs."""
        return lagged.list_used(self.inputs)

    @property
    def size(self) -> str:
        """The size, in words."""
        return f"{len(self.experts)} experts on {len(self.inputs)} inputs"

    def checked(self) -> Self:
        """Return it; raises ModelError unless its parts fit together."""
        if self.past_force.signal != "force" or any(r.signal == "force" for r in self.inputs):
            raise ModelError("expected a past force as past_force, and none among the inputs")
        for i, expert in enumerate(self.experts):
            for name in ROWS:
                require_length(f"experts[{i}]: {name}", getattr(expert, name), len(self.inputs) + 1)
        return self

    def fill(self, layout: ArrayLayout, within: OperatingRange) -> None:
        """Write the experts into a layout, for `ces_observer.tick.experts`."""
        layout.reserve(tick.P_EXPERTS, tick.N_EXPERTS, S_STRUCTURE, K_LAGGED)
        lagged.fill_lagged(layout, (*self.inputs, self.past_force))
        layout.p[tick.EXPERTS_SCALE] = self.scale_N
        layout.n[tick.EXPERTS_COUNT] = len(self.experts)
        rows = (getattr(one, name) for name in ROWS for one in self.experts)
        layout.n[tick.EXPERTS_LAYER] = layout.table(chain.from_iterable(rows))
        layout.n[tick.EXPERTS_GAINS] = layout.table(getattr(one, name) for one in self.experts for name in NUMBERS)
        layout.n[tick.EXPERTS_OUTPUTS] = layout.state(3 * len(self.experts))

    def certify(self, within: OperatingRange) -> Contraction:
        """Return proved bounds on the gain of the past force, and on |force| [N] at a past of zero."""
        at = [r.interval(within.inputs) for r in self.inputs]
        ratio, gain, drive = up(self.scale_N / self.past_force.spread), 0.0, 0.0
        offset = abs(self.past_force.mean) / self.past_force.spread
        for one in self.experts:
            steepest = max(abs(one.past), up(abs(one.past + one.past_bend)))
            gain = max(gain, up(steepest * ratio))
            affine = largest(lagged.affine(one.linear[-1], one.linear[:-1], at))
            drive = max(drive, up(up(affine + one.room) + up(abs(one.past) * up(offset))))
        forgets_s = contraction_s(gain, *lagged.longest_lags((*self.inputs, self.past_force)), within.rate_Hz)
        return Contraction(gain, up(drive * self.scale_N), 1, CLAIM, METHOD, forgets_s)
