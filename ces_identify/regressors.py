"""Candidate regressors: rules in YAML (which signals, lags, powers, products) in, a list of terms out.

The number of candidates is counted before any is built, and refused if it is more than the search can hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import yaml

from ces_observer.errors import CesError
from ces_observer.model import MAX_LAG, MAX_POWER, Factor, Term

MOST_CANDIDATES = 6000
SIGNALS = ("force", "speed", "current", "position")
FORMS = {"signed": True, "magnitude": False}


@dataclass(frozen=True)
class SignalRule:
    """Lags [ticks], powers and forms (signed or magnitude) a signal may take in a term."""

    lags: tuple[int, ...]
    powers: tuple[float, ...] = (1.0,)
    forms: tuple[str, ...] = ("signed",)

    def factors(self, signal: str) -> tuple[Factor, ...]:
        """Return every factor this rule allows; |s|^0 is left out, as it is 1."""
        if signal == "force":
            return tuple(Factor("force", lag) for lag in self.lags)
        return tuple(
            Factor(signal, lag, power, FORMS[form])
            for lag, power, form in product(self.lags, self.powers, self.forms)
            if power > 0.0 or form == "signed"
        )


@dataclass(frozen=True)
class Rules:
    """Rules by signal, and the products of signals that make a term; () is the constant term.

    `beside_force` holds other rules for the signals that multiply a past force. Few different lags there keep the proof
    of stability short (ces_observer.certificate).
    """

    signals: Mapping[str, SignalRule]
    products: tuple[tuple[str, ...], ...]
    beside_force: Mapping[str, SignalRule] = field(default_factory=dict)

    def count(self) -> int:
        """Return how many candidates the rules make."""
        return sum(prod(len(factors) for factors in self._factors(signals)) for signals in self.products)

    def without(self, signal: str) -> Rules:
        """Return the rules with every product that holds `signal` left out."""
        return Rules(self.signals, tuple(p for p in self.products if signal not in p), self.beside_force)

    def candidates(self) -> tuple[Term, ...]:
        """Return one term (coefficient 1) for each candidate; raises CesError with the count if they are too many."""
        if self.count() > MOST_CANDIDATES:
            raise CesError(
                f"candidate rules make {self.count()} terms; at most {MOST_CANDIDATES}: drop lags, powers or products"
            )
        return tuple(Term(1.0, factors) for signals in self.products for factors in product(*self._factors(signals)))

    def _factors(self, signals: tuple[str, ...]) -> list[tuple[Factor, ...]]:
        rules = {**self.signals, **self.beside_force} if "force" in signals else self.signals
        return [rules[signal].factors(signal) for signal in signals]


DEFAULT_RULES = """\
# Candidate regressors for a polynomial NARX. A term is a product of one factor from each signal of a product.
#   lags    in ticks of the model's rate, from 0 on (force: from 1 on)
#   powers  also non-integer; the factor is sign(s) |s|^p (signed) or |s|^p (magnitude); signed with power 0 is sign(s)
#   force: speed, current  what may multiply a past force instead, kept to one lag each so that stability can be proved
force:
  lags: [1, 2]
  speed: {lags: [0], powers: [0.5, 1.0, 1.5], forms: [signed, magnitude]}
  current: {lags: [8], powers: [1.0, 2.0], forms: [magnitude]}
speed:
  lags: [0, 3, 8]
  powers: [0.5, 1.0, 2.0]
  forms: [signed, magnitude]
current:
  lags: [0, 8, 16]
  powers: [1.0, 2.0]
  forms: [magnitude]
position:
  lags: [0]
  powers: [1.0, 2.0]
  forms: [signed]
products:
  - []
  - [speed]
  - [current]
  - [position]
  - [speed, current]
  - [position, current]
  - [force]
  - [force, speed]
  - [force, current]
  - [force, speed, current]
"""


def load_rules(path: Path | None) -> Rules:
    """Read candidate rules, the built-in ones if `path` is None; raises CesError naming file and key."""
    source = "built-in candidate rules" if path is None else str(path)
    try:
        text = DEFAULT_RULES if path is None else path.read_text(encoding="utf-8")
        raw = yaml.safe_load(text)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise CesError(f"{source}: cannot be read as candidate rules: {' '.join(str(error).split())}") from None
    return parse_rules(raw, source)


def parse_rules(raw: object, source: str) -> Rules:
    """Check candidate rules given as nested mappings; raises CesError."""
    if not isinstance(raw, Mapping):
        raise CesError(f"{source}: expected a mapping with {', '.join(SIGNALS)} and products")
    unknown = sorted(set(map(str, raw)) - {*SIGNALS, "products"})
    if unknown:
        raise CesError(f"{source}: unknown key '{unknown[0]}'; expected {', '.join(SIGNALS)} or products")
    force, beside = _split_force(raw.get("force"), source)
    given = {**raw, "force": force} if "force" in raw else raw
    signals = {s: _signal_rule(s, given[s], f"{source}: {s}") for s in SIGNALS if s in given}
    return Rules(signals, _products(raw.get("products"), signals, source), beside)


def _split_force(raw: object, source: str) -> tuple[object, dict[str, SignalRule]]:
    """Return the rule of past forces without, and with alone, the rules of the signals beside them."""
    if not isinstance(raw, Mapping):
        return raw, {}
    beside = {s: _signal_rule(s, raw[s], f"{source}: force: {s}") for s in SIGNALS[1:] if s in raw}
    return {key: value for key, value in raw.items() if key not in beside}, beside


def _signal_rule(signal: str, raw: object, where: str) -> SignalRule:
    if not isinstance(raw, Mapping):
        raise CesError(f"{where}: expected lags, powers and forms")
    unknown = sorted(set(map(str, raw)) - {"lags", "powers", "forms"})
    if unknown:
        raise CesError(f"{where}: unknown key '{unknown[0]}'; expected lags, powers or forms")
    least = 1 if signal == "force" else 0
    lags = _listed(raw, "lags", where)
    if not all(isinstance(x, int) and not isinstance(x, bool) and least <= x <= MAX_LAG for x in lags):
        raise CesError(f"{where}: lags {list(lags)}; expected whole numbers from {least} to {MAX_LAG}")
    powers = _listed(raw, "powers", where) if "powers" in raw else (1.0,)
    if not all(isinstance(x, int | float) and 0.0 <= x <= MAX_POWER for x in powers):
        raise CesError(f"{where}: powers {list(powers)}; expected numbers from 0 to {MAX_POWER:g}")
    forms = _listed(raw, "forms", where) if "forms" in raw else ("signed",)
    if not set(forms) <= set(FORMS):
        raise CesError(f"{where}: forms {list(forms)}; expected {' or '.join(FORMS)}")
    return SignalRule(lags, tuple(float(p) for p in powers), forms)


def _listed(raw: Mapping[str, Any], key: str, where: str) -> tuple[Any, ...]:
    value = raw.get(key)
    if not isinstance(value, list) or not value:
        raise CesError(f"{where}: {key} is {value!r}; expected a list")
    return tuple(dict.fromkeys(value))


def _products(raw: object, signals: Mapping[str, SignalRule], source: str) -> tuple[tuple[str, ...], ...]:
    if not isinstance(raw, list) or not raw:
        raise CesError(f"{source}: products is {raw!r}; expected a list of lists of signals")
    products = []
    for item in raw:
        if not isinstance(item, list) or len(set(item)) != len(item) or not set(item) <= set(signals):
            raise CesError(f"{source}: product {item!r}; expected different signals among {', '.join(signals)}")
        products.append(tuple(item))
    return tuple(dict.fromkeys(products))
