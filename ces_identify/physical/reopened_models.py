"""A physical model from its file, opened again for a fit: structure and data in, its family and parameters out."""

from __future__ import annotations

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.physical.chambers_models import DROPS, FLOWS, SUCTIONS, ChambersModels, chamber_arrays
from ces_identify.physical.common_groups import CURRENTS, POSITIONS, DataScales
from ces_identify.physical.models import Body, PhysicalModels
from ces_identify.physical.relaxation_models import SLOW_YIELD, SPEEDS, RelaxationModels, relaxation_arrays
from ces_identify.trained.training import Training
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.relaxation import Relaxation

SAME = 1e-6  # relative difference of the kernels' vector by rounding


def reopen(body: Body, interval_s: float, training: Training) -> tuple[PhysicalModels, F] | None:
    """Return the models on the nodes of `body`, to be fitted to `training`, and its parameters theta.

    None if it was not made by these models: nodes or bounds are others.
    """
    if not _has_usual_nodes(body):
        return None
    models: PhysicalModels
    if isinstance(body, Relaxation):
        models, k = _open_relaxation(body, interval_s, training)
    else:
        models, k = _open_chambers(body, interval_s, training)
    layout = models.layout
    if layout.matrix.shape[0] != len(k):
        return None
    theta: F = np.asarray(np.linalg.lstsq(layout.matrix, k - layout.offset, rcond=None)[0], np.float64)
    inside = layout.project(theta)
    return (models, inside) if np.allclose(layout.k(inside), k, rtol=SAME, atol=SAME * np.abs(k).mean()) else None


def _has_usual_nodes(body: Body) -> bool:
    """True if the numbers of nodes are those that a fit gives."""
    if (len(body.valve.characteristic.at), len(body.side.position_m)) != (CURRENTS, POSITIONS):
        return False
    if isinstance(body, Relaxation):
        return len(body.map.at) == 2 * len(SPEEDS) + 1 and len(body.map.rows) > 1 and len(body.springs) > 1
    counts = tuple(map(len, (body.map.at, body.check.at, body.refill.at)))
    return counts == (len(FLOWS), len(DROPS), len(SUCTIONS)) and len(body.map.rows) > 1


def _open_relaxation(body: Relaxation, interval_s: float, training: Training) -> tuple[PhysicalModels, F]:
    scales = _read_scales(body, body.springs[-1].yield_N[0] / SLOW_YIELD, body.map.at[-1] / SPEEDS[-1], interval_s)
    return (
        RelaxationModels(training, scales, rows=len(body.map.rows), springs=len(body.springs) - 1),
        relaxation_arrays(body, interval_s).k,
    )


def _open_chambers(body: Chambers, interval_s: float, training: Training) -> tuple[PhysicalModels, F]:
    scales = _read_scales(body, body.check.at[-1] / DROPS[-1], body.map.at[-1] / FLOWS[-1], interval_s)
    return (
        ChambersModels(training, scales, rows=len(body.map.rows), friction=len(body.side.friction)),
        chamber_arrays(body, interval_s).k,
    )


def _read_scales(body: Body, force_N: float, speed_m_s: float, interval_s: float) -> DataScales:
    return DataScales(
        force_N,
        speed_m_s,
        np.array(body.valve.characteristic.at),
        np.array(body.side.position_m),
        body.side.max_acceleration_m_s2,
        interval_s,
    )
