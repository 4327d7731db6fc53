"""Terms of a polynomial model: products of powers of signals, their bounds over ranges of inputs, and their JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import copysign, prod
from typing import Self

from ces_observer.errors import ModelError
from ces_observer.limits import FileLimits, NumberLimits
from ces_observer.proof.intervals import Interval, down, up
from ces_observer.records import bounded, in_files, items, part
from ces_observer.structures.constructed_inputs import ConstructedInput, TriangularMembership
from ces_observer.structures.structure import Range, Ranges

MIN_SIZE = 1e-100  # nearer to zero, a slope may overflow and counts as unbounded
SIGNALS = ("force", "speed", "current", "position")


def _is_input(factor: Mapping[str, object]) -> bool:
    return factor.get("signal") != "force"


@dataclass(frozen=True)
class Factor:
    """One factor of a term: a signal `lag` ticks ago, as |s|^power, or as sign(s) |s|^power if `signed`.

    A `force` factor is the model's own past output (lag >= 1, power 1, signed). A signal that is neither that nor an
    input is a constructed input with this `definition`.
    """

    signal: str
    lag: int = bounded(0, FileLimits.MAX_LAG)
    power: float = bounded(0.0, FileLimits.MAX_POWER, default=1.0, when=_is_input)
    signed: bool = part(default=True, when=_is_input)
    definition: ConstructedInput | None = field(default=None, metadata=in_files(None))

    def checked(self) -> Self:
        """Return it; raises ModelError for a force of the same tick."""
        if self.signal == "force" and self.lag == 0:
            raise ModelError(f"lag is 0; expected a whole number from 1 to {FileLimits.MAX_LAG} of a force")
        return self

    def defined(self, constructed: Mapping[str, ConstructedInput]) -> Self:
        """Return it with its definition, if it needs one; raises ModelError."""
        if self.signal in SIGNALS:
            return self
        if self.signal not in constructed:
            raise ModelError(f"signal is {self.signal!r}; expected one of {', '.join((*SIGNALS, *constructed))}")
        definition = constructed[self.signal]
        if isinstance(definition, TriangularMembership) and self.power != 1.0:
            raise ModelError(f"power is {self.power:g}; expected 1, as '{self.signal}' is a membership")
        return replace(self, definition=definition)

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

    coefficient: float = bounded(-NumberLimits.MAX_COEFFICIENT, NumberLimits.MAX_COEFFICIENT)
    factors: tuple[Factor, ...] = items(0, FileLimits.MAX_FACTORS)

    def checked(self) -> Self:
        """Return it; raises ModelError for several past forces."""
        if sum(f.signal == "force" for f in self.factors) > 1:
            raise ModelError("more than one past force; expected at most one, so that bounds can be proved")
        return self

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
    by_name: dict[str, ConstructedInput] = {}
    used = {f.definition for term in terms for f in term.factors if f.definition is not None}
    for made in used | {made.base for made in used if isinstance(made, TriangularMembership) and made.base is not None}:
        if by_name.setdefault(made.name, made) != made:
            raise ModelError(f"constructed input '{made.name}': two different definitions; expected a name for each")
    return tuple(sorted(by_name.values(), key=lambda made: (isinstance(made, TriangularMembership), made.name)))


def define_factors(terms: Sequence[Term], constructed: Mapping[str, ConstructedInput]) -> tuple[Term, ...]:
    """Return the terms with the definitions of their factors; raises ModelError naming a factor without one."""
    defined = []
    for i, term in enumerate(terms):
        try:
            defined.append(replace(term, factors=tuple(factor.defined(constructed) for factor in term.factors)))
        except ModelError as error:
            raise ModelError(f"terms[{i}]: {error}") from None
    return tuple(defined)


def check_products(terms: Sequence[Term], inputs: Ranges) -> None:
    """Raise ModelError if a term can grow too large over the ranges of inputs."""
    for i, term in enumerate(terms):
        if not _bound_product(term, inputs) <= NumberLimits.MAX_PRODUCT:
            text = f"can grow beyond {NumberLimits.MAX_PRODUCT:g} in the input envelope; expected lower powers"
            raise ModelError(f"terms[{i}]: {text}")


def _bound_product(term: Term, inputs: Ranges) -> float:
    """Return a bound on the term's product over the ranges, and on every part of that product."""
    sizes = [max(1.0, *map(abs, f.signal_range(inputs))) ** f.power for f in term.inputs]
    return prod([max(1.0, abs(term.coefficient)), *sizes])
