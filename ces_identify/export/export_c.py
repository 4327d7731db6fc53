"""A model as one self-contained C99 source file and its header: the estimator for a microcontroller.

A checked `Model` goes in, two texts come out. They do what `ces_observer.estimator.Estimator` does, operation by
operation, so that forces and reasons agree. templates/estimator.{c,h}.j2 hold the C; here is what depends on the terms:
which powers of the inputs are computed, how long each is remembered, and the sum. Of the model only numbers reach the
texts, and identifiers are made here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from math import ceil, isfinite, pi, sqrt

from jinja2 import Environment, StrictUndefined

from ces_observer import __version__, estimator, tracker
from ces_observer.errors import ModelError
from ces_observer.model import Factor, Model, Term
from ces_observer.proof.certificate import Certificate
from ces_observer.structures.constructed import Constructed, Frequency, Hat, Lag

REASONS: Mapping[str, str] = {
    "OK": tracker.OK,
    "WARMING_UP": estimator.WARMING_UP,
    "NOT_FINITE": tracker.NOT_FINITE,
    "OUT_OF_ORDER": tracker.OUT_OF_ORDER,
    "OUTLIER": tracker.OUTLIER,
    "UNBOUNDED": estimator.UNBOUNDED,
}
ARGUMENTS = {"position": "position_m", "speed": "speed_m_s", "current": "current_A"}
MOST_BY_PRODUCTS = 4.0  # powers that are multiples of 1/2 up to here are products and a square root, others pow()
LONGEST_NAME = 31  # characters of an external identifier that C99 promises to tell apart
NAME_ENDING = "_past_reset"  # the longest of those added to a name
STANDARD_HEADERS = ("float", "math", "stdbool", "stdint")

Power = tuple[str, float, bool]  # signal, power, signed


@dataclass(frozen=True)
class Ring:
    """The last `size` (a power of two) values of the variable `name`."""

    name: str
    size: int


@dataclass(frozen=True)
class Read:
    """A local variable that holds what `ring` held `lag` ticks ago."""

    name: str
    ring: Ring
    lag: int


def export_c(model: Model, name: str, file_stem: str, certificate: Certificate) -> tuple[str, str]:
    """Return the texts of FILE_STEM.c and FILE_STEM.h, whose identifiers begin with `name`.

    `certificate` is told in comments. Raises ModelError if the model cannot be written in C, or a name cannot be used.
    """
    require_exportable(model, name, file_stem)
    facts = {
        "name": name,
        "NAME": name.upper(),
        "source_file": f"{file_stem}.c",
        "header_file": f"{file_stem}.h",
        "version": __version__,
        "digest": model.digest(),
        "certificate": certificate,
        "model": model,
        "reasons": REASONS,
        **_sampling(model),
        **_polynomial(model),
    }
    environment = Environment(
        autoescape=False, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters.update(number=number, made=made)
    texts = [environment.from_string(_template(kind)).render(facts) for kind in ("c", "h")]
    return texts[0], texts[1]


def require_exportable(model: Model, name: str, file_stem: str) -> None:
    """Raise ModelError if `export_c` could not write this model under these names."""
    if model.structure != "polynomial_narx":
        raise ModelError(f"structure is {model.structure}; only polynomial_narx can be written in C so far")
    if identifier(name) != name.lower() or not name.isascii():
        raise ModelError(f"name '{name}': not usable in C; choose one such as '{identifier(name)}'")
    if not re.fullmatch(r"[0-9A-Za-z][0-9A-Za-z_.-]*", file_stem) or file_stem in STANDARD_HEADERS:
        raise ModelError(f"file name '{file_stem}.c': choose one of letters, digits and _ that is no standard header's")


def identifier(text: str) -> str:
    """Return `text` made into the beginning of C identifiers, such as `my-damper 2` into `my_damper_2`."""
    name = re.sub(r"[^0-9A-Za-z]+", "_", text).strip("_").lower()
    name = f"model_{name}" if not name or name[0].isdigit() else name
    return name[: LONGEST_NAME - len(NAME_ENDING)].rstrip("_")


def number(value: float) -> str:
    """Return a C literal of type double that reads back as exactly `value`. Raises ModelError if it is not finite."""
    if not isfinite(value):
        raise ModelError(f"the model holds {value!r}; expected finite numbers only")
    return repr(float(value))


def _template(kind: str) -> str:
    return (resources.files("ces_identify.export") / "templates" / f"estimator.{kind}.j2").read_text(encoding="utf-8")


def _sampling(model: Model) -> dict[str, object]:
    """Return the numbers of the tracker, each computed as the tracker and its differentiator compute it."""
    s = model.sampling
    damping = 0.5 if s.order == 3 else sqrt(0.5)
    settling_s = tracker.SETTLING / (2.0 * pi * s.bandwidth_Hz)
    return {
        "order": s.order,
        "ticks_per_ns": s.rate_Hz * 1e-9,
        "max_gap_s": s.max_gap_s,
        "max_gap_ns": round(s.max_gap_s * 1e9),
        "most_ticks": ceil(s.max_gap_s * s.rate_Hz) + 1,
        "patience": tracker.PATIENCE,
        "overdue_s": tracker.OVERDUE / s.rate_Hz,
        "settling_s": settling_s,
        "settling_ticks": settling_s * s.rate_Hz,
        "doubt_s": tracker.DOUBT * settling_s,
        "doubt_ticks": tracker.DOUBT * (settling_s * s.rate_Hz),
        "largest_change_m_s": tracker.LARGEST_CHANGE * 2.0 * pi * s.bandwidth_Hz * s.outlier_m,
        "warm_up_ticks": round(s.warm_up_s * s.rate_Hz),
        "decay": -damping * 2.0 * pi * s.bandwidth_Hz,
        "turn": sqrt(1.0 - damping * damping) * 2.0 * pi * s.bandwidth_Hz,
    }


def _polynomial(model: Model) -> dict[str, object]:
    """Return inputs, powers, rings, reads and products of the tick, in the order they stand there."""
    factors = [factor for term in model.terms for factor in term.factors]
    powers = sorted({_power(f) for f in factors if f.signal != "force"})
    constructed = model.constructed
    used = {f.signal for f in factors} | {signal for one in constructed for signal in one.signals}
    rings = {ring.name: ring for ring in _rings(factors)}
    lagged = sorted({(_variable(f), f.lag) for f in factors if f.lag})
    ordered = sorted(model.terms, key=_place)
    return {
        "inputs": _inputs(model, used),
        "remembering": [one for one in constructed if not isinstance(one, Hat)],
        "memberships": {made(one.name): _membership(one, constructed) for one in constructed if isinstance(one, Hat)},
        "two_pi": 2.0 * pi,
        "gains": {
            one.name: one.gain(model.sampling.rate_Hz) for one in constructed if isinstance(one, Frequency | Lag)
        },
        "values": _values(powers),
        "rings": list(rings.values()),
        "histories": [ring for ring in rings.values() if ring.name != "force"],
        "forces": rings.get("force"),
        "reads": [Read(f"{name}_lag{lag}", rings[name], lag) for name, lag in lagged],
        "constant": sum(t.coefficient for t in model.terms if not t.factors),
        "products": [_product(term) for term in ordered if term.factors],
    }


def _inputs(model: Model, used: set[str]) -> list[dict[str, object]]:
    e = model.envelope
    ranges = {"position": e.position_m, "speed": e.speed_m_s, "current": e.current_A}
    return [
        {"name": name, "argument": ARGUMENTS[name], "low": low, "high": high}
        for name, (low, high) in ranges.items()
        if name in used
    ]


def made(name: str) -> str:
    """Return the variable of a constructed input."""
    return f"made_{name}"


def _membership(hat: Hat, constructed: Iterable[Constructed]) -> str:
    """Return the expression for a membership."""
    signal = made(hat.of) if hat.of in {one.name for one in constructed} else hat.of
    low, high = (
        "1.0" if end is None else f"membership({signal}, {number(hat.peak)}, {number(end)})"
        for end in (hat.low, hat.high)
    )
    return f"({signal} < {number(hat.peak)}) ? {low} : {high}"


def _values(powers: Iterable[Power]) -> dict[str, str]:
    """Return the variables to compute at a tick, each with its expression, those that others need first."""
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
    return (2.0 * power).is_integer() and power <= MOST_BY_PRODUCTS


def _rings(factors: Iterable[Factor]) -> list[Ring]:
    """Return a ring for each variable that is read at a lag, just long enough for its longest."""
    deepest: dict[str, int] = {}
    for f in factors:
        deepest[_variable(f)] = max(f.lag, deepest.get(_variable(f), 0))
    return [Ring(name, 1 << lag.bit_length()) for name, lag in sorted(deepest.items()) if lag]


def _place(term: Term) -> int:
    """Sort terms by shape as `ces_observer.structures.polynomial` sums them, so that roundings agree, too."""
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
    signal = factor.signal if factor.definition is None else made(factor.signal)
    return signal, float(factor.power), factor.signed


def _name(power: Power) -> str:
    """Return the variable of a power: `speed`, `speed_abs`, `speed_p0_5` and `speed_abs_p0_5` for powers 1 and 1/2."""
    signal, exponent, signed = power
    digits = repr(exponent).removesuffix(".0").replace(".", "_").replace("-", "m").replace("+", "")
    return signal + ("" if signed else "_abs") + ("" if exponent == 1.0 else f"_p{digits}")
