"""Sigmoid networks offline: size, fit, batch run and table for the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from markupsafe import Markup

from ces_identify.numerics.arrays import F, I
from ces_identify.preparation.simulated_series import SimulatedSeries
from ces_identify.structures.kit import SizeOption, StructureKit
from ces_identify.structures.lagged_fit import LaggedShape
from ces_identify.trained.lagged_kernels import lagged_free_run
from ces_identify.trained.lagged_table import regressor_table
from ces_identify.trained.network_fit import NetworkFit
from ces_identify.trained.network_kernels import NetworkArrays
from ces_identify.trained.training import LAGS, LagCounts, Lags, Training, build_regressors
from ces_identify.typesetting import ModelTable, describe_signals, four_figures, parameter_table, signal_symbol
from ces_observer.model import Model
from ces_observer.structures.network import Network

AUTO = "auto"
MAX_COUNT = 20  # lags of a signal: three times as many stay below MAX_REGRESSORS


@dataclass(frozen=True)
class NetworkShape(LaggedShape):
    """The size of a sigmoid network (thesis eq. 3.4): units, lags, and the cost of a squared parameter."""

    option: ClassVar[str] = "sigmoid"
    units: int = 10
    lags: Lags | LagCounts = LAGS
    decay: float = 3e-6  # [(J / 100)^2]

    def family(self, data: Training, rate_Hz: float) -> NetworkFit:
        """Return the networks of this size for the data."""
        return NetworkFit(data, build_regressors(data, self.lags, rate_Hz), self.units, self.decay)


def read_lags(text: str) -> Lags | LagCounts:
    """Return the lags of `auto` or of the counts `Y,C,V` (thesis table 5.2); raises ValueError."""
    if text == AUTO:
        return LAGS
    counts = text.split(",")
    if len(counts) != 3 or not all(one.strip().isdecimal() and int(one) <= MAX_COUNT for one in counts):
        raise ValueError(
            f"'{text}' is not Y,C,V, such as 2,4,5: numbers of past forces, currents and speeds from 0 to {MAX_COUNT}"
        )
    lags = LagCounts(*map(int, counts))
    if not lags.currents + lags.speeds:
        raise ValueError(f"'{text}' leaves no input; expected at least one current or speed")
    return lags


def run_network(network: Network, model: Model, inputs: F, segments: I) -> tuple[F, int]:
    """Return the batch run of a sigmoid network, as `StructureKit.batch_run` describes it."""
    table = regressor_table(network.regressors, model.envelope, inputs, segments)
    units = [number for unit in network.units for number in (unit.weight, unit.bias, *unit.slopes)]
    params = np.array([network.constant, *network.linear, *units])
    arrays = NetworkArrays(network.scale_N, params, len(network.units))
    force, diverged = lagged_free_run(table, segments, arrays, *model.force_envelope_N)
    return np.asarray(force), int(diverged)


def network_table(network: Network, model: Model, runs: Sequence[SimulatedSeries], role: str) -> ModelTable:
    """Return the regressors, with the force for a change of each."""
    about = (
        f"A sigmoid network of {len(network.units)} units. Linear part and units: force for a change by one spread, "
        "for the units where all are steepest. Mean and spread (standard deviation) in the signal's unit."
    )
    heads = ("Regressor", "Mean", "Spread", "Linear part [N]", "Units [N]")
    rows = [
        (signal_symbol(r.signal, r.lag), *map(four_figures, (r.mean, r.spread, *_steps(network, j))))
        for j, r in enumerate(network.regressors)
    ]
    symbols = describe_signals((r.signal for r in network.regressors), model.sampling.rate_Hz)
    return parameter_table(about, tuple(map(Markup, heads)), tuple(rows), symbols)


def _steps(network: Network, j: int) -> tuple[float, float]:
    units = sum(0.25 * abs(unit.weight * unit.slopes[j]) for unit in network.units)
    return network.scale_N * network.linear[j], network.scale_N * units


UNITS = SizeOption(
    "units", NetworkShape().units, "sigmoids of a sigmoid network", "whole numbers from 1 to 60", whole=(1, 60)
)
NETWORK_LAGS = SizeOption(
    "lags",
    AUTO,
    "numbers of past forces, currents and speeds that a sigmoid network uses (thesis table 5.2), such as 2,4,5: past "
    "forces from one tick ago, the others from the present tick",
    f"{AUTO} or counts Y,C,V such as '2,4,5', each from 0 to {MAX_COUNT}",
    check=read_lags,
    metavar="Y,C,V",
)
SIGMOID = StructureKit(
    option=NetworkShape.option,
    about="sigmoid network NARX",
    body=Network,
    sizes=(UNITS, NETWORK_LAGS),
    fitter=lambda sizes: NetworkShape(units=int(sizes["units"]), lags=read_lags(str(sizes["lags"]))),
    batch_run=run_network,
    table=network_table,
)
