"""Files of candidate rules: YAML in, rules out; the built-in rules and those of the thesis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from itertools import pairwise
from pathlib import Path
from typing import Any

from ces_data.config_file import parse_yaml_mapping, read_yaml_mapping
from ces_identify.polynomial.candidate_rules import FORMS, CandidateRules, Constructions, SignalRule, merge_signs
from ces_identify.polynomial.search_limits import BOTH, THESIS
from ces_observer.errors import CesError
from ces_observer.fields import require_known_keys
from ces_observer.json_text import JsonObject
from ces_observer.structures.constructed_inputs import (
    BASE,
    ConstructedInput,
    TriangularMembership,
    make_memberships,
    parse_constructed,
    require_name,
)
from ces_observer.structures.structure import MAX_LAG
from ces_observer.structures.terms import MAX_FACTORS, MAX_POWER, MAX_TERMS, Factor

MAX_LAG_MS = 200.0
SIGNALS = ("force", "speed", "current", "position")
EXPECTED = f"candidate rules: {', '.join(SIGNALS)} and products"


DEFAULT_RULES = """\
# Candidate regressors for a polynomial NARX. A term is a product of one factor from each signal of a product.
#   lags_ms  in milliseconds, to the nearest tick; or lags, in ticks of the model's rate (force: ticks alone, from 1 on)
#   powers   also non-integer; the factor is sign(s) |s|^p (signed) or |s|^p (magnitude); signed with power 0 is sign(s)
#   force: speed, valve  what may multiply a past force instead, kept to one lag each so that stability can be proved
# valve is the current behind the first-order lag of coil and pilot valve; its time constant is found from the data.
constructed:
  valve: {kind: lag, of: current, time_constant_s: auto}
force:
  lags: [1]
  speed: {lags_ms: [0], powers: [0.5, 1.0, 1.5], forms: [signed, magnitude]}
  valve: {lags_ms: [0], powers: [1.0, 2.0], forms: [magnitude]}
speed:
  lags_ms: [0, 3, 8]
  powers: [0.5, 1.0, 2.0]
  forms: [signed, magnitude]
valve:
  lags_ms: [0]
  powers: [1.0, 2.0]
  forms: [magnitude]
position:
  lags_ms: [0]
  powers: [1.0, 2.0]
  forms: [signed]
products:
  - []
  - [speed]
  - [valve]
  - [position]
  - [speed, valve]
  - [position, valve]
  - [force]
  - [force, speed]
  - [force, valve]
  - [force, speed, valve]
# A product may name an input again: the factors then have different lags. `again` in the input's rule gives the second
# factor a rule of its own, with any lag:
#   speed: {lags_ms: [0, 3], powers: [0.5], forms: [magnitude], again: {lags_ms: [0, 3], powers: [0], forms: [signed]}}
# initial lists terms to start from with --method thesis, and candidates for the other methods:
#   initial:
#     - [{signal: speed}, {signal: current, lag: 8, power: 2, form: magnitude}]
# Constructed inputs stand in rules and products as the signals do, once they are defined (docs/constructed.md):
#   constructed:
#     hysteresis: {kind: stop, of: position, half_width: 0.0005}    stroke since the last reversal, at most this [m]
#     remanence: {kind: play, of: current, half_width: 0.05}        what is left of it: lags behind by this [A]
#     frequency: {kind: frequency, time_constant_s: 0.25, range_Hz: [0.5, 20], floor_m: 0.0001}
#     region: {kind: hats, of: valve, at: [0.35, 0.55]}             memberships: a sub-model for each, blended between
"""


def built_in_rules(method: str = BOTH) -> str:
    """Return the text of the candidate rules for a search method: those of the thesis for its procedure."""
    return THESIS_RULES if method == THESIS else DEFAULT_RULES


def load_rules(path: Path | None, method: str = BOTH) -> CandidateRules:
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
    force, beside = _split_force(raw.get("force"), names[1:], hats, source)
    rules = {**raw, "force": force} if "force" in raw else raw
    signals = {s: _signal_rule(s, rules[s], f"{source}: {s}", s in hats) for s in names if s in rules}
    initial = parse_term_list(raw["initial"], names, hats, f"{source}: initial") if "initial" in raw else ()
    products = _products(raw.get("products"), signals, beside, source) if "products" in raw or not initial else ()
    return CandidateRules(signals, products, beside, constructed, open_lags, initial)


def _split_force(
    raw: object, names: Sequence[str], hats: Set[str], source: str
) -> tuple[object, dict[str, SignalRule]]:
    """Return the rule of past forces, and the rules of the signals beside them."""
    if not isinstance(raw, Mapping):
        return raw, {}
    beside = {s: _signal_rule(s, raw[s], f"{source}: force: {s}", s in hats) for s in names if s in raw}
    return {key: value for key, value in raw.items() if key not in beside}, beside


def _signal_rule(signal: str, raw: object, where: str, hat: bool = False) -> SignalRule:
    if not isinstance(raw, Mapping):
        raise CesError(f"{where}: expected lags, powers and forms")
    keys = ("lags", "lags_ms") if hat else ("lags", "lags_ms", "powers", "forms", "again")
    require_known_keys(raw, keys[:-1] if signal == "force" else keys, where)
    min_lag = 1 if signal == "force" else 0
    in_ms = "lags_ms" in raw
    if in_ms and (signal == "force" or "lags" in raw):
        raise CesError(f"{where}: lags_ms {raw['lags_ms']!r}; expected lags alone" + " in ticks" * (signal == "force"))
    lags = _read_list(raw, "lags_ms" if in_ms else "lags", where)
    if in_ms and not all(
        isinstance(x, int | float) and not isinstance(x, bool) and 0.0 <= x <= MAX_LAG_MS for x in lags
    ):
        raise CesError(f"{where}: lags_ms {list(lags)}; expected numbers from 0 to {MAX_LAG_MS:g}")
    if not in_ms and not all(isinstance(x, int) and not isinstance(x, bool) and min_lag <= x <= MAX_LAG for x in lags):
        raise CesError(f"{where}: lags {list(lags)}; expected whole numbers from {min_lag} to {MAX_LAG}")
    powers = _read_list(raw, "powers", where) if "powers" in raw else (1.0,)
    if not all(isinstance(x, int | float) and 0.0 <= x <= MAX_POWER for x in powers):
        raise CesError(f"{where}: powers {list(powers)}; expected numbers from 0 to {MAX_POWER:g}")
    forms = _read_list(raw, "forms", where) if "forms" in raw else ("signed",)
    if not set(forms) <= set(FORMS):
        raise CesError(f"{where}: forms {list(forms)}; expected {' or '.join(FORMS)}")
    again = _signal_rule(signal, raw["again"], f"{where}: again") if "again" in raw else None
    return SignalRule(lags, tuple(float(p) for p in powers), forms, in_ms, again)


def _read_list(raw: Mapping[str, Any], key: str, where: str) -> tuple[Any, ...]:
    value = raw.get(key)
    if not isinstance(value, list) or not value or any(isinstance(one, list | dict) for one in value):
        raise CesError(f"{where}: {key} is {value!r}; expected a list of numbers or words, such as [1, 2]")
    return tuple(dict.fromkeys(value))


def _products(
    raw: object, signals: Mapping[str, SignalRule], beside: Mapping[str, SignalRule], source: str
) -> tuple[tuple[str, ...], ...]:
    if not isinstance(raw, list) or not raw:
        raise CesError(f"{source}: products is {raw!r}; expected a list of lists of signals")
    products = []
    for item in raw:
        if not isinstance(item, list) or not all(isinstance(s, str) and s in signals for s in item):
            raise CesError(f"{source}: product {item!r}; expected signals among {', '.join(signals)}")
        if item.count("force") > 1 or len(item) > MAX_FACTORS:
            raise CesError(f"{source}: product {item!r}; expected at most {MAX_FACTORS} signals, force once")
        rules = {**signals, **beside} if "force" in item else signals
        for signal in dict.fromkeys(item):
            _require_lags(rules[signal], item.count(signal), f"{source}: product {item!r}: {signal}")
        products.append(tuple(item))
    return tuple(dict.fromkeys(products))


def _require_lags(rule: SignalRule, occurrences: int, where: str) -> None:
    """Raise CesError if a signal occurs more often in a product than its rule has lags, without `again`."""
    if rule.again is None and occurrences > len(rule.lags):
        raise CesError(
            f"{where} {occurrences} times, but its rule has {len(rule.lags)} lags; add lags or a rule 'again'"
        )
    if rule.again is not None and occurrences > 1:
        _require_lags(rule.again, occurrences - 1, where)


THESIS_RULES = """\
# Candidates of the thesis (section 5.2.1): u1 current, u2 |speed|, u3 sign of the speed, y past force. Delays 0 to 3,
# powers of the speed 0.2 to 1.2; past forces one or two ticks ago, to the power 1, at most one in a term. In all of its
# published regressors the speed occurs, its sign at a delay of its own, and the current has the power 1.
# The thesis does not name its initial model: this one is viscous.
initial:
  - [{signal: speed}]
force:
  lags: [1, 2]
current:
  lags: [0, 1, 2, 3]
  forms: [magnitude]
speed:
  lags: [0, 1, 2, 3]
  powers: [0.2, 0.4, 0.6, 0.8, 1.0, 1.2]
  forms: [magnitude]
  again: {lags: [0, 1, 2, 3], powers: [0], forms: [signed]}
products:
  - []
  - [current]
  - [speed]
  - [speed, speed]
  - [current, speed]
  - [current, speed, speed]
  - [force]
  - [force, current]
  - [force, speed]
  - [force, speed, speed]
  - [force, current, speed]
  - [force, current, speed, speed]
"""


MEMBERSHIPS = "hats"
AUTO, FIRST_GUESS_S = "auto", 0.01
RULE_KINDS = ("stop", "play", "lag", "frequency", MEMBERSHIPS)
MAX_MEMBERSHIPS = 20
MAX_PEAK, MIN_PEAK_DISTANCE = 1e6, 1e-6  # [m, m/s, A, Hz] of memberships
FREQUENCY = {"time_constant_s": 0.25, "range_Hz": [0.5, 20.0], "floor_m": 1e-4}  # defaults


def replace_auto(raw: object) -> tuple[object, tuple[str, ...]]:
    """Return the block `constructed` with a guess for each lag whose time constant is `auto`, and their names."""
    if not isinstance(raw, Mapping):
        return raw, ()
    names = [n for n, one in raw.items() if isinstance(one, Mapping) and one.get("kind") == "lag"]
    auto = tuple(str(n) for n in names if raw[n].get("time_constant_s") == AUTO)
    return {n: {**one, "time_constant_s": FIRST_GUESS_S} if str(n) in auto else one for n, one in raw.items()}, auto


def constructions_from(
    raw: object, where: str, known: Constructions | None = None
) -> dict[str, tuple[ConstructedInput, ...]]:
    """Check the block `constructed` of a rules file, and return it after those in `known`; raises CesError."""
    if not isinstance(raw, Mapping):
        raise CesError(f"{where}: expected names, each with kind and settings")
    constructed = dict(known or {})
    for name in sorted(raw, key=lambda key: isinstance(raw[key], Mapping) and raw[key].get("kind") == MEMBERSHIPS):
        constructed[str(name)] = _construct(str(name), JsonObject(raw[name], f"{where}: {name}"), constructed)
    names = [one.name for group in constructed.values() for one in group]
    if len(set(names)) < len(names):
        raise CesError(f"{where}: hats are named NAME_1, NAME_2 and so on; expected these names to be free")
    return constructed


def _construct(name: str, node: JsonObject, known: Constructions) -> tuple[ConstructedInput, ...]:
    kind = node.choice("kind", RULE_KINDS)
    if kind == MEMBERSHIPS:
        smooth = {one.name: one for group in known.values() for one in group if one.kind != "hat"}
        of = node.choice("of", (*BASE, *smooth))
        peaks = _read_peaks(node.value.get("at"), f"{node.where}: at")
        return make_memberships(require_name(name, node.where), of, peaks, smooth.get(of))
    settings = {**(FREQUENCY if kind == "frequency" else {}), **node.value, "name": name}
    return tuple(parse_constructed([JsonObject(settings, node.where)]).values())


def _read_peaks(raw: object, where: str) -> list[float]:
    """Return the ascending peaks of the memberships of a blend; raises CesError."""
    good = isinstance(raw, list) and all(isinstance(x, int | float) and abs(x) < MAX_PEAK for x in raw)
    peaks = [float(x) for x in raw] if isinstance(raw, list) and good else []
    if not 2 <= len(peaks) <= MAX_MEMBERSHIPS or any(b - a < MIN_PEAK_DISTANCE for a, b in pairwise(peaks)):
        raise CesError(
            f"{where}: {raw!r}; expected 2 to {MAX_MEMBERSHIPS} ascending numbers, the peaks of the sub-models"
        )
    return peaks


def parse_term_list(
    raw: object, signals: Sequence[str], memberships: Set[str], where: str
) -> tuple[tuple[Factor, ...], ...]:
    """Return the factors of each term, constructed ones without their definition; raises CesError.

    A magnitude and a sign of one signal at one lag become one signed factor. `signals` are the known ones;
    `memberships` are those that have neither power nor form.
    """
    if not isinstance(raw, list) or not 1 <= len(raw) <= MAX_TERMS:
        raise CesError(f"{where}: expected a list of terms, 1 to {MAX_TERMS}, each a list of factors")
    terms = [_parse_term(item, signals, memberships, f"{where}[{i}]") for i, item in enumerate(raw)]
    return tuple(dict.fromkeys(terms))


def _parse_term(raw: object, signals: Sequence[str], memberships: Set[str], where: str) -> tuple[Factor, ...]:
    if not isinstance(raw, list) or len(raw) > MAX_FACTORS:
        raise CesError(f"{where}: {raw!r}; expected a list of factors, at most {MAX_FACTORS}")
    factors = tuple(_parse_factor(item, signals, memberships, f"{where}[{i}]") for i, item in enumerate(raw))
    if sum(f.signal == "force" for f in factors) > 1:
        raise CesError(f"{where}: more than one past force; expected at most one, so that bounds can be proved")
    return merge_signs(factors)


def _parse_factor(raw: object, signals: Sequence[str], memberships: Set[str], where: str) -> Factor:
    if not isinstance(raw, Mapping):
        raise CesError(f"{where}: {raw!r}; expected a factor such as {{signal: speed, lag: 3, power: 0.4}}")
    node = JsonObject({"lag": 0, "power": 1.0, "form": "signed", **raw}, where)
    signal = node.choice("signal", signals)
    plain = signal == "force" or signal in memberships
    require_known_keys(raw, ("signal", "lag") if plain else ("signal", "lag", "power", "form"), where)
    if signal == "force":
        return Factor("force", node.integer("lag", 1, MAX_LAG))
    signed = FORMS[node.choice("form", tuple(FORMS))]
    power = node.number("power", 0.0, MAX_POWER)
    if not signed and power == 0.0:
        raise CesError(f"{where}: a magnitude to the power 0 is 1; leave the factor out")
    return Factor(signal, node.integer("lag", 0, MAX_LAG), power, signed)
