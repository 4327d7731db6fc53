"""Candidate regressors: rules go in, the terms that they make come out.

The rules say which signals, lags, powers and products may make terms. The candidates are counted before any is built;
more than the search can hold are refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, product
from math import prod
from typing import ClassVar, Self

from ces_observer.errors import CesError
from ces_observer.fields import Schema
from ces_observer.limits import FileLimits
from ces_observer.records import bounded, part
from ces_observer.structures.constructed_inputs import (
    ConstructedInput,
    Lag,
    TriangularMembership,
)
from ces_observer.structures.polynomial import Factor, Term

FORMS = {"signed": True, "magnitude": False}
MAX_CANDIDATES = 6000
MAX_CHOICES = 100_000  # combinations of factors that are tried
MAX_LAG_MS = 200.0
SIGNALS = ("force", "speed", "current", "position")

Constructions = Mapping[str, tuple[ConstructedInput, ...]]  # by their name in rules and products


@dataclass(frozen=True)
class SignalRule:
    """Lags, powers and forms (signed or magnitude) a signal may take in a term.

    Lags are in ticks, or else in milliseconds, to the nearest tick. `again` is the rule of the signal's next factor in
    a product that names it again; without it, that factor has the same rule and another lag.
    """

    lags: tuple[int, ...] = part(
        default=(), meaning="at the model's rate", low=0, high=FileLimits.MAX_LAG, unit="ticks"
    )
    lags_ms: tuple[float, ...] = part(default=(), meaning="instead of lags", low=0.0, high=MAX_LAG_MS, unit="ms")
    powers: tuple[float, ...] = bounded(0.0, FileLimits.MAX_POWER, default=(1.0,))
    forms: tuple[str, ...] = part(default=("signed",), choices=tuple(FORMS), min_count=1)
    again: SignalRule | None = part(default=None, rules={"$ref": "#/definitions/rule"})
    schema_rules: ClassVar[Schema] = {"oneOf": [{"required": ["lags"]}, {"required": ["lags_ms"]}]}

    def checked(self) -> Self:
        """Return it without repetitions; raises CesError unless it has lags of one kind."""
        if bool(self.lags) == bool(self.lags_ms):
            raise CesError("expected a list of lags, in ticks (lags) or in milliseconds (lags_ms)")
        return replace(
            self,
            lags=tuple(dict.fromkeys(self.lags)),
            lags_ms=tuple(dict.fromkeys(self.lags_ms)),
            powers=tuple(dict.fromkeys(self.powers)),
            forms=tuple(dict.fromkeys(self.forms)),
        )

    def at_rate(self, rate_Hz: float) -> SignalRule:
        """Return the rule with its lags in ticks of that rate, without repetitions."""
        ticks = (min(FileLimits.MAX_LAG, round(lag * 1e-3 * rate_Hz)) for lag in self.lags_ms)
        again = self.again and self.again.at_rate(rate_Hz)
        return replace(self, lags=self.lags or tuple(dict.fromkeys(ticks)), lags_ms=(), again=again)

    def with_last_lag(self) -> SignalRule:
        """Return the rule of the magnitude at the last lag alone."""
        return SignalRule(self.lags[-1:], self.lags_ms[-1:], forms=("magnitude",))

    def factors(self, signal: str) -> tuple[Factor, ...]:
        """Return every factor that the rule allows, except |s|^0, which is 1."""
        if signal == "force":
            return tuple(Factor("force", lag) for lag in self.lags)
        lags = self.lags or [int(lag) for lag in self.lags_ms]
        return tuple(
            Factor(signal, lag, power, FORMS[form])
            for lag, power, form in product(lags, self.powers, self.forms)
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

        def set_time_constant(definition: ConstructedInput) -> ConstructedInput:
            if isinstance(definition, TriangularMembership) and definition.base is not None:
                return replace(definition, base=set_time_constant(definition.base))
            if isinstance(definition, Lag) and definition.name == name:
                return replace(definition, time_constant_s=seconds)
            return definition

        return replace(
            self,
            constructed={n: tuple(map(set_time_constant, group)) for n, group in self.constructed.items()},
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
        if any(rule.lags_ms for rule in (*self.signals.values(), *self.beside_force.values())):
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
        return tuple(replace(f, signal=d.name, definition=d) for d in self.constructed[signal] for f in factors)


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
