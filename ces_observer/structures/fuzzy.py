"""A neuro-fuzzy model (ANFIS: first-order Takagi-Sugeno rules, generalised-bell memberships; Jang 1993), tick by tick.

force = scale_N * sum over rules of share * (constant + linear . phi), with phi the scaled regressors. A rule's share is
the product of its memberships over the sum of all rules' products; memberships are of inputs only, never of past
forces, so the model is a blend of affine recursions whose shares the damper's motion and current alone decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from operator import mul
from typing import Any

from ces_observer.checked import Checked
from ces_observer.errors import ModelError
from ces_observer.structures.lagged import (
    LEAST_SPREAD,
    MOST_LAG,
    MOST_NUMBER,
    Lagged,
    Range,
    Regressor,
    number_from,
    regressors_from,
)

INPUTS = ("speed", "current", "position")
MOST_RULES = 200
MOST_PREMISES = 6
MOST_MEMBERSHIPS = 200
STEEPEST = 10.0
LEAST_WIDTH = 1e-6  # [m, m/s, A]; with STEEPEST and MOST_NUMBER, so that no power overflows
LEAST_FIRING = 1e-200  # so that the shares can be formed without underflow


@dataclass(frozen=True)
class Bell:
    """A generalised bell 1 / (1 + |(x - centre) / width|^(2 slope)); centre and width in the premise's unit."""

    centre: float
    width: float
    slope: float

    def at(self, x: float) -> float:
        """Return the membership of `x`, from 0 to 1."""
        return float(1.0 / (1.0 + abs((x - self.centre) / self.width) ** (2.0 * self.slope)))


@dataclass(frozen=True)
class Premise:
    """An input `lag` ticks ago that decides which rules apply, and the fuzzy sets it may belong to."""

    signal: str
    lag: int
    memberships: tuple[Bell, ...]


@dataclass(frozen=True)
class Rule:
    """One membership (by index) of each premise, and the affine model that holds where they do."""

    memberships: tuple[int, ...]
    constant: float
    linear: tuple[float, ...]


@dataclass(frozen=True)
class Fuzzy:
    """The numbers of a neuro-fuzzy model; each rule's `linear` has one number for each regressor."""

    regressors: tuple[Regressor, ...]
    scale_N: float
    premises: tuple[Premise, ...]
    rules: tuple[Rule, ...]

    @property
    def max_lag(self) -> int:
        """Longest lag of any regressor or premise in ticks."""
        return max([r.lag for r in self.regressors] + [p.lag for p in self.premises])

    @property
    def size(self) -> str:
        """How large the model is, for people."""
        return f"{len(self.rules)} rules on {len(self.regressors)} regressors"

    def to_json(self) -> dict[str, Any]:
        """Return what the model file keeps."""
        return {
            "regressors": [r.to_json() for r in self.regressors],
            "scale_N": self.scale_N,
            "premises": [
                {
                    "signal": p.signal,
                    "lag": p.lag,
                    "memberships": [{"centre": b.centre, "width": b.width, "slope": b.slope} for b in p.memberships],
                }
                for p in self.premises
            ],
            "rules": [
                {"memberships": list(r.memberships), "constant": r.constant, "linear": list(r.linear)}
                for r in self.rules
            ],
        }


def fuzzy_from(node: Checked, bounds: Mapping[str, Range]) -> Fuzzy:
    """Check the rules of a model file over its input envelope `bounds` (by signal); raises ModelError."""
    node.only("regressors", "scale_N", "premises", "rules")
    regressors = regressors_from(node)
    premises = tuple(_premise(item) for item in node.items("premises", 1, MOST_PREMISES))
    rules = tuple(_rule(item, premises, len(regressors)) for item in node.items("rules", 1, MOST_RULES))
    fuzzy = Fuzzy(regressors, node.number("scale_N", LEAST_SPREAD, MOST_NUMBER), premises, rules)
    if least_firing(fuzzy, bounds) < LEAST_FIRING:
        raise ModelError(f"{node.where}: rules: none is felt in all of the input envelope; expected wider memberships")
    return fuzzy


def least_firing(fuzzy: Fuzzy, bounds: Mapping[str, Range]) -> float:
    """Return what the firing of all rules together is at least, over the envelope: a bell is least at an end of it."""
    ends = [[min(b.at(x) for x in bounds[p.signal]) for b in p.memberships] for p in fuzzy.premises]
    return max(prod(ends[p][m] for p, m in enumerate(rule.memberships)) for rule in fuzzy.rules)


def _premise(node: Checked) -> Premise:
    node.only("signal", "lag", "memberships")
    bells = tuple(_bell(item) for item in node.items("memberships", 1, MOST_MEMBERSHIPS))
    return Premise(node.choice("signal", INPUTS), node.whole("lag", 0, MOST_LAG), bells)


def _bell(node: Checked) -> Bell:
    node.only("centre", "width", "slope")
    width = node.number("width", LEAST_WIDTH, MOST_NUMBER)
    return Bell(number_from(node, "centre"), width, node.number("slope", 0.1, STEEPEST))


def _rule(node: Checked, premises: Sequence[Premise], regressors: int) -> Rule:
    node.only("memberships", "constant", "linear")
    chosen = node.numbers("memberships", len(premises), MOST_MEMBERSHIPS)
    for index, premise in zip(chosen, premises, strict=True):
        if index not in range(len(premise.memberships)):
            raise ModelError(
                f"{node.where}: membership {index:g} of {premise.signal}; expected a whole number from 0 to "
                f"{len(premise.memberships) - 1}"
            )
    linear = node.numbers("linear", regressors, MOST_NUMBER)
    return Rule(tuple(int(index) for index in chosen), number_from(node, "constant"), linear)


class FuzzyRun:
    """The free run of a neuro-fuzzy model; `clamped` tells whether the last inputs were outside the envelope."""

    __slots__ = ("_fuzzy", "_past", "_premises")

    def __init__(self, fuzzy: Fuzzy, bounds: Mapping[str, Range], limits: Range) -> None:
        """Clamp inputs to `bounds` (by signal); a force outside `limits` [N] ends the run."""
        self._fuzzy = fuzzy
        self._premises = tuple(Regressor(p.signal, p.lag, 0.0, 1.0) for p in fuzzy.premises)
        self._past = Lagged(fuzzy.max_lag, bounds, limits)

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the envelope and were clamped to it."""
        return self._past.clamped

    def reset(self) -> None:
        """Forget the past: forces before now count as zero, inputs before now as the first ones to come."""
        self._past.reset()

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick; infinite if it left the force envelope."""
        past, fuzzy = self._past, self._fuzzy
        past.arrive(position, speed, current)
        phi = past.values(fuzzy.regressors)
        grades = [
            [bell.at(x) for bell in premise.memberships]
            for premise, x in zip(fuzzy.premises, past.values(self._premises), strict=True)
        ]
        fired = total = 0.0
        for rule in fuzzy.rules:
            firing = prod([grades[p][m] for p, m in enumerate(rule.memberships)])
            fired += firing
            total += firing * (rule.constant + sum(map(mul, rule.linear, phi)))
        return past.keep(fuzzy.scale_N * total / fired)
