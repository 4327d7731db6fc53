"""A polynomial NARX: its terms (products of powers of signals), its proof of stability, and the tables of its tick.

The terms are affine in past forces, so the free run is y(k) = sum_j a_j(u) y(k - j) + b(u), with u the present and past
inputs, each clamped to the envelope. If sum_j |a_j(u)| <= g < 1 for every u in the envelope, the recursion is a
contraction: two runs from different pasts approach each other as g^(k / longest output lag), and from a past of zeros
|y| <= max |b| / (1 - g) at all times; holding y in a force envelope that contains zero changes neither.
`ces_observer.proof.intervals` bounds both maxima; every lagged input may take any value in its range. Memberships are
functions of their signals in these bounds, so sub-models blended by them are bounded together.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from math import copysign, inf, isfinite, prod
from typing import Self

from ces_observer.errors import ModelError
from ces_observer.fields import Field
from ces_observer.flat import ArrayLayout
from ces_observer.limits import FileLimits, NumberLimits
from ces_observer.proof.certificate import Contraction, contraction_s
from ces_observer.proof.intervals import Interval, bound_maximum, down, up
from ces_observer.records import OneOf, bounded, in_files, items, part
from ces_observer.structures.constructed_inputs import (
    BASE,
    KINDS,
    ConstructedInput,
    TriangularMembership,
    lay_out_constructed,
    with_bases,
)
from ces_observer.structures.structure import INPUTS, OperatingRange, Range, Ranges, Structure
from ces_observer.tick import polynomial as tick
from ces_observer.tick.structure import POLYNOMIAL

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


Row = tuple[float, int, int]  # coefficient, and places of two factors
HYSTERESES = ("stop", "play")  # constructed inputs that keep their past at rest
DRIVE_GAP, DRIVE_BOXES = 0.05, 4_000  # the drive has many inputs, and its bound need not be tight
CLAIM = "sum |a_j(u)| <= gain < 1 and |b(u)| <= drive_N for every input in the input envelope"
METHOD = "interval branch and bound, outward rounding"
DEFINITIONS = Field(
    key="constructed",
    of="constructed",
    optional=True,
    kind=OneOf(KINDS),
    many=True,
    min_count=1,
    max_count=FileLimits.MAX_ITEMS,
)


@dataclass(frozen=True)
class Polynomial(Structure):
    """The sum of its terms. A file has the definitions of their factors beside them."""

    name, option, rank = "polynomial_narx", "polynomial", 0
    number, runs = POLYNOMIAL, (tick.polynomial_reset, tick.polynomial_tick)

    definitions: tuple[ConstructedInput, ...] = field(
        default=(), kw_only=True, repr=False, metadata=in_files(DEFINITIONS)
    )
    terms: tuple[Term, ...] = items(1, FileLimits.MAX_TERMS)

    def checked(self) -> Self:
        """Return it with the definitions at the factors; raises ModelError."""
        return type(self)(define_factors(self.terms, with_bases(self.definitions)))

    def check_over(self, inputs: Ranges) -> None:
        """Raise ModelError if a term can grow too large over the ranges of inputs."""
        check_products(self.terms, inputs)

    @property
    def constructed(self) -> tuple[ConstructedInput, ...]:
        """The constructed inputs of its terms, each after those from which it is computed."""
        return collect_constructed(self.terms)

    @property
    def uses(self) -> Sequence[str]:
        """The inputs in its terms, and those from which constructed inputs are computed."""
        used = {f.signal for term in self.terms for f in term.inputs}.union(
            *(made.signals for made in self.constructed)
        )
        return [name for name in INPUTS if name in used]

    @property
    def size(self) -> str:
        """The size, in words."""
        return f"{len(self.terms)} terms"

    def fill(self, layout: ArrayLayout, within: OperatingRange) -> None:
        """Write the tables of the tick; raises ModelError for a number that is not finite or an unknown signal."""
        for term in self.terms:
            _require_finite(term)
        layout.reserve(0, tick.N_POLYNOMIAL, tick.S_POLYNOMIAL, 0)
        constructed = self.constructed
        table, signals = lay_out_constructed(layout, constructed, within.rate_Hz, tick.POSITION_VALUE)
        layout.n[tick.CONSTRUCTED_TABLE] = table
        layout.n[tick.CONSTRUCTED_COUNT] = len(constructed)
        factors = dict.fromkeys(f for term in self.terms for f in term.inputs)
        _lay_out_terms(layout, self.terms, _lay_out_powers(layout, factors, signals, within.inputs))

    def certify(self, within: OperatingRange) -> Contraction:
        """Return the proved bounds, which may be loose (never wrong) at the limit of boxes."""
        gain, boxes = bound_maximum(self._by_output_lag(), within.inputs)
        inputs_alone = [term for term in self.terms if not term.output_lag]
        drive, more = bound_maximum([inputs_alone], within.inputs, gap=DRIVE_GAP, max_boxes=DRIVE_BOXES)
        return Contraction(gain, drive, boxes + more, CLAIM, METHOD, self._forgets_s(gain, within.rate_Hz))

    @property
    def keeps_past(self) -> bool:  # type: ignore[override]  # of other structures, none does
        """True if an input has hysteresis."""
        return any(made.kind in HYSTERESES for made in self.constructed)

    def _forgets_s(self, gain: float, rate_Hz: float) -> float:
        """Return how long the past counts; it is not proved for constructed inputs with a past of their own."""
        if any(made.kind != "hat" for made in self.constructed):
            return inf
        past = max((term.output_lag for term in self.terms), default=0)
        return contraction_s(gain, past, max((f.lag for t in self.terms for f in t.inputs), default=0), rate_Hz)

    def is_stable(self, within: OperatingRange) -> bool:
        """Return whether it is proved to be a contraction, without a tight gain."""
        return bound_maximum(self._by_output_lag(), within.inputs, enough=down(1.0))[0] < 1.0

    def _by_output_lag(self) -> list[list[Term]]:
        lags = sorted({term.output_lag for term in self.terms if term.output_lag})
        return [[term for term in self.terms if term.output_lag == lag] for lag in lags]


def _require_finite(term: Term) -> None:
    for what, value in (("a coefficient", term.coefficient), *(("a power", f.power) for f in term.inputs)):
        if not isfinite(value):
            raise ModelError(f"{what} of the model is {value!r}; expected a finite number: identify the model again")


def _lay_out_powers(
    layout: ArrayLayout, factors: Iterable[Factor], signals: Mapping[str, int], ranges: Ranges
) -> dict[Factor, int]:
    """Write the table of powers; returns the place in s of each factor's value of the same tick."""
    powers = dict[Factor, tuple[int, float, bool]]()
    for f in factors:
        if f.signal not in signals:
            raise ModelError(f"factor of {f.signal!r}: no such signal; expected a definition, or one of {BASE}")
        if f.power != 1.0 or not (f.signed or f.signal_range(ranges)[0] >= 0.0):  # else it is the signal itself
            powers[f] = signals[f.signal], f.power, f.signed
    places = {power: layout.state(1) for power in sorted(set(powers.values()))}
    layout.n[tick.POWER_TABLE] = layout.indices(n for source, _, signed in places for n in (source, signed))
    layout.n[tick.POWER_COUNT] = len(places)
    layout.n[tick.POWER_EXPONENTS] = layout.table(power for _, power, _ in places)
    return {f: places[powers[f]] if f in powers else signals[f.signal] for f in factors}


def _lay_out_terms(layout: ArrayLayout, terms: Sequence[Term], values: Mapping[Factor, int]) -> None:
    """Write the tables of lags and terms; `values` are the places in s of the factors without their lags."""
    lagged = {key: layout.state(1) for key in sorted({(place, f.lag) for f, place in values.items() if f.lag})}
    state_at = layout.state(sum(max(0, len(term.inputs) - 2) for term in terms))
    groups = {lag: [term for term in terms if term.output_lag == lag] for lag in (0, *(t.output_lag for t in terms))}
    products, rows = list[Row](), list[Row]()
    for term in chain.from_iterable(groups.values()):
        factors = [lagged[values[f], f.lag] if f.lag else values[f] for f in term.inputs]
        *more, last = _rows(term.coefficient, factors, state_at + len(products))
        products += more
        rows.append(last)
    inputs = groups.pop(0)
    layout.n[tick.LAG_TABLE] = layout.indices(n for place, lag in lagged for n in (place, *_ring(layout, lag)))
    layout.n[tick.LAG_COUNT] = len(lagged)
    rows_of_lags = ((len(group), *_ring(layout, lag)) for lag, group in groups.items())
    layout.n[tick.OUTPUT_LAG_TABLE] = layout.indices(chain.from_iterable(rows_of_lags))
    layout.n[tick.OUTPUT_LAG_COUNT] = len(groups)
    layout.n[tick.TERM_COEFFICIENTS] = layout.table(row[0] for row in products + rows)
    layout.n[tick.TERM_FACTORS] = layout.indices(place for row in products + rows for place in row[1:])
    layout.n[tick.PRODUCT_COUNT] = len(products)
    layout.n[tick.INPUT_TERM_COUNT] = len(inputs)
    layout.memory(len(lagged) + len(groups))


def _rows(coefficient: float, factors: Sequence[int], product: int) -> list[Row]:
    """Return a term, the last row, after the products that it needs if it has more than two factors.

    The first product's place is s[product]. All are multiplied from left to right, as in the kernels of the desk.
    """
    rows = list[Row]()
    while len(factors) > 2:
        rows.append((coefficient, factors[0], factors[1]))
        coefficient, factors = 1.0, [product + len(rows) - 1, *factors[2:]]
    first_factor, second_factor = [*factors, tick.UNITY, tick.UNITY][:2]
    return [*rows, (coefficient, first_factor, second_factor)]


def _ring(layout: ArrayLayout, lag: int) -> tuple[int, int]:
    begin = layout.state(lag)
    return begin, begin + lag
