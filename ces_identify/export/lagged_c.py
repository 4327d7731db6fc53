"""The parts of the exported C of sigmoid networks and neuro-fuzzy models.

Both read lagged, scaled regressors from rings of their inputs and forces; templates/{lagged,network,fuzzy}.{c,h}.j2
hold the C.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ces_identify.export.c_text import ConstantTable
from ces_observer.model import Model
from ces_observer.structures.fuzzy import Fuzzy
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.network import STEEPEST, Network
from ces_observer.structures.structure import Range

ARGUMENTS = {"position": "position_m", "speed": "speed_m_s", "current": "current_A"}


@dataclass(frozen=True)
class LaggedInput:
    """An input: its argument of the tick, its range in the envelope, and its ring's size, a power of two; 0: unused."""

    name: str
    argument: str
    range: Range
    ring: int


def network_facts(network: Network, model: Model) -> dict[str, object]:
    """Return the tables of a sigmoid network's tick."""
    units = network.units
    tables = [ConstantTable("LINEAR", network.linear)]
    if units:
        slopes = [slope for unit in units for slope in unit.slopes]
        tables += [
            ConstantTable("WEIGHTS", [unit.weight for unit in units]),
            ConstantTable("BIASES", [unit.bias for unit in units]),
            ConstantTable("SLOPES", slopes, len(network.regressors)),
        ]
    return {
        **_lagged_facts(network.regressors, [(r.signal, r.lag) for r in network.regressors], model),
        "tables": tables,
        "scale": network.scale_N,
        "constant": network.constant,
        "steepest": STEEPEST,
        "units": len(units),
    }


def fuzzy_facts(fuzzy: Fuzzy, model: Model) -> dict[str, object]:
    """Return the tables of a neuro-fuzzy model's tick; the memberships of all premises are numbered in one row."""
    lags = [(r.signal, r.lag) for r in fuzzy.regressors] + [(p.signal, p.lag) for p in fuzzy.premises]
    bells = [bell for premise in fuzzy.premises for bell in premise.memberships]
    starts = [sum(len(p.memberships) for p in fuzzy.premises[:k]) for k in range(len(fuzzy.premises))]
    tables = [
        ConstantTable("BELLS", [value for b in bells for value in (b.centre, b.width, 2.0 * b.slope)], 3),
        ConstantTable("CONSTANTS", [rule.constant for rule in fuzzy.rules]),
        ConstantTable("LINEAR", [slope for rule in fuzzy.rules for slope in rule.linear], len(fuzzy.regressors)),
    ]
    return {
        **_lagged_facts(fuzzy.regressors, lags, model),
        "tables": tables,
        "scale": fuzzy.scale_N,
        "bells": len(bells),
        "premises": [(p, start, len(p.memberships)) for p, start in zip(fuzzy.premises, starts, strict=True)],
        "rules": [[start + m for start, m in zip(starts, rule.memberships, strict=True)] for rule in fuzzy.rules],
    }


def _lagged_facts(regressors: Iterable[Regressor], lags: Iterable[tuple[str, int]], model: Model) -> dict[str, object]:
    """Return the regressors and the rings that hold `lags`: signals, and how many ticks back each is read."""
    deepest: dict[str, int] = {}
    for signal, lag in lags:
        deepest[signal] = max(lag, deepest.get(signal, 0))
    rings = {signal: 1 << lag.bit_length() for signal, lag in deepest.items()}
    ranges = model.envelope.by_signal
    return {
        "regressors": tuple(regressors),
        "rings": rings,
        "inputs": [LaggedInput(name, ARGUMENTS[name], ranges[name], rings.get(name, 0)) for name in ARGUMENTS],
    }
