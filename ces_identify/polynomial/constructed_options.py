"""The options for constructed inputs and blended sub-models: rules in, rules with more candidates out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ces_identify.polynomial.constructed_rules import AUTO, constructions_from, replace_auto
from ces_identify.polynomial.regressors import CandidateRules, SignalRule
from ces_observer.errors import CesError
from ces_observer.structures.constructed_inputs import BASE, TriangularMembership

HYSTERESIS, REMANENCE, LAG, FREQUENCY = "hysteresis", "remanence", "lag", "frequency"
CURRENT, VALVE = "current", "valve"  # products with the current use the valve's if the rules have it
MAX_BLENDED_INPUTS = 2  # inputs of a term besides its membership
NO_LAG = SignalRule((0,))
EXPECTED = "hysteresis:M,... or remanence:A,... or lag:S,... or frequency or frequency:S"

CONSTRUCTED_RULES: Mapping[str, SignalRule] = {
    HYSTERESIS: SignalRule((0,), (1.0, 2.0), ("signed",)),
    REMANENCE: SignalRule((0, 8), (1.0, 2.0), ("magnitude",), in_ms=True),
    LAG: SignalRule((0,), (1.0, 2.0), ("magnitude",)),
    FREQUENCY: SignalRule((0,), (0.5, 1.0), ("magnitude",)),
}
CONSTRUCTED_PRODUCTS: Mapping[str, tuple[tuple[str, ...], ...]] = {
    HYSTERESIS: ((), (CURRENT,), ("speed",), ("speed", CURRENT)),
    REMANENCE: ((), ("speed",), ("position",)),
    LAG: ((), ("speed",), ("position",)),
    FREQUENCY: (("speed",), ("speed", CURRENT)),
}


def add_constructed_inputs(rules: CandidateRules, spec: str) -> CandidateRules:
    """Return `rules` with the constructed inputs of `spec` and their products; raises CesError.

    `spec` is `hysteresis:W,...` (stops of the position, half widths in m), `remanence:W,...` (plays of the current,
    half widths in A), `lag:T,...` (first-order lags of the current, time constants in s or `auto`), `frequency` or
    `frequency:T` (window in s).
    """
    kind, _, text = spec.partition(":")
    if kind not in CONSTRUCTED_RULES or (kind != FREQUENCY and not text):
        raise CesError(f"'{spec}': expected {EXPECTED}")
    settings = [AUTO if kind == LAG and one == AUTO else _parse_number(one, spec) for one in text.split(",") if one]
    if kind == FREQUENCY:
        window = {"time_constant_s": settings[0]} if settings else {}
        return _add_inputs(rules, {FREQUENCY: {"kind": FREQUENCY, **window}}, kind)
    return _add_inputs(rules, {f"{kind}_{i + 1}": _definition(kind, one) for i, one in enumerate(settings)}, kind)


def add_blend(rules: CandidateRules, spec: str) -> CandidateRules:
    """Return `rules` with each product repeated for every sub-model of a blend; raises CesError.

    `spec` is `SIGNAL:A,B,...`: one sub-model applies at A (and below), one at B, and so on (and above the last), with
    linear blending between; SIGNAL is position, speed, current or a constructed input of `rules`. If these use only the
    valve's current, `current` means that, as a proof would treat the two as independent. The original products remain
    for the part that the sub-models share.
    """
    of, _, text = spec.partition(":")
    of = VALVE if of == CURRENT and CURRENT not in rules.signals and VALVE in rules.signals else of
    smooth = [name for name, group in rules.constructed.items() if not isinstance(group[0], TriangularMembership)]
    known = (*BASE, *smooth)
    if of not in known:
        raise CesError(f"'{spec}': expected SIGNAL:A,B,... with a signal among {', '.join(known)}")
    name = f"by_{of}"
    raw = {name: {"kind": "hats", "of": of, "at": [_parse_number(one, spec) for one in text.split(",") if one]}}
    blended = [p for p in rules.products if len(set(p) - {"force"}) <= MAX_BLENDED_INPUTS]
    return _extend_rules(rules, raw, _membership_rule(rules, of), [(name, *p) for p in blended])


def _membership_rule(rules: CandidateRules, of: str) -> SignalRule:
    """Return the rule of memberships over `of`, at the signal's lag beside past forces, which keeps proofs short."""
    beside = rules.beside_force.get(of, rules.signals.get(of, NO_LAG))
    return SignalRule(beside.lags[-1:], (1.0,), ("magnitude",), beside.in_ms)


def _definition(kind: str, setting: float | str) -> dict[str, object]:
    if kind == LAG:
        return {"kind": "lag", "of": CURRENT, "time_constant_s": setting}
    how = {"kind": "stop", "of": "position"} if kind == HYSTERESIS else {"kind": "play", "of": CURRENT}
    return {**how, "half_width": setting}


def _add_inputs(rules: CandidateRules, raw: Mapping[str, object], kind: str) -> CandidateRules:
    current = VALVE if VALVE in rules.signals else CURRENT
    beside = [tuple(current if signal == CURRENT else signal for signal in p) for p in CONSTRUCTED_PRODUCTS[kind]]
    products = [(name, *p) for name in raw for p in beside if set(p) <= set(rules.signals)]
    return _extend_rules(rules, raw, CONSTRUCTED_RULES[kind], products)


def _extend_rules(
    rules: CandidateRules, raw: Mapping[str, object], rule: SignalRule, products: Sequence[tuple[str, ...]]
) -> CandidateRules:
    """Return `rules` with the definitions `raw`, all with `rule`, and `products`."""
    repeated = sorted(set(raw) & {*rules.signals, *rules.constructed})
    if repeated:
        raise CesError(
            f"constructed input '{repeated[0]}': is defined already; give each of --construct and --blend once"
        )
    block, open_lags = replace_auto(raw)
    return replace(
        rules,
        signals={**rules.signals, **dict.fromkeys(raw, rule)},
        products=(*rules.products, *products),
        constructed=constructions_from(block, "constructed", rules.constructed),
        open_lags=(*rules.open_lags, *open_lags),
    )


def _parse_number(text: str, spec: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise CesError(f"'{spec}': expected numbers after the colon, with commas between") from None
