"""The parts of the exported C that depend on a polynomial's terms: powers of the inputs, their histories, and the sum.

templates/polynomial.{c,h}.j2 hold the C.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from math import pi

from ces_identify.export.c_text import constructed_variable, number
from ces_observer.model import Model
from ces_observer.structures.constructed_inputs import ConstructedInput, Frequency, Lag, TriangularMembership
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

MAX_PRODUCT_POWER = 4.0  # multiples of 1/2 up to here become products and a square root, other powers pow()

Power = tuple[str, float, bool]  # signal, power, signed


@dataclass(frozen=True)
class Ring:
    """A ring buffer of the last `size` (a power of two) values of the variable `name`."""

    name: str
    size: int


def polynomial_facts(polynomial: Polynomial, model: Model) -> dict[str, object]:
    """Return the inputs, powers, rings, lagged variables and products of the tick, in the order of the C."""
    factors = [factor for term in polynomial.terms for factor in term.factors]
    powers = sorted({_power(f) for f in factors if f.signal != "force"})
    constructed = polynomial.constructed
    used = {f.signal for f in factors} | {signal for one in constructed for signal in one.signals}
    rings = {ring.name: ring for ring in _rings(factors)}
    lagged = sorted({(_variable(f), f.lag) for f in factors if f.lag})
    ordered = sorted(polynomial.terms, key=_place)
    return {
        "inputs": [
            {"name": name, "argument": argument, "low": low, "high": high}
            for argument, (low, high) in asdict(model.envelope).items()
            if (name := argument.partition("_")[0]) in used
        ],
        "remembering": [one for one in constructed if not isinstance(one, TriangularMembership)],
        "memberships": {
            constructed_variable(one.name): _membership(one, constructed)
            for one in constructed
            if isinstance(one, TriangularMembership)
        },
        "constants": {"TWO_PI": 2.0 * pi} if any(isinstance(one, Frequency) for one in constructed) else {},
        "gains": {
            one.name: one.gain(model.sampling.rate_Hz) for one in constructed if isinstance(one, Frequency | Lag)
        },
        "values": _values(powers),
        "rings": list(rings.values()),
        "histories": [ring for ring in rings.values() if ring.name != "force"],
        "forces": rings.get("force"),
        "reads": [{"name": f"{name}_lag{lag}", "ring": rings[name], "lag": lag} for name, lag in lagged],
        "constant": sum(t.coefficient for t in polynomial.terms if not t.factors),
        "products": [_product(term) for term in ordered if term.factors],
    }


def _membership(membership: TriangularMembership, constructed: Iterable[ConstructedInput]) -> str:
    """Return the expression for a membership."""
    signal = (
        constructed_variable(membership.of) if membership.of in {one.name for one in constructed} else membership.of
    )
    low, high = (
        "1.0" if end is None else f"membership({signal}, {number(membership.peak)}, {number(end)})"
        for end in (membership.low, membership.high)
    )
    return f"({signal} < {number(membership.peak)}) ? {low} : {high}"


def _values(powers: Iterable[Power]) -> dict[str, str]:
    """Return the variables to compute at a tick with their expressions, in order of dependence."""
    values: dict[str, str] = {}
    for signal, power, signed in powers:
        if signed and power == 1.0:
            continue  # the clamped input itself
        magnitudes = [power] if power == 0.0 else [1.0, power]
        if _is_product(power) and power % 1.0:
            magnitudes.insert(1, 0.5)
        for p in magnitudes:
            values[_name((signal, p, False))] = _magnitude(signal, p)
        if signed:
            values[_name((signal, power, True))] = f"copysign({_name((signal, power, False))}, {signal})"
    return values


def _magnitude(signal: str, power: float) -> str:
    """Return the expression for |signal|^power."""
    if power == 1.0:
        return f"fabs({signal})"
    magnitude, root = _name((signal, 1.0, False)), _name((signal, 0.5, False))
    if power == 0.5:
        return f"sqrt({magnitude})"
    if not _is_product(power):
        return f"pow({magnitude}, {number(power)})"
    return " * ".join([magnitude] * int(power) + [root] * (power % 1.0 > 0.0)) or "1.0"


def _is_product(power: float) -> bool:
    return (2.0 * power).is_integer() and power <= MAX_PRODUCT_POWER


def _rings(factors: Iterable[Factor]) -> list[Ring]:
    """Return a ring for each lagged variable, just long enough for its longest lag."""
    deepest: dict[str, int] = {}
    for f in factors:
        deepest[_variable(f)] = max(f.lag, deepest.get(_variable(f), 0))
    return [Ring(name, 1 << lag.bit_length()) for name, lag in sorted(deepest.items()) if lag]


def _place(term: Term) -> int:
    """Return the sort key of a term's shape, in the order of `ces_observer.structures.polynomial`: roundings agree."""
    shapes = {(False, 1): 0, (False, 2): 1, (True, 1): 2, (True, 2): 3}
    return shapes.get((term.output_lag > 0, len(term.inputs)), 4)


def _product(term: Term) -> str:
    force = [f"force_lag{term.output_lag}"] if term.output_lag else []
    inputs = [_variable(f) + (f"_lag{f.lag}" if f.lag else "") for f in term.inputs]
    if force and _place(term) == 4 and inputs:
        return f"{force[0]} * ({' * '.join([number(term.coefficient), *inputs])})"
    return " * ".join([number(term.coefficient), *force, *inputs])


def _variable(factor: Factor) -> str:
    return "force" if factor.signal == "force" else _name(_power(factor))


def _power(factor: Factor) -> Power:
    signal = factor.signal if factor.definition is None else constructed_variable(factor.signal)
    return signal, float(factor.power), factor.signed


def _name(power: Power) -> str:
    """Return the variable of a power: `speed`, `speed_abs`, or for the power 1/2 `speed_p0_5`, `speed_abs_p0_5`."""
    signal, exponent, signed = power
    digits = repr(exponent).removesuffix(".0").replace(".", "_").replace("-", "m").replace("+", "")
    return signal + ("" if signed else "_abs") + ("" if exponent == 1.0 else f"_p{digits}")
