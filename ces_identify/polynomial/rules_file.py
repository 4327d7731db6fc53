"""Files of candidate rules (YAML): read, checked, and described for editors.

candidates.yaml holds the built-in rules, thesis.yaml those of the thesis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

from ces_data.config_file import packaged_text, parse_yaml_mapping, read_yaml_mapping
from ces_identify.numerics.search import GAUSS_NEWTON, THESIS
from ces_identify.polynomial.candidate_rules import (
    FORMS,
    SIGNALS,
    CandidateRules,
    Constructions,
    SignalRule,
    merge_signs,
)
from ces_observer.errors import CesError, ModelError
from ces_observer.fields import Field, Schema, require_known_keys
from ces_observer.limits import FileLimits
from ces_observer.records import OneOf, Record, bounded, part, read_record, record_schema
from ces_observer.structures.constructed_inputs import (
    BASE,
    KINDS,
    PEAKS,
    ConstructedInput,
    TriangularMembership,
    make_memberships,
)
from ces_observer.structures.polynomial import Factor, Term

EXPECTED = f"candidate rules: {', '.join(SIGNALS)} and products"
MEMBERSHIPS = "hats"
AUTO, FIRST_GUESS_S = "auto", 0.01  # of a lag's time constant
MAX_MEMBERSHIPS = 20
MIN_PEAK_DISTANCE = 1e-6  # [m, m/s, A, Hz] of memberships
FREQUENCY = {"time_constant_s": 0.25, "range_Hz": [0.5, 20.0], "floor_m": 1e-4}  # defaults


@dataclass(frozen=True)
class InitialFactor:
    """A factor of a term to start from; a past force and a membership have neither power nor form."""

    signal: str = part()
    lag: int = bounded(0, FileLimits.MAX_LAG, default=0)
    power: float = bounded(0.0, FileLimits.MAX_POWER, default=1.0)
    form: str = part(default="signed", choices=tuple(FORMS))

    def checked(self) -> Self:
        """Return it; raises CesError for a factor that is always 1."""
        if self.power == 0.0 and not FORMS[self.form]:
            raise CesError("a magnitude to the power 0 is 1; leave the factor out")
        return self


@dataclass(frozen=True)
class Memberships:
    """Memberships over a signal, one for each of the ascending peaks `at`; they add up to one everywhere."""

    name: str = part()
    of: str = part()
    at: tuple[float, ...] = part(
        low=PEAKS[0], high=PEAKS[1], min_count=2, max_count=MAX_MEMBERSHIPS,
        form=f"2 to {MAX_MEMBERSHIPS} ascending peaks of the sub-models",
    )  # fmt: skip

    def checked(self) -> Self:
        """Return it; raises CesError unless the peaks ascend."""
        if any(b - a < MIN_PEAK_DISTANCE for a, b in pairwise(self.at)):
            raise CesError(f"at is {list(self.at)}; expected 2 to {MAX_MEMBERSHIPS} ascending peaks of the sub-models")
        return self


RULE_KINDS = {**{name: cls for name, cls in KINDS.items() if name != "hat"}, MEMBERSHIPS: Memberships}
CONSTRUCTED = Field(kind=OneOf(RULE_KINDS))
PRODUCTS = Field(
    kind=Field(many=True, max_count=FileLimits.MAX_FACTORS), many=True, min_count=1, form="a list of lists of signals",
    meaning="signals whose factors are multiplied in a term",
)  # fmt: skip
FACTOR = Field(kind=Record(InitialFactor), form="a factor such as {signal: speed, lag: 3, power: 0.4}")
INITIAL = Field(
    meaning="terms to start from with --method thesis",
    kind=Field(kind=FACTOR, many=True, max_count=FileLimits.MAX_FACTORS),
    many=True,
    min_count=1,
    max_count=FileLimits.MAX_TERMS,
)


def built_in_rules(method: str = GAUSS_NEWTON) -> str:
    """Return the text of the built-in rules for a search method, without the line that names their schema."""
    name = "thesis.yaml" if method == THESIS else "candidates.yaml"
    return packaged_text("ces_identify.polynomial", name)


def load_rules(path: Path | None, method: str = GAUSS_NEWTON) -> CandidateRules:
    """Read candidate rules, by default the built-in ones of `method`; raises CesError naming file and key."""
    if path is not None:
        return parse_rules(read_yaml_mapping(path, EXPECTED), str(path))
    source = "built-in candidate rules"
    return parse_rules(parse_yaml_mapping(built_in_rules(method), source, EXPECTED), source)


def parse_rules(raw: Mapping[str, Any], source: str) -> CandidateRules:
    """Return the candidate rules in nested mappings; raises CesError."""
    block, open_lags = replace_auto(raw.get("constructed", {}))
    constructed = constructions_from(block, f"{source}: constructed")
    names = (*SIGNALS, *constructed)
    require_known_keys(raw, (*names, "constructed", "products", "initial"), source)
    hats = {name for name, made in constructed.items() if isinstance(made[0], TriangularMembership)}
    force = raw["force"] if isinstance(raw.get("force"), Mapping) else {}
    beside = {s: _read_rule(s, force[s], f"{source}: force: {s}", s in hats) for s in names[1:] if s in force}
    own = {**raw, "force": {key: value for key, value in force.items() if key not in beside}} if force else raw
    signals = {s: _read_rule(s, own[s], f"{source}: {s}", s in hats) for s in names if s in own}
    initial = _read_terms(raw["initial"], names, hats, f"{source}: initial") if "initial" in raw else ()
    products: tuple[tuple[str, ...], ...] = ()
    if "products" in raw or not initial:
        products = _read_products(raw.get("products"), signals, {**signals, **beside}, f"{source}: products")
    return CandidateRules(signals, products, beside, constructed, open_lags, initial)


def _read_rule(signal: str, raw: object, where: str, hat: bool = False) -> SignalRule:
    """Return the rule of a signal; a past force has lags in ticks alone, a membership neither power nor form."""
    if isinstance(raw, Mapping) and (signal == "force" or hat):
        require_known_keys(raw, ("lags", "lags_ms") if hat else ("lags", "powers", "forms"), where)
    rule = read_record(SignalRule, raw, where, CesError)
    if signal == "force" and 0 in rule.lags:
        raise CesError(f"{where}: lags has 0; expected whole numbers from 1 on, as the force is the model's own")
    return rule


def _read_products(
    raw: object, signals: Mapping[str, SignalRule], beside_force: Mapping[str, SignalRule], where: str
) -> tuple[tuple[str, ...], ...]:
    products = tuple(dict.fromkeys(PRODUCTS.check(raw, where)))
    for item in products:
        if not all(s in signals for s in item):
            raise CesError(f"{where}: {list(item)}; expected signals among {', '.join(signals)}")
        if item.count("force") > 1:
            raise CesError(f"{where}: {list(item)}; expected force once at most")
        for signal in dict.fromkeys(item):
            rule, times = (beside_force if "force" in item else signals)[signal], item.count(signal)
            while rule.again is not None and times > 1:
                rule, times = rule.again, times - 1
            if times > (lags := len(rule.lags or rule.lags_ms)):
                text = f"{signal} {item.count(signal)} times, but its rule has {lags} lags; add lags or a rule 'again'"
                raise CesError(f"{where}: {list(item)}: {text}")
    return products


def _read_terms(raw: object, signals: Sequence[str], hats: Set[str], where: str) -> tuple[tuple[Factor, ...], ...]:
    """Return the factors of each term, constructed ones without their definition."""
    terms = []
    for i, item in enumerate(INITIAL.check(raw, where)):
        for j, given in enumerate(item):
            if given.signal not in signals:
                raise CesError(f"{where}[{i}][{j}]: signal is {given.signal!r}; expected one of {', '.join(signals)}")
            if (given.signal in hats or given.signal == "force") and (given.power, given.form) != (1.0, "signed"):
                raise CesError(f"{where}[{i}][{j}]: {given.signal} has power or form; expected its lag alone")
        try:
            factors = [Factor(f.signal, f.lag, f.power, FORMS[f.form]).checked() for f in item]
            terms.append(merge_signs(Term(1.0, tuple(factors)).checked().factors))
        except ModelError as error:
            raise CesError(f"{where}[{i}]: {error}") from None
    return tuple(dict.fromkeys(terms))


def replace_auto(raw: object) -> tuple[object, tuple[str, ...]]:
    """Return the block `constructed` with a guess for each lag whose time constant is `auto`, and their names."""
    if not isinstance(raw, Mapping):
        return raw, ()
    lags = {str(n): one for n, one in raw.items() if isinstance(one, Mapping) and one.get("kind") == "lag"}
    auto = tuple(name for name, one in lags.items() if one.get("time_constant_s") == AUTO)
    return {**raw, **{name: {**lags[name], "time_constant_s": FIRST_GUESS_S} for name in auto}}, auto


def constructions_from(
    raw: object, where: str, known: Constructions | None = None
) -> dict[str, tuple[ConstructedInput, ...]]:
    """Check the block `constructed` of a rules file, and return it after those in `known`; raises CesError."""
    if not isinstance(raw, Mapping):
        raise CesError(f"{where}: expected names, each with kind and settings")
    constructed = dict(known or {})
    for name in sorted(raw, key=lambda key: isinstance(raw[key], Mapping) and raw[key].get("kind") == MEMBERSHIPS):
        constructed[str(name)] = _construct(str(name), raw[name], f"{where}: {name}", constructed)
    names = [definition.name for group in constructed.values() for definition in group]
    if len(set(names)) < len(names):
        raise CesError(f"{where}: hats are named NAME_1, NAME_2 and so on; expected these names to be free")
    return constructed


def _construct(name: str, raw: object, where: str, known: Constructions) -> tuple[ConstructedInput, ...]:
    if isinstance(raw, Mapping):
        raw = {**(FREQUENCY if raw.get("kind") == "frequency" else {}), **raw, "name": name}
    definition = CONSTRUCTED.check(raw, where)
    if not isinstance(definition, Memberships):
        return (definition,)
    smooth = {d.name: d for group in known.values() for d in group if d.kind != "hat"}
    if definition.of not in (*BASE, *smooth):
        raise CesError(f"{where}: of is {definition.of!r}; expected one of {', '.join((*BASE, *smooth))}")
    return make_memberships(name, definition.of, definition.at, smooth.get(definition.of))


def rules_schema() -> Schema:
    """Return the JSON Schema of a file; keys besides the signals are names of constructed inputs."""
    rule: Schema = {"$ref": "#/definitions/rule"}
    of_signal, of_force = record_schema(SignalRule), record_schema(SignalRule)
    for key in ("lags_ms", "again"):
        del of_force["properties"][key]
    of_force["properties"]["lags"]["items"]["minimum"] = 1
    properties = {
        "force": {**of_force, "oneOf": [{"required": ["lags"]}], "additionalProperties": rule},  # may multiply it
        **dict.fromkeys(SIGNALS[1:], rule),
        "constructed": {"type": "object", "additionalProperties": _constructed_schema()},
        "products": PRODUCTS.schema,
        "initial": INITIAL.schema,
    }
    return {
        "type": "object",
        "properties": properties,
        "additionalProperties": rule,
        "definitions": {"rule": of_signal},
    }


def _constructed_schema() -> Schema:
    schema = CONSTRUCTED.bare_schema
    for rule in schema["allOf"]:  # the name is the key of the definition
        branch, kind = rule["then"], rule["if"]["properties"]["kind"]["const"]
        properties = branch["properties"]
        del properties["name"]
        given = ("name", *(FREQUENCY if kind == "frequency" else ()))
        branch["required"] = [key for key in branch["required"] if key not in given]
        if kind == "lag":
            properties["time_constant_s"] = {"anyOf": [{"const": AUTO}, properties["time_constant_s"]]}
    return schema
