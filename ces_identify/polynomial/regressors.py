"""Candidate regressors: rules in YAML (which signals, lags, powers, products) in, a list of terms out.

The candidates are counted before any is built; more than the search can hold are refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from itertools import chain, product
from math import prod
from pathlib import Path
from typing import Any

from ces_identify.config_file import parse_yaml_mapping, read_yaml_mapping, require_known_keys
from ces_identify.polynomial.constructed_rules import Constructions, constructions_from, replace_auto
from ces_identify.polynomial.repeated_signals import MAX_CHOICES, choose_factors
from ces_identify.polynomial.search_limits import BOTH, THESIS
from ces_identify.polynomial.term_list import FORMS, parse_term_list
from ces_identify.polynomial.thesis_rules import THESIS_RULES
from ces_observer.errors import CesError
from ces_observer.structures.constructed_inputs import ConstructedInput, Lag, TriangularMembership
from ces_observer.structures.structure import MAX_LAG
from ces_observer.structures.terms import Factor, Term
from ces_observer.structures.terms_file import MAX_FACTORS, MAX_POWER

MAX_CANDIDATES = 6000
MAX_LAG_MS = 200.0
SIGNALS = ("force", "speed", "current", "position")
EXPECTED = f"candidate rules: {', '.join(SIGNALS)} and products"


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
    (ces_identify.polynomial.time_constant).
    """

    signals: Mapping[str, SignalRule]
    products: tuple[tuple[str, ...], ...]
    beside_force: Mapping[str, SignalRule] = field(default_factory=dict)
    constructed: Constructions = field(default_factory=dict)
    open_lags: tuple[str, ...] = ()
    initial: tuple[tuple[Factor, ...], ...] = ()

    def count(self) -> int:
        """Return the number of candidates, counting a term that two products make twice."""
        made = sum(prod(self._count_choices(signals)) for signals in self.products)
        return made + len(self.initial_terms())

    def at_rate(self, rate_Hz: float) -> CandidateRules:
        """Return the rules with every lag in ticks of that rate."""
        signals = {name: rule.at_rate(rate_Hz) for name, rule in self.signals.items()}
        return replace(
            self, signals=signals, beside_force={n: rule.at_rate(rate_Hz) for n, rule in self.beside_force.items()}
        )

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
        made = (choice for signals in self.products for choice in product(*self._choices(signals)))
        terms = (Term(1.0, tuple(chain.from_iterable(factors))) for factors in made)
        return tuple(dict.fromkeys((*self.initial_terms(), *terms)))

    def initial_terms(self) -> tuple[Term, ...]:
        """Return the terms (coefficient 1) from which the thesis' procedure starts."""
        made = (product(*(self._define(f.signal, [f]) for f in term)) for term in self.initial)
        return tuple(dict.fromkeys(Term(1.0, factors) for factors in chain.from_iterable(made)))

    def _choices(self, signals: tuple[str, ...]) -> list[list[tuple[Factor, ...]]]:
        """Return for each signal of a product the factors it can contribute."""
        return [choose_factors(factors) for factors in self._factors(signals)]

    def _count_choices(self, signals: tuple[str, ...]) -> list[int]:
        """Return the number of choices for each signal of a product, or a larger one if there are very many."""
        sizes = [(factors, prod(map(len, factors))) for factors in self._factors(signals)]
        return [size if size > MAX_CHOICES or len(f) == 1 else len(choose_factors(f)) for f, size in sizes]

    def _factors(self, signals: tuple[str, ...]) -> list[list[tuple[Factor, ...]]]:
        """Return for each different signal of a product the factors of its occurrences."""
        rules = {**self.signals, **self.beside_force} if "force" in signals else self.signals
        return [self._factors_of(s, rules[s], signals.count(s)) for s in dict.fromkeys(signals)]

    def _factors_of(self, signal: str, rule: SignalRule, occurrences: int) -> list[tuple[Factor, ...]]:
        factors = []
        for _ in range(occurrences):
            factors.append(self._define(signal, rule.factors(signal)))
            rule = rule.again or rule
        return factors

    def _define(self, signal: str, factors: Sequence[Factor]) -> tuple[Factor, ...]:
        """Return factors of a signal with its definition, or with each of those of a group of memberships."""
        if signal not in self.constructed:
            return tuple(factors)
        return tuple(replace(f, signal=one.name, definition=one) for one in self.constructed[signal] for f in factors)


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
    if in_ms and not all(_is_number(x) and 0.0 <= x <= MAX_LAG_MS for x in lags):
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


def _is_number(x: object) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool)


def _read_list(raw: Mapping[str, Any], key: str, where: str) -> tuple[Any, ...]:
    value = raw.get(key)
    if not isinstance(value, list) or not value:
        raise CesError(f"{where}: {key} is {value!r}; expected a list")
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
