"""Terms of a polynomial model: products of powers of signals, their bounds over ranges of inputs, and their JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import copysign, prod
from typing import Any

from ces_observer.errors import ModelError
from ces_observer.json_text import JsonObject
from ces_observer.proof.intervals import Interval, down, up
from ces_observer.structures.constructed_inputs import (
    MAX_CONSTRUCTED,
    ConstructedInput,
    TriangularMembership,
    parse_constructed,
)
from ces_observer.structures.structure import MAX_LAG, Range, Ranges

MIN_SIZE = 1e-100  # nearer to zero, a slope may overflow and counts as unbounded


@dataclass(frozen=True)
class Factor:
    """One factor of a term: a signal `lag` ticks ago, as |s|^power, or as sign(s) |s|^power if `signed`.

    A `force` factor is the model's own past output (lag >= 1, power 1, signed). A signal that is neither that nor an
    input is a constructed input with this `definition`.
    """

    signal: str
    lag: int
    power: float = 1.0
    signed: bool = True
    definition: ConstructedInput | None = None

    @property
    def variable(self) -> tuple[str, int]:
        """The variable of the factor, signal and lag; that of a membership is the signal `of`."""
        return (self.definition.of if isinstance(self.definition, TriangularMembership) else self.signal), self.lag

    @property
    def kinks(self) -> tuple[float, ...]:
        """The values, besides zero, at which the factor's slope jumps."""
        return self.definition.kinks if isinstance(self.definition, TriangularMembership) else ()

    def at(self, value: float) -> float:
        """Return the factor at `value` of its variable."""
        if isinstance(self.definition, TriangularMembership):
            return self.definition.at(value)
        size = float(abs(value) ** self.power)
        return copysign(size, value) if self.signed else size

    def signal_range(self, ranges: Ranges) -> Range:
        """Return the range of the factor's signal."""
        return ranges[self.signal] if self.definition is None else self.definition.range(ranges)

    def variable_range(self, ranges: Ranges) -> Range:
        """Return the range of the factor's variable."""
        if isinstance(self.definition, TriangularMembership):
            return self.definition.base_range(ranges)
        return self.signal_range(ranges)

    def interval(self, at: Interval) -> Interval:
        """Return an interval that holds the factor for every value of its variable in `at`.

        Powers are rounded by two floats.
        """
        if isinstance(self.definition, TriangularMembership):
            return self.definition.interval(at)
        low, high = at
        if self.signed:
            at_zero = 0.0**self.power  # power 0 is a sign: at zero it may be taken as either
            lowest = copysign(abs(low) ** self.power, low) if low else -at_zero
            highest = copysign(abs(high) ** self.power, high) if high else at_zero
            return down(down(lowest)), up(up(highest))
        smallest = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
        largest = max(abs(low), abs(high))
        return max(0.0, down(down(smallest**self.power))), up(up(largest**self.power))

    def slope_interval(self, at: Interval) -> Interval | None:
        """Return an interval that holds the factor's derivative over `at`, None near zero (except for a membership)."""
        if isinstance(self.definition, TriangularMembership):
            return self.definition.slope_interval(at)
        if at[0] <= MIN_SIZE and at[1] >= -MIN_SIZE:
            return None
        ends = [self.power * abs(s) ** (self.power - 1.0) for s in at]
        low, high = down(down(down(min(ends)))), up(up(up(max(ends))))
        return (low, high) if self.signed or at[0] > 0.0 else (-high, -low)


@dataclass(frozen=True)
class Term:
    """A coefficient [N per product of the factors' units] times its factors, at most one of them a past force."""

    coefficient: float
    factors: tuple[Factor, ...]

    @property
    def output_lag(self) -> int:
        """Lag of the past force in ticks, 0 if there is none."""
        return next((f.lag for f in self.factors if f.signal == "force"), 0)

    @property
    def inputs(self) -> tuple[Factor, ...]:
        """The factors that are not past forces."""
        return tuple(f for f in self.factors if f.signal != "force")


def collect_constructed(terms: Sequence[Term]) -> tuple[ConstructedInput, ...]:
    """Return the terms' constructed inputs by name, memberships last; raises ModelError if two of a name differ."""
    known: dict[str, ConstructedInput] = {}
    used = {f.definition for term in terms for f in term.factors if f.definition is not None}
    for one in used | {one.base for one in used if isinstance(one, TriangularMembership) and one.base is not None}:
        if known.setdefault(one.name, one) != one:
            raise ModelError(f"constructed input '{one.name}': two different definitions; expected a name for each")
    return tuple(sorted(known.values(), key=lambda one: (isinstance(one, TriangularMembership), one.name)))


SIGNALS = ("force", "speed", "current", "position")
MAX_TERMS = 500
MAX_FACTORS = 8
MAX_POWER = 8.0
MAX_COEFFICIENT = 1e30
MAX_PRODUCT = 1e100  # of a term, and of its factors' product: far from overflow of sums, slopes and bounds


def terms_from(root: JsonObject, inputs: Ranges) -> tuple[Term, ...]:
    """Check the keys `terms` and `constructed` of a model file over its ranges of inputs; raises ModelError."""
    definitions = root.items("constructed", 1, MAX_CONSTRUCTED) if "constructed" in root.value else ()
    constructed = parse_constructed(definitions)
    return tuple(_term_from(item, constructed, inputs) for item in root.items("terms", 1, MAX_TERMS))


def term_to_json(term: Term) -> dict[str, Any]:
    """Return a term as in a model file."""
    factors = [
        {"signal": f.signal, "lag": f.lag}
        if f.signal == "force"
        else {"signal": f.signal, "lag": f.lag, "power": f.power, "signed": f.signed}
        for f in term.factors
    ]
    return {"coefficient": term.coefficient, "factors": factors}


def _term_from(node: JsonObject, constructed: Mapping[str, ConstructedInput], inputs: Ranges) -> Term:
    node.require_only_keys("coefficient", "factors")
    factors = tuple(_factor_from(item, constructed) for item in node.items("factors", 0, MAX_FACTORS))
    if sum(f.signal == "force" for f in factors) > 1:
        raise ModelError(f"{node.where}: more than one past force; expected at most one, so that bounds can be proved")
    term = Term(node.number("coefficient", -MAX_COEFFICIENT, MAX_COEFFICIENT), factors)
    if not _bound_product(term, inputs) <= MAX_PRODUCT:
        raise ModelError(f"{node.where}: can grow beyond {MAX_PRODUCT:g} in the input envelope; expected lower powers")
    return term


def _factor_from(node: JsonObject, constructed: Mapping[str, ConstructedInput]) -> Factor:
    signal = node.choice("signal", (*SIGNALS, *constructed))
    if signal == "force":
        node.require_only_keys("signal", "lag")
        return Factor("force", node.integer("lag", 1, MAX_LAG))
    node.require_only_keys("signal", "lag", "power", "signed")
    lag = node.integer("lag", 0, MAX_LAG)
    power, definition = node.number("power", 0.0, MAX_POWER), constructed.get(signal)
    if isinstance(definition, TriangularMembership) and power != 1.0:
        raise ModelError(f"{node.where}: power is {power:g}; expected 1, as '{signal}' is a membership")
    return Factor(signal, lag, power, node.flag("signed"), definition)


def _bound_product(term: Term, inputs: Ranges) -> float:
    """Return a bound on the term's product over the ranges, and on every part of that product."""
    sizes = [max(1.0, *map(abs, f.signal_range(inputs))) ** f.power for f in term.inputs]
    return prod([max(1.0, abs(term.coefficient)), *sizes])
