"""Sigmoid networks at the desk: random starts, errors and derivatives of a fit, sizes, batch run and report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics.core import core_kernel
from ces_identify.numerics.least_squares import Penalty, pull_towards
from ces_identify.prepare.series import SimulatedSeries
from ces_identify.structures.kit import AUTO, StructureKit
from ces_identify.structures.lagged import LaggedShape
from ces_identify.training import (
    DECAY,
    LAG_SETS,
    Family,
    LagCounts,
    Lags,
    Training,
    build_regressors,
    normal_equations,
)
from ces_observer.model import Model
from ces_observer.options import Option
from ces_observer.structures.network import Network, SigmoidUnit
from ces_observer.tick.lagged import LAGGED_PHI
from ces_observer.tick.sigmoid import (
    SIGMOID_LAYER, SIGMOID_OUTPUTS, SIGMOID_SCALE, SIGMOID_UNITS, SIGMOID_WEIGHTS, sigmoid_force,
)  # fmt: skip
from ces_report.table import Section, parameter_section
from ces_report.typesetting import describe_signals, four_figures, signal_symbol

FIRST_GAIN = 0.9  # gain of the past forces in a start
FIRST_SLOPE = 1.5  # standard deviation of a start's slopes, all inputs together
FIRST_WEIGHT = 0.05
STEEPEST_SLOPE = 0.25  # of a sigmoid
RUNGS = (2, 4, 6, 10, 20, 40)  # numbers of units from which larger networks grow
KINK = 5e-4  # width over which the kink of |x| is smoothed in the gain


@core_kernel
def fill_sigmoid_slopes(p: F, n: I, s: F, y: float, past_lags: I, past_spreads: F, row: F, gains: F) -> None:
    """Fill `row` with the derivatives of a tick's force by the parameters, `gains` with those by the past forces.

    Parameters of R regressors: constant, linear (R), then for each unit its weight, bias and slopes (R).
    """
    scale, layer, phi, r = p[SIGMOID_SCALE], n[SIGMOID_LAYER], n[LAGGED_PHI], len(gains)
    row[0] = scale
    for j in range(r):
        row[1 + j] = scale * s[phi + j]
        gains[j] = scale * p[layer + j]
    at = 1 + r
    for i in range(n[SIGMOID_UNITS]):
        layer += 1 + r
        sigmoid = s[n[SIGMOID_OUTPUTS] + 1 + i]
        steep = scale * p[n[SIGMOID_WEIGHTS] + i] * sigmoid * (1.0 - sigmoid)
        row[at] = scale * sigmoid
        row[at + 1] = steep
        for j in range(r):
            row[at + 2 + j] = steep * s[phi + j]
            if past_lags[j] > 0:
                gains[j] += steep * p[layer + j]
        at += 2 + r
    for j in range(r):
        gains[j] /= past_spreads[j]


@dataclass(frozen=True)
class NetworkFit(Family):
    """Networks of `units` sigmoids; `decay` is the cost of a squared parameter in (J / 100)^2."""

    units: int
    decay: float
    kernel: ClassVar = staticmethod(normal_equations(sigmoid_force, fill_sigmoid_slopes))

    @property
    def size(self) -> int:
        """Number of units."""
        return self.units

    def start(self, random: np.random.Generator) -> F:
        """Return random parameters: a slow affine model of the past, and units that depend on the inputs only."""
        r = len(self.regressors)
        linear, units = np.zeros(r), random.normal(0.0, FIRST_SLOPE / np.sqrt(r), (self.units, 2 + r))
        linear[self.past] = FIRST_GAIN / max(1, len(self.past))
        units[:, 0] = random.normal(0.0, FIRST_WEIGHT, self.units)
        units[:, 1] = random.normal(0.0, 1.0, self.units)
        units[:, 2 + self.past] = 0.0
        constant = (1.0 - linear.sum()) * self.training.level
        return np.concatenate([[constant], linear, units.ravel()])

    def smaller(self) -> NetworkFit | None:
        """Return the networks with the next smaller number of units on the ladder."""
        fewer = [units for units in RUNGS if units < self.units]
        return replace(self, units=fewer[-1]) if fewer else None

    def grow(self, smaller: NetworkFit, params: F, random: np.random.Generator) -> F:
        """Return the smaller network with further units, of weight 0."""
        grown = self.start(random)
        grown[: len(params)] = params
        grown[len(params) :: 2 + len(self.regressors)] = 0.0
        return grown

    @property
    def pull(self) -> Penalty:
        """The pull of all parameters towards 0."""
        count = 1 + len(self.regressors) + self.units * (2 + len(self.regressors))
        return pull_towards(np.zeros(count), np.full(count, self.decay))

    def gains(self, params: F) -> tuple[F, F]:
        """Return the bound of ces_observer.structures.network (1,), smoothed upward, and its gradient (1, params)."""
        r = len(self.regressors)
        units = params[1 + r :].reshape(self.units, 2 + r)
        slope, unit_slopes = np.zeros_like(params), np.zeros_like(units)
        gain = 0.0
        for j in self.past:
            products = STEEPEST_SLOPE * units[:, 0] * units[:, 2 + j]
            smoothed = np.hypot(products, KINK)
            high = params[1 + j] + 0.5 * (smoothed + products).sum()
            low = params[1 + j] - 0.5 * (smoothed - products).sum()
            sign = 1.0 if high >= -low else -1.0
            derivative = 0.5 * STEEPEST_SLOPE * (sign + products / smoothed)
            gain += max(high, -low)
            slope[1 + j] = sign
            unit_slopes[:, 0] += derivative * units[:, 2 + j]
            unit_slopes[:, 2 + j] += derivative * units[:, 0]
        slope[1 + r :] = unit_slopes.ravel()
        return np.array([gain]), slope[None]

    def body(self, params: F) -> Network:
        """Return the network with these parameters."""
        r = len(self.regressors)
        rows = params[1 + r :].reshape(self.units, 2 + r).tolist()
        units = tuple(SigmoidUnit(row[0], row[1], tuple(row[2:])) for row in rows)
        linear = tuple(params[1 : 1 + r].tolist())
        return Network(self.regressors, self.training.scale_N, float(params[0]), linear, units)


MAX_COUNT = 20  # lags of a signal: three times as many stay below MAX_REGRESSORS


@dataclass(frozen=True)
class NetworkShape(LaggedShape):
    """The size of a sigmoid network (thesis eq. 3.4): largest number of units, lags, cost of a squared parameter."""

    option: ClassVar[str] = Network.option
    units: int = 10
    lags: Lags | LagCounts | None = None
    decay: float = DECAY
    stroke: bool = False

    def with_inputs(self, lags: Lags | LagCounts, stroke: bool) -> NetworkShape:
        """Return the shape with these lags, and with the position among the regressors."""
        return replace(self, lags=lags, stroke=stroke)

    def family(self, data: Training, rate_Hz: float) -> NetworkFit:
        """Return the networks of this size for the data."""
        lags = self.lags or LAG_SETS[0]
        lags = lags.at_rate(rate_Hz) if isinstance(lags, LagCounts) else lags
        lags = replace(lags, position_s=(0.0,)) if self.stroke else lags
        return NetworkFit(data, build_regressors(data, lags, rate_Hz), self.units, self.decay)


def read_lags(text: str) -> LagCounts | None:
    """Return the counts `Y,C,V` (thesis table 5.2), None for `auto`; raises ValueError."""
    if text == AUTO:
        return None
    counts = text.split(",")
    if len(counts) != 3 or not all(count.strip().isdecimal() and int(count) <= MAX_COUNT for count in counts):
        raise ValueError(
            f"'{text}' is not Y,C,V, such as 2,4,5: numbers of past forces, currents and speeds from 0 to {MAX_COUNT}"
        )
    lags = LagCounts(*map(int, counts))
    if not lags.currents + lags.speeds:
        raise ValueError(f"'{text}' leaves no input; expected at least one current or speed")
    return lags


def network_table(network: Network, model: Model, runs: Sequence[SimulatedSeries], role: str) -> Section:
    """Return the regressors, with the force for a change of each."""
    about = (
        f"A sigmoid network of {len(network.units)} units. Linear part and units: force for a change by one spread, "
        "for the units where all are steepest. Mean and spread (standard deviation) in the signal's unit."
    )
    all_units_N = [
        network.scale_N * sum(0.25 * abs(unit.weight * unit.slopes[j]) for unit in network.units)
        for j in range(len(network.regressors))
    ]
    heads = ("Regressor", "Mean", "Spread", "Linear part [N]", "Units [N]")
    rows = [
        (signal_symbol(r.signal, r.lag), *map(four_figures, (r.mean, r.spread, network.scale_N * slope, units_N)))
        for r, slope, units_N in zip(network.regressors, network.linear, all_units_N, strict=True)
    ]
    symbols = describe_signals((r.signal for r in network.regressors), model.sampling.rate_Hz)
    return parameter_section(about, heads, rows, symbols)


UNITS = Option("units", NetworkShape().units, "sigmoids of a sigmoid network, at most", 1, 60, metavar="N")
NETWORK_LAGS = Option(
    "lags",
    AUTO,
    "numbers of past forces, currents and speeds that a sigmoid network uses (thesis table 5.2), such as 2,4,5: past "
    "forces from one tick ago, the others from the present tick; auto: chosen by short fits",
    form=f"{AUTO} or counts Y,C,V such as '2,4,5', each from 0 to {MAX_COUNT}",
    check_text=read_lags,
    metavar="Y,C,V",
)
SIGMOID = StructureKit(
    about="sigmoid network NARX",
    body=Network,
    sizes=(UNITS, NETWORK_LAGS),
    fitter=lambda sizes: NetworkShape(units=int(sizes["units"]), lags=read_lags(str(sizes["lags"]))),
    table=network_table,
)
