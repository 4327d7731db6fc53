"""The numbers of a sigmoid network or a neuro-fuzzy model as a table for people, in newtons where that can be said."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from ces_identify.report.drawing import minus
from ces_identify.report.terms import SYMBOLS, UNITS
from ces_observer.model import Model
from ces_observer.structures.fuzzy import Fuzzy, Rule
from ces_observer.structures.network import Network


@dataclass(frozen=True)
class ParameterTable:
    """A table: what it shows in a sentence, column heads, and rows of a first cell and numbers."""

    about: str
    heads: tuple[Markup, ...]
    rows: tuple[tuple[Markup, ...], ...]


def parameter_table(model: Model) -> ParameterTable | None:
    """Return the table of a network's regressors or of the rules of a neuro-fuzzy model; None for a polynomial."""
    if model.network is not None:
        return _network_table(model.network)
    return _fuzzy_table(model.fuzzy) if model.fuzzy is not None else None


def _network_table(network: Network) -> ParameterTable:
    about = (
        f"A sigmoid network of {len(network.units)} units. Linear part and units: force for a step of one spread, "
        "that of the units where all are steepest; mean and spread in the signal's unit."
    )
    heads = ("Regressor", "Mean", "Spread", "Linear part [N]", "Units [N]")
    rows = [
        (_symbol(r.signal, r.lag), *map(_number, (r.mean, r.spread, *_steps(network, j))))
        for j, r in enumerate(network.regressors)
    ]
    return ParameterTable(about, tuple(map(Markup, heads)), tuple(rows))


def _steps(network: Network, j: int) -> tuple[float, float]:
    units = sum(0.25 * abs(unit.weight * unit.slopes[j]) for unit in network.units)
    return network.scale_N * network.linear[j], network.scale_N * units


def _fuzzy_table(fuzzy: Fuzzy) -> ParameterTable:
    about = (
        f"A neuro-fuzzy model of {len(fuzzy.rules)} rules, each an affine model that holds about the values named. "
        "Numbers: force [N] for a step of one spread of the regressor."
    )
    heads = (Markup("Rule: about"), Markup("Constant [N]"), *(_symbol(r.signal, r.lag) for r in fuzzy.regressors))
    rows = [
        (_about(fuzzy, rule), *(_number(fuzzy.scale_N * number) for number in (rule.constant, *rule.linear)))
        for rule in fuzzy.rules
    ]
    return ParameterTable(about, heads, tuple(rows))


def _about(fuzzy: Fuzzy, rule: Rule) -> Markup:
    parts = [
        Markup("{} = {} {}").format(_symbol(p.signal, p.lag), minus(f"{p.memberships[m].centre:.3g}"), UNITS[p.signal])
        for p, m in zip(fuzzy.premises, rule.memberships, strict=True)
    ]
    return Markup(", ").join(parts)


def _symbol(signal: str, lag: int) -> Markup:
    ago = f"\N{MINUS SIGN}{lag}" if lag else ""
    return Markup('<span class="signal"><var>{}</var>(<var>k</var>{})</span>').format(SYMBOLS[signal], ago)


def _number(value: float) -> Markup:
    return Markup("{}").format(minus(f"{value:.4g}"))
