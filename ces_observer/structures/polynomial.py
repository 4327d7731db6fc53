"""A polynomial NARX: its terms, free run and proof of stability.

The terms are affine in past forces, so the free run is y(k) = sum_j a_j(u) y(k - j) + b(u), with u the present and past
inputs, each clamped to the envelope. If sum_j |a_j(u)| <= g < 1 for every u in the envelope, the recursion is a
contraction: two runs from different pasts approach each other as g^(k / longest output lag), and from a past of zeros
|y| <= max |b| / (1 - g) at all times. `ces_observer.proof.branch_and_bound` bounds both maxima; every lagged input may
take any value in its range. Memberships are functions of their signals in these bounds, so sub-models blended by them
are bounded together.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import copysign, inf, sqrt
from typing import Any, ClassVar, Protocol, Self

from ces_observer.json_checks import JsonObject
from ces_observer.proof.branch_and_bound import bound_maximum
from ces_observer.proof.certificate import Contraction
from ces_observer.proof.intervals import down
from ces_observer.structures.constructed_inputs import ConstructedInput, InputConstructor
from ces_observer.structures.structure import OperatingRange, Ranges, Structure
from ces_observer.structures.terms import Term, collect_constructed
from ces_observer.structures.terms_file import term_to_json, terms_from
from ces_observer.structures.tick_source import tick_source

IN_REACH = {"abs": abs, "min": min, "max": max, "sqrt": sqrt, "copysign": copysign, "inf": inf, "deque": deque}
DRIVE_GAP, DRIVE_BOXES = 0.05, 4_000  # the drive has many inputs, and its bound need not be tight
CLAIM = "sum |a_j(u)| <= gain < 1 and |b(u)| <= drive_N for every input in the input envelope"
METHOD = "interval branch and bound, outward rounding"


@dataclass(frozen=True)
class Polynomial(Structure):
    """The sum of its terms."""

    name: ClassVar[str] = "polynomial_narx"
    keys: ClassVar[tuple[str, ...]] = ("terms", "constructed")

    terms: tuple[Term, ...]

    @property
    def constructed(self) -> tuple[ConstructedInput, ...]:
        """The constructed inputs of its terms, each after those from which it is computed."""
        return collect_constructed(self.terms)

    @property
    def max_lag(self) -> int:
        """Longest lag of any factor in ticks."""
        return max((f.lag for t in self.terms for f in t.factors), default=0)

    @property
    def size(self) -> str:
        """The size, in words."""
        return f"{len(self.terms)} terms"

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the model file."""
        constructed = {"constructed": [one.to_json() for one in self.constructed]} if self.constructed else {}
        return {**constructed, "terms": [term_to_json(term) for term in self.terms]}

    @classmethod
    def from_json(cls, root: JsonObject, inputs: Ranges) -> Self:
        """Check the terms of a model file; raises ModelError."""
        return cls(terms_from(root, inputs))

    def make_predictor(self, within: OperatingRange) -> PolynomialRun:
        """Return a new free run; raises ModelError for a number that is not finite."""
        return PolynomialRun(self, within)

    def certify(self, within: OperatingRange) -> Contraction:
        """Return the proved bounds, which may be loose (never wrong) at the limit of boxes."""
        gain, boxes = bound_maximum(self._by_output_lag(), within.inputs)
        inputs_alone = [term for term in self.terms if not term.output_lag]
        drive, more = bound_maximum([inputs_alone], within.inputs, gap=DRIVE_GAP, max_boxes=DRIVE_BOXES)
        return Contraction(gain, drive, boxes + more, CLAIM, METHOD)

    def is_stable(self, within: OperatingRange) -> bool:
        """Return whether it is proved to be a contraction, without a tight gain."""
        return bound_maximum(self._by_output_lag(), within.inputs, enough=down(1.0))[0] < 1.0

    def _by_output_lag(self) -> list[list[Term]]:
        lags = sorted({term.output_lag for term in self.terms if term.output_lag})
        return [[term for term in self.terms if term.output_lag == lag] for lag in lags]


class Tick(Protocol):
    """The function of one tick."""

    def __call__(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick's inputs [m, m/s, A]; infinite if it left the force envelope."""


class PolynomialRun:
    """The free run of a polynomial; `clamped` is True if the last tick's inputs were outside the envelope.

    `tick` is compiled from the source that `ces_observer.structures.tick_source` writes. Raises ModelError for a number
    that is not finite.
    """

    clamped: bool
    tick: Tick

    def __init__(self, polynomial: Polynomial, within: OperatingRange) -> None:
        self._construction = InputConstructor(polynomial.constructed, within.rate_Hz)
        make = _compile(tick_source(polynomial.terms, within))
        self.tick, self._pasts, self._forces = make(self, self._construction.update)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        for past in self._pasts:
            past.clear()
        self._forces.extend([0.0] * (self._forces.maxlen or 0))
        self._construction.reset()
        self.clamped = False


Make = Callable[[PolynomialRun, Callable[..., list[float]]], tuple[Tick, list[deque[float]], deque[float]]]


def _compile(source: str) -> Make:
    """Return `make` from the source of a tick, which can use only IN_REACH."""
    names: dict[str, Any] = {"__builtins__": {}, **IN_REACH}
    exec(compile(source, "<tick of a polynomial model>", "exec"), names)
    make: Make = names["make"]
    return make
