"""The schema of candidate rules: which signals, lags, powers and products make the terms of a polynomial."""

from __future__ import annotations

from ces_cli.discovery.schemas.parts import (
    NUMBER,
    TEXT,
    Schema,
    list_of,
    mapping_of,
    number_between,
    one_of,
    with_description,
)
from ces_identify.polynomial.constructed_rules import AUTO, MAX_MEMBERSHIPS, MEMBERSHIPS, RULE_KINDS
from ces_identify.polynomial.regressors import MAX_LAG_MS, SIGNALS
from ces_identify.polynomial.term_list import FORMS
from ces_observer.structures.constructed_file import MAX_WIDTH, MIN_WIDTH, SETTINGS
from ces_observer.structures.constructed_inputs import BASE
from ces_observer.structures.structure import MAX_LAG
from ces_observer.structures.terms_file import MAX_FACTORS, MAX_POWER, MAX_TERMS

RULE, FORCE_RULE, AGAIN = "#/definitions/rule", "#/definitions/force", "again"
SETTING: dict[str, Schema] = {
    "half_width": number_between(MIN_WIDTH, MAX_WIDTH),
    "time_constant_s": number_between(1e-4, 1e4),
    "range_Hz": {**list_of(number_between(1e-3, 1e5)), "minItems": 2, "maxItems": 2},
    "floor_m": number_between(MIN_WIDTH, MAX_WIDTH),
}
OPEN_LAG: Schema = {"anyOf": [{"const": AUTO}, SETTING["time_constant_s"]]}


def candidates_schema() -> Schema:
    """Return the schema; keys besides the signals are names of constructed inputs, which `constructed` defines."""
    rule: Schema = {"$ref": RULE}
    properties: dict[str, Schema] = {
        "force": {"$ref": FORCE_RULE},
        **{signal: rule for signal in SIGNALS if signal != "force"},
        "constructed": {"type": "object", "additionalProperties": _construction()},
        "products": with_description(
            list_of({**list_of(TEXT), "maxItems": MAX_FACTORS}, 1), "signals whose factors are multiplied in a term"
        ),
        "initial": with_description(_terms(), "terms to start from with --method thesis"),
    }
    whole = mapping_of(properties)
    whole["additionalProperties"] = rule
    whole["definitions"] = {"rule": _rule(), "force": _force_rule()}
    return whole


def _lags(least: int) -> Schema:
    return with_description(list_of(number_between(least, MAX_LAG, whole=True), 1), "in ticks of the model's rate")


def _rule() -> Schema:
    schema = mapping_of(
        {
            "lags": _lags(0),
            "lags_ms": with_description(list_of(number_between(0.0, MAX_LAG_MS), 1), "in milliseconds"),
            "powers": list_of(number_between(0.0, MAX_POWER), 1),
            "forms": list_of(one_of(FORMS), 1),
            AGAIN: {"$ref": RULE},
        }
    )
    return {**schema, "oneOf": [{"required": ["lags"]}, {"required": ["lags_ms"]}]}


def _force_rule() -> Schema:
    """Return the schema of the rule for past forces, whose other keys are signals that multiply them."""
    plain = {"lags": _lags(1), "powers": list_of(NUMBER, 1), "forms": list_of(one_of(FORMS), 1)}
    return {**mapping_of(plain, ("lags",)), "additionalProperties": {"$ref": RULE}}


def _terms() -> Schema:
    factor = mapping_of(
        {
            "signal": TEXT,
            "lag": number_between(0, MAX_LAG, whole=True),
            "power": number_between(0.0, MAX_POWER),
            "form": one_of(FORMS),
        },
        ("signal",),
    )
    return {**list_of({**list_of(factor), "maxItems": MAX_FACTORS}, 1), "maxItems": MAX_TERMS}


def _construction() -> Schema:
    branches = []
    for kind in RULE_KINDS:
        if kind == MEMBERSHIPS:
            peaks = {**list_of(NUMBER, 2), "maxItems": MAX_MEMBERSHIPS}
            branches.append(mapping_of({"kind": {"const": kind}, "of": TEXT, "at": peaks}, ("kind", "of", "at")))
            continue
        own = {key: one_of(BASE) if key == "of" else SETTING[key] for key in SETTINGS[kind]}
        own |= {"time_constant_s": OPEN_LAG} if kind == "lag" else {}
        required = ("kind",) if kind == "frequency" else ("kind", *SETTINGS[kind])
        branches.append(mapping_of({"kind": {"const": kind}, **own}, required))
    return {"oneOf": branches}
