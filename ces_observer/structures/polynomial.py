"""A polynomial NARX: its terms, its proof of stability, and the tables of its tick.

The terms are affine in past forces, so the free run is y(k) = sum_j a_j(u) y(k - j) + b(u), with u the present and past
inputs, each clamped to the envelope. If sum_j |a_j(u)| <= g < 1 for every u in the envelope, the recursion is a
contraction: two runs from different pasts approach each other as g^(k / longest output lag), and from a past of zeros
|y| <= max |b| / (1 - g) at all times; holding y in a force envelope that contains zero changes neither.
`ces_observer.proof.intervals` bounds both maxima; every lagged input may take any value in its range. Memberships are
functions of their signals in these bounds, so sub-models blended by them are bounded together.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from math import inf, isfinite
from typing import Self

from ces_observer.errors import ModelError
from ces_observer.fields import Field
from ces_observer.flat import ArrayLayout
from ces_observer.limits import FileLimits
from ces_observer.proof.certificate import Contraction, contraction_s
from ces_observer.proof.intervals import bound_maximum, down
from ces_observer.records import OneOf, in_files, items
from ces_observer.structures.constructed_inputs import BASE, KINDS, ConstructedInput, lay_out_constructed, with_bases
from ces_observer.structures.structure import INPUTS, OperatingRange, Ranges, Structure
from ces_observer.structures.terms import Factor, Term, check_products, collect_constructed, define_factors
from ces_observer.tick import polynomial as tick
from ces_observer.tick.structure import POLYNOMIAL

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
