"""The axes that a campaign can vary, of one structure or of all: options of an identification, each with a default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ces_identify.campaign.plan import AUTO, BUILT_IN
from ces_identify.options import BANDWIDTH, CANDIDATES, CERTIFICATE, METHOD, RATE, SEED, TERMS
from ces_identify.structures import KITS
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_observer.errors import CesError
from ces_observer.fields import Schema
from ces_observer.options import Option


def _by_name(*options: Option) -> dict[str, Option]:
    return {option.name: option for option in options}


RULES = replace(CANDIDATES, kind=str, default=BUILT_IN, form=f"{BUILT_IN} or a rules file")
STRUCTURES: Mapping[str, Mapping[str, Option]] = {
    **{kit.option: _by_name(*kit.sizes) for kit in KITS.values()},
    POLYNOMIAL.option: _by_name(replace(TERMS, default=15), METHOD, RULES),
}
COMMON = _by_name(replace(RATE, default=AUTO), replace(BANDWIDTH, default=AUTO), CERTIFICATE, SEED)


def is_on_axis(axis: Option, value: Any) -> bool:
    """Return whether an axis can have the value; a text of an option, such as a size, may be a whole number."""
    try:
        axis.check(str(value) if axis.check_text is not None and type(value) is int else value)
    except CesError:
        return _may_be_auto(axis) and value == AUTO
    return True


def describe_axis(axis: Option) -> str:
    """Return a phrase for the values on an axis."""
    return f"{AUTO} or {axis.expected}" if _may_be_auto(axis) else axis.expected


def axis_schema(axis: Option) -> Schema:
    """Return the JSON Schema of an axis: a value, or a list of values without repetition."""
    one = {"type": ["string", "integer"]} if axis.check_text is not None else axis.bare_schema
    value = {"anyOf": [{"const": AUTO}, one]} if _may_be_auto(axis) else one
    several = {"type": "array", "items": value, "minItems": 1, "uniqueItems": True}
    return {"anyOf": [value, several], "description": describe_axis(axis)}


def _may_be_auto(axis: Option) -> bool:
    return axis.kind is float and axis.default == AUTO
