"""A sigmoid network NARX (thesis eq. 3.4): its numbers as the model file keeps them, and its free run tick by tick.

force = scale_N * (constant + linear . phi + sum over units of weight * s(slopes . phi + bias)), s(x) = 1 / (1 + e^-x),
with phi the scaled regressors (past forces, currents, speeds, positions).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp
from operator import mul
from typing import Any

from ces_observer.checked import Checked
from ces_observer.structures.lagged import (
    LEAST_SPREAD,
    MOST_NUMBER,
    Lagged,
    Range,
    Regressor,
    number_from,
    regressors_from,
)

MOST_UNITS = 200
STEEPEST = 700.0  # e^x overflows beyond


@dataclass(frozen=True)
class Unit:
    """One sigmoid: its weight in the output, its bias, and its slope along each regressor."""

    weight: float
    bias: float
    slopes: tuple[float, ...]


@dataclass(frozen=True)
class Network:
    """The numbers of a sigmoid network; `linear` and each unit's slopes have one number for each regressor."""

    regressors: tuple[Regressor, ...]
    scale_N: float
    constant: float
    linear: tuple[float, ...]
    units: tuple[Unit, ...]

    @property
    def max_lag(self) -> int:
        """Longest lag of any regressor in ticks."""
        return max(r.lag for r in self.regressors)

    @property
    def size(self) -> str:
        """How large the network is, for people."""
        return f"{len(self.units)} sigmoid units on {len(self.regressors)} regressors"

    def to_json(self) -> dict[str, Any]:
        """Return what the model file keeps."""
        return {
            "regressors": [r.to_json() for r in self.regressors],
            "scale_N": self.scale_N,
            "constant": self.constant,
            "linear": list(self.linear),
            "units": [{"weight": u.weight, "bias": u.bias, "slopes": list(u.slopes)} for u in self.units],
        }


def network_from(node: Checked) -> Network:
    """Check the network of a model file; raises ModelError."""
    node.only("regressors", "scale_N", "constant", "linear", "units")
    regressors = regressors_from(node)
    return Network(
        regressors,
        node.number("scale_N", LEAST_SPREAD, MOST_NUMBER),
        number_from(node, "constant"),
        node.numbers("linear", len(regressors), MOST_NUMBER),
        tuple(_unit(item, len(regressors)) for item in node.items("units", 0, MOST_UNITS)),
    )


def _unit(node: Checked, regressors: int) -> Unit:
    node.only("weight", "bias", "slopes")
    slopes = node.numbers("slopes", regressors, MOST_NUMBER)
    return Unit(number_from(node, "weight"), number_from(node, "bias"), slopes)


class NetworkRun:
    """The free run of a network; `clamped` tells whether the last tick's inputs were outside the envelope."""

    __slots__ = ("_network", "_past")

    def __init__(self, network: Network, bounds: Mapping[str, Range], limits: Range) -> None:
        """Clamp inputs to `bounds` (by signal); a force outside `limits` [N] ends the run."""
        self._network = network
        self._past = Lagged(network.max_lag, bounds, limits)

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the envelope and were clamped to it."""
        return self._past.clamped

    def reset(self) -> None:
        """Forget the past: forces before now count as zero, inputs before now as the first ones to come."""
        self._past.reset()

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick; infinite if it left the force envelope."""
        past, network = self._past, self._network
        past.arrive(position, speed, current)
        phi = past.values(network.regressors)
        total = network.constant + _dot(network.linear, phi)
        for unit in network.units:
            total += unit.weight * sigmoid(_dot(unit.slopes, phi) + unit.bias)
        return past.keep(network.scale_N * total)


def sigmoid(x: float) -> float:
    """Return 1 / (1 + e^-x)."""
    return 1.0 / (1.0 + exp(min(-x, STEEPEST)))


def _dot(one: Sequence[float], two: Sequence[float]) -> float:
    return float(sum(map(mul, one, two)))
