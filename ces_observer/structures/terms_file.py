"""The list `terms` of a model file: products in, checked terms out, and back."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any

from ces_observer.errors import ModelError
from ces_observer.json_checks import JsonObject
from ces_observer.structures.constructed_file import MAX_CONSTRUCTED, parse_constructed
from ces_observer.structures.constructed_inputs import ConstructedInput, TriangularMembership
from ces_observer.structures.structure import MAX_LAG, Ranges
from ces_observer.structures.terms import Factor, Term

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
