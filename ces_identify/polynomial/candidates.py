"""Candidate regressors: a file of rules in (YAML), the terms that the rules make out.

The rules say which signals, lags, powers and products may make terms. The candidates are counted before any is built;
more than the search can hold are refused. candidates.yaml holds the built-in rules, thesis.yaml those of the thesis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise, product
from math import prod
from pathlib import Path
from typing import Any

from ces_data.config_file import packaged_text, parse_yaml_mapping, read_yaml_mapping
from ces_identify.numerics.search import GAUSS_NEWTON, THESIS
from ces_observer.errors import CesError
from ces_observer.fields import Field, require_known_keys
from ces_observer.json_text import JsonObject
from ces_observer.structures.constructed_inputs import (
    BASE,
    ConstructedInput,
    Lag,
    TriangularMembership,
    make_memberships,
    parse_constructed,
    require_name,
)
from ces_observer.structures.structure import MAX_LAG
from ces_observer.structures.terms import MAX_FACTORS, MAX_POWER, MAX_TERMS, Factor, Term

FORMS = {"signed": True, "magnitude": False}
MAX_CANDIDATES = 6000
MAX_CHOICES = 100_000  # combinations of factors that are tried
MAX_LAG_MS = 200.0
SIGNALS = ("force", "speed", "current", "position")
EXPECTED = f"candidate rules: {', '.join(SIGNALS)} and products"
RULE_LISTS = {  # of a signal's rule, by their keys
    "lags": Field(meaning="at the model's rate", low=0, high=MAX_LAG, unit="ticks", kind=int, many=True, min_count=1),
    "lags_ms": Field(
        meaning="instead of lags", low=0.0, high=MAX_LAG_MS, unit="ms", kind=float, many=True, min_count=1
    ),
    "powers": Field(low=0.0, high=MAX_POWER, kind=float, many=True, min_count=1),
    "forms": Field(choices=tuple(FORMS), many=True, min_count=1),
}
LAGS_OF_FORCE = replace(RULE_LISTS["lags"], low=1)
MEMBERSHIPS = "hats"
AUTO, FIRST_GUESS_S = "auto", 0.01  # of a lag's time constant
RULE_KINDS = ("stop", "play", "lag", "frequency", MEMBERSHIPS)
MAX_MEMBERSHIPS = 20
MAX_PEAK, MIN_PEAK_DISTANCE = 1e6, 1e-6  # [m, m/s, A, Hz] of memberships
FREQUENCY = {"time_constant_s": 0.25, "range_Hz": [0.5, 20.0], "floor_m": 1e-4}  # defaults

Constructions = Mapping[str, tuple[ConstructedInput, ...]]  # by their name in rules and products


@dataclass(frozen=True)
class SignalRule:
    """Lags, powers and forms (signed or magnitude) a signal may take in a term.

    Lags are in ticks, or with `in_ms` in milliseconds, to the nearest tick. `again` is the rule of the signal's next
    factor in a product that names it again; without it, that factor has the same rule and another lag.
    """

    lags: tuple[float, ...]
    powers: tuple[float, ...] = (1.0,)
    forms: tuple[str, ...] = ("signed",)
    in_ms: bool = False
    again: SignalRule | None = None

    def at_rate(self, rate_Hz: float) -> SignalRule:
        """Return the rule with its lags in ticks of that rate, without repetitions."""
        again = self.again and self.again.at_rate(rate_Hz)
        if not self.in_ms:
            return replace(self, again=again)
        ticks = (min(MAX_LAG, round(lag * 1e-3 * rate_Hz)) for lag in self.lags)
        return replace(self, lags=tuple(dict.fromkeys(ticks)), in_ms=False, again=again)

    def factors(self, signal: str) -> tuple[Factor, ...]:
        """Return every factor that the rule allows, except |s|^0, which is 1."""
        if signal == "force":
            return tuple(Factor("force", int(lag)) for lag in self.lags)
        return tuple(
            Factor(signal, int(lag), power, FORMS[form])
            for lag, power, form in product(self.lags, self.powers, self.forms)
            if power > 0.0 or form == "signed"
        )


@dataclass(frozen=True)
class CandidateRules:
    """Rules by signal, and the products of signals that make a term; () is the constant term.

    The terms `initial`, whose factors have no definitions yet, are candidates, too, and the first ones: the thesis'
    procedure starts from them.

    `beside_force` holds other rules for signals that multiply a past force; few different lags there keep the proof of
    stability short (ces_observer.proof.certificate). `constructed` defines the constructed inputs; if a name has
    several (memberships), each makes its own terms. The time constants of `open_lags` are estimated from the data
    (ces_identify.polynomial.constructed).
    """

    signals: Mapping[str, SignalRule]
    products: tuple[tuple[str, ...], ...]
    beside_force: Mapping[str, SignalRule] = field(default_factory=dict)
    constructed: Constructions = field(default_factory=dict)
    open_lags: tuple[str, ...] = ()
    initial: tuple[tuple[Factor, ...], ...] = ()

    def count(self) -> int:
        """Return the number of candidates, counting a term that two products make twice."""
        made = sum(prod(map(_count_choices, self._factors(signals))) for signals in self.products)
        return made + len(self.initial_terms())

    def at_rate(self, rate_Hz: float) -> CandidateRules:
        """Return the rules with every lag in ticks of that rate."""
        signals, beside = (
            {name: rule.at_rate(rate_Hz) for name, rule in rules.items()} for rules in (self.signals, self.beside_force)
        )
        return replace(self, signals=signals, beside_force=beside)

    def with_time_constant(self, name: str, seconds: float) -> CandidateRules:
        """Return the rules with the time constant of the lag `name` set, also in memberships of that lag."""

        def set_time_constant(one: ConstructedInput) -> ConstructedInput:
            if isinstance(one, TriangularMembership) and one.base is not None:
                return replace(one, base=set_time_constant(one.base))
            return replace(one, time_constant_s=seconds) if isinstance(one, Lag) and one.name == name else one

        return replace(
            self,
            constructed={n: tuple(set_time_constant(one) for one in made) for n, made in self.constructed.items()},
            open_lags=tuple(n for n in self.open_lags if n != name),
        )

    def without_signal(self, signal: str) -> CandidateRules:
        """Return the rules without the products of `signal` and of inputs constructed from it."""
        removed = {signal} | {name for name, made in self.constructed.items() if signal in made[0].signals}
        return replace(
            self,
            products=tuple(p for p in self.products if not removed & set(p)),
            initial=tuple(term for term in self.initial if not removed & {f.signal for f in term}),
            constructed={name: made for name, made in self.constructed.items() if name not in removed},
            open_lags=tuple(name for name in self.open_lags if name not in removed),
        )

    def candidates(self) -> tuple[Term, ...]:
        """Return one term (coefficient 1) for each candidate; raises CesError with the count if they are too many.

        The initial terms come first. Lags must be in ticks (`at_rate`), else ValueError is raised.
        """
        if any(rule.in_ms for rule in (*self.signals.values(), *self.beside_force.values())):
            raise ValueError("lags in milliseconds; call at_rate first")
        if self.count() > MAX_CANDIDATES:
            raise CesError(
                f"candidate rules make {self.count()} terms; at most {MAX_CANDIDATES}: drop lags, powers or products"
            )
        made = (choice for p in self.products for choice in product(*map(choose_factors, self._factors(p))))
        terms = (Term(1.0, tuple(chain.from_iterable(factors))) for factors in made)
        return tuple(dict.fromkeys((*self.initial_terms(), *terms)))

    def initial_terms(self) -> tuple[Term, ...]:
        """Return the terms (coefficient 1) from which the thesis' procedure starts."""
        made = (product(*(self._define(f.signal, [f]) for f in term)) for term in self.initial)
        return tuple(dict.fromkeys(Term(1.0, factors) for factors in chain.from_iterable(made)))

    def _factors(self, signals: tuple[str, ...]) -> list[list[tuple[Factor, ...]]]:
        """Return for each different signal of a product the factors of its occurrences."""
        rules = {**self.signals, **self.beside_force} if "force" in signals else self.signals
        factors: dict[str, list[tuple[Factor, ...]]] = {}
        for signal in signals:
            occurrences = factors.setdefault(signal, [])
            rule = rules[signal]
            for _ in occurrences:
                rule = rule.again or rule
            occurrences.append(self._define(signal, rule.factors(signal)))
        return list(factors.values())

    def _define(self, signal: str, factors: Sequence[Factor]) -> tuple[Factor, ...]:
        """Return factors of a signal with its definition, or with each of those of a group of memberships."""
        if signal not in self.constructed:
            return tuple(factors)
        return tuple(replace(f, signal=one.name, definition=one) for one in self.constructed[signal] for f in factors)


def _count_choices(occurrences: Sequence[Sequence[Factor]]) -> int:
    """Return the number of choices of factors for a signal, or a larger one if there are very many."""
    size = prod(map(len, occurrences))
    return size if size > MAX_CHOICES or len(occurrences) == 1 else len(choose_factors(occurrences))


def choose_factors(occurrences: Sequence[Sequence[Factor]]) -> list[tuple[Factor, ...]]:
    """Return the choices of one factor for each occurrence of a signal, each choice once.

    The factors have different lags, except that a magnitude and a sign at one lag become one signed factor.
    """
    merged = (merge_signs(choice) for choice in product(*occurrences))
    usable = [choice for choice in merged if len({factor.lag for factor in choice}) == len(choice)]
    return list({frozenset(choice): choice for choice in reversed(usable)}.values())[::-1]


def merge_signs(choice: Sequence[Factor]) -> tuple[Factor, ...]:
    """Return the factors with |s|^p and sign(s) of one signal at one lag as sign(s) |s|^p."""
    signs = [f for f in choice if f.signed and f.power == 0.0]
    merged = list(choice)
    for sign in signs:
        size = next((f for f in merged if (f.signal, f.lag) == (sign.signal, sign.lag) and not f.signed), None)
        if size is not None:
            merged.remove(sign)
            merged[merged.index(size)] = replace(size, signed=True)
    return tuple(merged)


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
    if not isinstance(raw, Mapping):
        raise CesError(f"{where}: expected lags, powers and forms")
    force = signal == "force"
    keys = ("lags", "powers", "forms") if force else ("lags", "lags_ms") if hat else (*RULE_LISTS, "again")
    require_known_keys(raw, keys, where)
    if ("lags" in raw) == ("lags_ms" in raw):
        raise CesError(f"{where}: expected a list of lags, in ticks (lags) or in milliseconds (lags_ms)")
    found: dict[str, Any] = {"in_ms": "lags_ms" in raw}
    for key in [key for key in RULE_LISTS if key in raw]:
        one = LAGS_OF_FORCE if force and key == "lags" else RULE_LISTS[key]
        values = one.check(raw[key], f"{where}: {key}")
        found["lags" if key == "lags_ms" else key] = tuple(dict.fromkeys(values))
    if "again" in raw:
        found["again"] = _read_rule(signal, raw["again"], f"{where}: again")
    return SignalRule(**found)


def _read_products(
    raw: object, signals: Mapping[str, SignalRule], beside_force: Mapping[str, SignalRule], where: str
) -> tuple[tuple[str, ...], ...]:
    if not isinstance(raw, list) or not raw:
        raise CesError(f"{where} is {raw!r}; expected a list of lists of signals")
    for item in raw:
        if not isinstance(item, list) or not all(isinstance(s, str) and s in signals for s in item):
            raise CesError(f"{where}: {item!r}; expected signals among {', '.join(signals)}")
        if item.count("force") > 1 or len(item) > MAX_FACTORS:
            raise CesError(f"{where}: {item!r}; expected at most {MAX_FACTORS} signals, force once")
        for signal in dict.fromkeys(item):
            rule, times = (beside_force if "force" in item else signals)[signal], item.count(signal)
            while rule.again is not None and times > 1:
                rule, times = rule.again, times - 1
            if times > len(rule.lags):
                raise CesError(
                    f"{where}: {item!r}: {signal} {item.count(signal)} times, but its rule has {len(rule.lags)} lags; "
                    "add lags or a rule 'again'"
                )
    return tuple(dict.fromkeys(map(tuple, raw)))


def _read_terms(raw: object, signals: Sequence[str], hats: Set[str], where: str) -> tuple[tuple[Factor, ...], ...]:
    """Return the factors of each term, constructed ones without their definition."""
    if not isinstance(raw, list) or not 1 <= len(raw) <= MAX_TERMS:
        raise CesError(f"{where}: expected a list of terms, 1 to {MAX_TERMS}, each a list of factors")
    terms = []
    for i, item in enumerate(raw):
        if not isinstance(item, list) or len(item) > MAX_FACTORS:
            raise CesError(f"{where}[{i}]: {item!r}; expected a list of factors, at most {MAX_FACTORS}")
        factors = [_read_factor(one, signals, hats, f"{where}[{i}][{j}]") for j, one in enumerate(item)]
        if sum(f.signal == "force" for f in factors) > 1:
            raise CesError(f"{where}[{i}]: expected at most one past force, so that bounds can be proved")
        terms.append(merge_signs(factors))
    return tuple(dict.fromkeys(terms))


def _read_factor(raw: object, signals: Sequence[str], memberships: Set[str], where: str) -> Factor:
    """Return a factor; a past force and a membership have neither power nor form."""
    if not isinstance(raw, Mapping):
        raise CesError(f"{where}: {raw!r}; expected a factor such as {{signal: speed, lag: 3, power: 0.4}}")
    node = JsonObject({"lag": 0, "power": 1.0, "form": "signed", **raw}, where)
    signal = node.choice("signal", signals)
    plain = signal == "force" or signal in memberships
    require_known_keys(raw, ("signal", "lag") if plain else ("signal", "lag", "power", "form"), where)
    if signal == "force":
        return Factor("force", node.integer("lag", 1, MAX_LAG))
    signed, power = FORMS[node.choice("form", tuple(FORMS))], node.number("power", 0.0, MAX_POWER)
    if not signed and power == 0.0:
        raise CesError(f"{where}: a magnitude to the power 0 is 1; leave the factor out")
    return Factor(signal, node.integer("lag", 0, MAX_LAG), power, signed)


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
        constructed[str(name)] = _construct(str(name), JsonObject(raw[name], f"{where}: {name}"), constructed)
    names = [one.name for group in constructed.values() for one in group]
    if len(set(names)) < len(names):
        raise CesError(f"{where}: hats are named NAME_1, NAME_2 and so on; expected these names to be free")
    return constructed


def _construct(name: str, node: JsonObject, known: Constructions) -> tuple[ConstructedInput, ...]:
    kind = node.choice("kind", RULE_KINDS)
    if kind != MEMBERSHIPS:
        settings = {**(FREQUENCY if kind == "frequency" else {}), **node.value, "name": name}
        return tuple(parse_constructed([JsonObject(settings, node.where)]).values())
    smooth = {one.name: one for group in known.values() for one in group if one.kind != "hat"}
    of, where = node.choice("of", (*BASE, *smooth)), f"{node.where}: at"
    peaks = Field("at", kind=float, low=-MAX_PEAK, high=MAX_PEAK, many=True).check(node.value.get("at"), where)
    if not 2 <= len(peaks) <= MAX_MEMBERSHIPS or any(b - a < MIN_PEAK_DISTANCE for a, b in pairwise(peaks)):
        raise CesError(f"{where} is {peaks}; expected 2 to {MAX_MEMBERSHIPS} ascending peaks of the sub-models")
    return make_memberships(require_name(name, node.where), of, peaks, smooth.get(of))
