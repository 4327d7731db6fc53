"""Free runs of networks and neuro-fuzzy models in batch: a model and uniform inputs in, force out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_identify.trained.fuzzy_kernels import fuzzy_free_run
from ces_identify.trained.lagged_table import regressor_table
from ces_identify.trained.network_kernels import network_free_run
from ces_observer.model import Model
from ces_observer.structures.fuzzy import Fuzzy
from ces_observer.structures.lagged import Regressor
from ces_observer.structures.network import Network

F = NDArray[np.float64]
I = NDArray[np.int64]  # noqa: E741


def run_network(model: Model, network: Network, inputs: F, segments: I) -> tuple[F, int]:
    """Return force (ticks,) [N] and the first tick out of the force envelope (-1 if none) of a sigmoid network.

    `inputs` (3, ticks) are position [m], speed [m/s] and current [A].
    """
    table = regressor_table(network.regressors, model.envelope, inputs, segments)
    units = [number for unit in network.units for number in (unit.weight, unit.bias, *unit.slopes)]
    params = np.array([network.constant, *network.linear, *units])
    force, diverged = network_free_run(*table.arrays, segments, network.scale_N, params, *model.force_envelope_N)
    return np.asarray(force), int(diverged)


def run_fuzzy(model: Model, fuzzy: Fuzzy, inputs: F, segments: I) -> tuple[F, int]:
    """Return force (ticks,) [N] and the first tick out of the force envelope (-1 if none) of a neuro-fuzzy model."""
    table = regressor_table(fuzzy.regressors, model.envelope, inputs, segments)
    raw = [Regressor(p.signal, p.lag, 0.0, 1.0) for p in fuzzy.premises]
    premises = regressor_table(raw, model.envelope, inputs, segments).values
    counts = [len(p.memberships) for p in fuzzy.premises]
    bells = [(b.centre, np.log(b.width), np.log(b.slope)) for p in fuzzy.premises for b in p.memberships]
    first = np.cumsum([0, *counts[:-1]])
    force, diverged = fuzzy_free_run(
        *table.arrays,
        segments,
        fuzzy.scale_N,
        premises,
        np.repeat(np.arange(len(counts)), counts),
        np.array([rule.memberships for rule in fuzzy.rules], np.int64) + first,
        np.array([(rule.constant, *rule.linear) for rule in fuzzy.rules]),
        np.array(bells),
        *model.force_envelope_N,
    )
    return np.asarray(force), int(diverged)
