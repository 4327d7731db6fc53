"""A list of terms in candidate rules, such as `initial`: nested mappings in, the factors of each term out.

A factor is `{signal, lag, power, form}`; only `signal` is required. Lags are in ticks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

from ces_identify.config_file import require_known_keys
from ces_identify.polynomial.repeated_signals import merge_signs
from ces_observer.errors import CesError
from ces_observer.json_checks import JsonObject
from ces_observer.structures.structure import MAX_LAG
from ces_observer.structures.terms import Factor
from ces_observer.structures.terms_file import MAX_FACTORS, MAX_POWER, MAX_TERMS

FORMS = {"signed": True, "magnitude": False}


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
