"""A neuro-fuzzy model (ANFIS): its parameters and proof of stability; `ces_observer.tick.fuzzy` has its equation.

A rule's share is its firing over that of all rules. Memberships depend on inputs, never on past forces, so the model is
a blend of affine recursions whose shares depend only on the damper's motion and current.

The shares are never negative and sum to one, so sum_j |sum_r share_r a_rj| <= max_r sum_j |a_rj|. If every rule's sum
is below one, the blend is a contraction for any inputs, and from a past of zeros |y| <= max |b| / (1 - max sum) at all
times. b is the largest output of any rule with past forces of zero, bounded over the input envelope by interval
arithmetic with outward rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from math import prod
from typing import Self

from ces_observer.errors import ModelError
from ces_observer.fields import REQUIRED
from ces_observer.flat import ArrayLayout
from ces_observer.limits import FileLimits, NumberLimits
from ces_observer.proof.certificate import Contraction, contraction_s
from ces_observer.proof.intervals import largest, up
from ces_observer.records import bounded, choice, items
from ces_observer.structures import lagged_signals as lagged
from ces_observer.structures.structure import OperatingRange, Ranges, Structure, require_length
from ces_observer.tick import fuzzy as tick
from ces_observer.tick.lagged import K_LAGGED, lagged_reset
from ces_observer.tick.structure import FUZZY

INPUTS = ("speed", "current", "position")
STEEPEST = 0.5 * tick.MAX_FUZZY_EXPONENT
CLAIM = "sum_j |a_j| <= gain < 1 in every rule, so in every blend; |b| <= drive_N for every input in the input envelope"
METHOD = "convex blend of the rules; interval arithmetic, outward rounding"


@dataclass(frozen=True)
class Bell:
    """A generalised bell 1 / (1 + |(x - centre) / width|^(2 slope)); centre and width in the premise's unit."""

    centre: float = lagged.weight()
    width: float = bounded(NumberLimits.MIN_BELL, NumberLimits.MAX_NUMBER)
    slope: float = bounded(0.1, STEEPEST)

    def at(self, x: float) -> float:
        """Return the membership of `x`, from 0 to 1."""
        return float(1.0 / (1.0 + abs((x - self.centre) / self.width) ** (2.0 * self.slope)))


@dataclass(frozen=True)
class Premise:
    """An input `lag` ticks ago on which the rules depend, and its memberships."""

    signal: str = choice(REQUIRED, "", INPUTS)
    lag: int = bounded(0, FileLimits.MAX_LAG)
    memberships: tuple[Bell, ...] = items(1, FileLimits.MAX_RULES)


@dataclass(frozen=True)
class Rule:
    """One membership (by index) of each premise, and the affine model that applies there."""

    memberships: tuple[int, ...] = bounded(0, FileLimits.MAX_RULES - 1)
    constant: float = lagged.weight()
    linear: tuple[float, ...] = lagged.weight()


@dataclass(frozen=True)
class Fuzzy(Structure):
    """A neuro-fuzzy model; each rule's `linear` has one coefficient for each regressor."""

    name, section, option, rank = "anfis", "fuzzy", "anfis", 2
    number, runs = FUZZY, (lagged_reset, tick.fuzzy_tick)

    regressors: tuple[lagged.Regressor, ...] = items(1, FileLimits.MAX_ITEMS)
    scale_N: float = lagged.spread("N")
    premises: tuple[Premise, ...] = items(1, FileLimits.MAX_PREMISES)
    rules: tuple[Rule, ...] = items(1, FileLimits.MAX_RULES)

    @property
    def uses(self) -> Sequence[str]:
        """The inputs among its regressors and premises."""
        return lagged.list_used([*self.regressors, *self.premises])

    @property
    def size(self) -> str:
        """The size, in words."""
        return f"{len(self.rules)} rules on {len(self.regressors)} regressors"

    def firings(self, values: Sequence[Sequence[float]]) -> list[float]:
        """Return each rule's firing, each membership being the smallest at any of its premise's `values`."""
        parts = zip(self.premises, values, strict=True)
        smallest = [[min(map(bell.at, at)) for bell in premise.memberships] for premise, at in parts]
        return [prod(smallest[i][m] for i, m in enumerate(rule.memberships)) for rule in self.rules]

    def checked(self) -> Self:
        """Return it; raises ModelError unless each rule has a membership of each premise and all coefficients."""
        for i, rule in enumerate(self.rules):
            require_length(f"rules[{i}]: linear", rule.linear, len(self.regressors))
            require_length(f"rules[{i}]: memberships", rule.memberships, len(self.premises))
            for index, premise in zip(rule.memberships, self.premises, strict=True):
                if index >= (count := len(premise.memberships)):
                    expected = f"expected a whole number from 0 to {count - 1}"
                    raise ModelError(f"rules[{i}]: membership {index} of {premise.signal}; {expected}")
        return self

    def check_over(self, inputs: Ranges) -> None:
        """Raise ModelError if no rule applies in a part of the ranges."""
        if min_firing(self, inputs) < NumberLimits.MIN_FIRING:
            text = "no rule applies in a part of the input envelope; expected wider memberships"
            raise ModelError(f"{self.section}: rules: {text}")

    def fill(self, layout: ArrayLayout, within: OperatingRange) -> None:
        """Write the rules into a layout, for `ces_observer.tick.fuzzy`; the bells of all premises are in one row."""
        layout.reserve(tick.P_FUZZY, tick.N_FUZZY, tick.S_FUZZY, K_LAGGED)
        premises = [lagged.Regressor(p.signal, p.lag, 0.0, 1.0) for p in self.premises]
        lagged.fill_lagged(layout, (*self.regressors, *premises))
        bells = [(i, bell) for i, premise in enumerate(self.premises) for bell in premise.memberships]
        first = list(accumulate((len(p.memberships) for p in self.premises), initial=0))
        choices = [at + chosen for rule in self.rules for at, chosen in zip(first, rule.memberships, strict=False)]
        shapes = [number for _, bell in bells for number in (bell.centre, bell.width, 2.0 * bell.slope)]
        layout.p[tick.FUZZY_SCALE] = self.scale_N
        layout.n[tick.FUZZY_PREMISES] = len(premises)
        layout.n[tick.FUZZY_BELLS] = len(bells)
        layout.n[tick.FUZZY_RULES] = len(self.rules)
        layout.n[tick.FUZZY_SHAPES] = layout.table(shapes)
        layout.n[tick.FUZZY_LAYER] = layout.table(number for r in self.rules for number in (*r.linear, r.constant))
        layout.n[tick.FUZZY_OWNERS] = layout.indices(owner for owner, _ in bells)
        layout.n[tick.FUZZY_CHOICES] = layout.indices(choices)
        layout.n[tick.FUZZY_MEMBERSHIPS] = layout.state(len(bells))
        layout.n[tick.FUZZY_OUTPUTS] = layout.state(len(self.rules))
        layout.n[tick.FUZZY_FIRINGS] = layout.state(len(self.rules))

    def certify(self, within: OperatingRange) -> Contraction:
        """Return proved bounds on the sum of the past forces' |gains|, and on |force| [N] at a past of zeros."""
        at = [r.interval(within.inputs) for r in self.regressors]
        drive = max(largest(lagged.affine(rule.constant, rule.linear, at)) for rule in self.rules)
        gains = []
        for rule in self.rules:
            gain = 0.0
            for slope, regressor in zip(rule.linear, self.regressors, strict=True):
                if regressor.signal == "force":
                    gain = up(gain + up(abs(slope) * up(self.scale_N / regressor.spread)))
            gains.append(gain)
        lags = lagged.longest_lags([*self.regressors, *self.premises])
        forgets_s = contraction_s(max(gains), *lags, within.rate_Hz)
        return Contraction(max(gains), up(drive * self.scale_N), 1, CLAIM, METHOD, forgets_s)


def min_firing(fuzzy: Fuzzy, inputs: Ranges) -> float:
    """Return a lower bound on the firing of all rules together; a bell is smallest at an end of its range."""
    return max(fuzzy.firings([inputs[premise.signal] for premise in fuzzy.premises]))
