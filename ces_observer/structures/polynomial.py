"""A polynomial NARX: its terms, free run and proof of stability.

The terms are affine in past forces, so the free run is y(k) = sum_j a_j(u) y(k - j) + b(u), with u the present and past
inputs, each clamped to the envelope. If sum_j |a_j(u)| <= g < 1 for every u in the envelope, the recursion is a
contraction: two runs from different pasts approach each other as g^(k / longest output lag), and from a past of zeros
|y| <= max |b| / (1 - g) at all times; holding y in a force envelope that contains zero changes neither.
`ces_observer.proof.intervals` bounds both maxima; every lagged input may take any value in its range. Memberships are
functions of their signals in these bounds, so sub-models blended by them are bounded together.

The tick is a function whose Python source is written for the terms and compiled, as `dataclasses` and `namedtuple` do:
without loops or look-ups it is more than three times as fast. Of a model file only numbers reach the text, as the
`repr` of a checked `float` or `int`; all names in it are those below, with a number. Constructed inputs are `made0`,
`made1`, ...

    size_speed  |speed|            power3  another power of a signal, in one of FORMS
    speed_2     speed 2 ticks ago  force_1  the model's own force one tick ago
    past_speed  the speeds kept for the lags, newest first: a deque of fixed length, empty before the first tick
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import copysign, isfinite, sqrt
from operator import index
from typing import Any, ClassVar, Protocol, Self

from ces_observer.errors import ModelError
from ces_observer.json_text import JsonObject
from ces_observer.proof.certificate import Contraction
from ces_observer.proof.intervals import bound_maximum, down
from ces_observer.structures.constructed_inputs import BASE, ConstructedInput, InputConstructor
from ces_observer.structures.structure import OperatingRange, Ranges, Structure, hold
from ces_observer.structures.terms import Factor, Term, collect_constructed, term_to_json, terms_from

FORMS = {0.0: "1.0", 0.5: "sqrt({0})", 1.0: "{0}", 1.5: "{0} * sqrt({0})", 2.0: "{0} * {0}"}

Power = tuple[str, float, bool]  # name of the signal in the text, power, signed


def tick_source(polynomial: Sequence[Term], within: OperatingRange) -> str:
    """Return the text of `make(run, update) -> tick, pasts, forces`, for one run of a polynomial's terms.

    `tick(position, speed, current)` returns the force [N], held in the force envelope, and sets `run.clamped` and
    `run.held`; `update` is that of an InputConstructor. To restart, empty the `pasts` and fill `forces` with zeros.
    The text uses abs, min, max, sqrt, copysign, hold and deque as globals. Raises ModelError for a number that is not
    finite or an unknown signal.
    """
    constructed = collect_constructed(polynomial)
    signals = {one.name: f"made{i}" for i, one in enumerate(constructed)} | {signal: signal for signal in BASE}
    powers = sorted({_power(f, signals) for term in polynomial for f in term.inputs})
    names = {power: _name(i, power) for i, power in enumerate(powers)}
    terms = [_Product(term, signals, names) for term in polynomial]
    pasts = sorted({(name, lag) for term in terms for name, lag in term.inputs if lag})
    lags = dict(pasts)  # the longest of each name, which comes last
    made = ", ".join(f"made{i}" for i in range(len(constructed)))
    outputs = sorted({term.output_lag for term in terms} - {0})
    low, high = (_number(limit, "the force envelope") for limit in within.force_N)
    tick = [
        *_clamp(within.inputs),
        *([f"position, speed, current, {made} = update((position, speed, current))"] if made else []),
        *_powers(names),
        *_keep(lags),
        *(f"{_ago(name, lag)} = past_{name}[{lag}]" for name, lag in pasts),
        *(f"{_ago('force', lag)} = forces[{lag - 1}]" for lag in outputs),
        # one term per line: a single expression of hundreds is too deep for the compiler
        *([f"force {'+=' if i else '='} {term}" for i, term in enumerate(terms)] or ["force = 0.0"]),
        f"run.held = held = not {low} <= force <= {high}",
        f"if held: force = hold(force, {low}, {high})",
        *(["forces.appendleft(force)"] if outputs else []),
        "return force",
    ]
    return "\n".join(
        [
            "def make(run, update):",
            *(f"    past_{name} = deque(maxlen={lag + 1})" for name, lag in lags.items()),
            f"    forces = deque(maxlen={max(outputs, default=0)})",
            "    def tick(position, speed, current):",
            *(f"        {line}" for line in tick),
            f"    return tick, [{', '.join(f'past_{name}' for name in lags)}], forces",
            "",
        ]
    )


class _Product:
    """A term in the text: its coefficient, the lag of its past force, and names and lags of its inputs."""

    def __init__(self, term: Term, signals: Mapping[str, str], names: Mapping[Power, str]) -> None:
        self.coefficient = _number(term.coefficient, "a coefficient")
        self.output_lag = index(term.output_lag)
        self.inputs = [(names[_power(f, signals)], index(f.lag)) for f in term.inputs]

    def __str__(self) -> str:
        past = [("force", self.output_lag)] if self.output_lag else []
        return " * ".join([self.coefficient, *(_ago(*value) for value in (*past, *self.inputs))])


def _power(factor: Factor, signals: Mapping[str, str]) -> Power:
    if factor.signal not in signals:
        raise ModelError(f"factor of {factor.signal!r}: no such signal; expected a definition, or one of {BASE}")
    return signals[factor.signal], _finite(factor.power, "a power"), bool(factor.signed)


def _name(i: int, power: Power) -> str:
    match power:
        case signal, 1.0, True:
            return signal
        case signal, 1.0, False:
            return f"size_{signal}"
    return f"power{i}"


def _ago(name: str, lag: int) -> str:
    return f"{name}_{lag}" if lag else name


def _number(value: float, what: str) -> str:
    return repr(_finite(value, what))


def _finite(value: float, what: str) -> float:
    """Return `value` as a plain finite float, whose `repr` can only be a number."""
    value = float(value)
    if not isfinite(value):
        raise ModelError(f"{what} of the model is {value!r}; expected a finite number: identify the model again")
    return value


def _clamp(inputs: Ranges) -> list[str]:
    bounds = {signal: [_number(bound, f"the envelope of {signal}") for bound in inputs[signal]] for signal in BASE}
    return [
        "if " + " and ".join(f"{low} <= {signal} <= {high}" for signal, (low, high) in bounds.items()) + ":",
        "    run.clamped = False",
        "else:",
        "    run.clamped = True",
        *(f"    {signal} = min(max({signal}, {low}), {high})" for signal, (low, high) in bounds.items()),
    ]


def _powers(names: Mapping[Power, str]) -> list[str]:
    """Compute each power once; a signed power copies the sign to the unsigned one if that is used, too."""
    sizes = sorted({signal for signal, power, signed in names if (power, signed) != (1.0, True)})
    lines = [f"size_{signal} = abs({signal})" for signal in sizes]
    for (signal, power, signed), name in names.items():
        form = FORMS.get(power, f"{{0}} ** {_number(power, 'a power')}").format(f"size_{signal}")
        if signed:
            form = f"copysign({names.get((signal, power, False), form)}, {signal})"
        lines += [f"{name} = {form}"] if power != 1.0 else []
    return lines


def _keep(lags: Mapping[str, int]) -> list[str]:
    """Push the values used later; at the first tick, fill the past with them."""
    first = [f"    past_{name}.extend([{name}] * {lag})" for name, lag in lags.items()]
    begin = [f"if not past_{next(iter(lags))}:", *first] if lags else []
    return begin + [f"past_{name}.appendleft({name})" for name in lags]


IN_REACH = {"abs": abs, "min": min, "max": max, "sqrt": sqrt, "copysign": copysign, "hold": hold, "deque": deque}
DRIVE_GAP, DRIVE_BOXES = 0.05, 4_000  # the drive has many inputs, and its bound need not be tight
CLAIM = "sum |a_j(u)| <= gain < 1 and |b(u)| <= drive_N for every input in the input envelope"
METHOD = "interval branch and bound, outward rounding"


@dataclass(frozen=True)
class Polynomial(Structure):
    """The sum of its terms."""

    name: ClassVar[str] = "polynomial_narx"
    keys: ClassVar[tuple[str, ...]] = ("terms", "constructed")
    option: ClassVar[str] = "polynomial"
    rank: ClassVar[int] = 0

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
        """Return the force [N] at inputs [m, m/s, A], held in its envelope; infinite if it is not finite."""


class PolynomialRun:
    """The free run of a polynomial; `clamped`, `held`: the last tick's inputs, force were outside the envelope.

    `tick` is compiled from the source that `tick_source` writes. Raises ModelError for a number that is not finite.
    """

    clamped: bool
    held: bool
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
        self.clamped = self.held = False


Make = Callable[[PolynomialRun, Callable[..., list[float]]], tuple[Tick, list[deque[float]], deque[float]]]


def _compile(source: str) -> Make:
    """Return `make` from the source of a tick, which can use only IN_REACH."""
    names: dict[str, Any] = {"__builtins__": {}, **IN_REACH}
    exec(compile(source, "<tick of a polynomial model>", "exec"), names)
    make: Make = names["make"]
    return make
