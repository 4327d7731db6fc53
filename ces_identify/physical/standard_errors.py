"""Standard errors of physical parameters from the scatter of the gradients of blocks of data (sandwich estimate).

With A the Gauss-Newton matrix and g_b the gradient of half the squared error of block b at the optimum, the covariance
is A^-1 (sum_b g_b g_b') A^-1 (White, Econometrica 50, 1982). Blocks are longer than the errors' correlation, so errors
that are alike from tick to tick do not count as independent. Parameters at a bound have none.
"""

from __future__ import annotations

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.physical.models import PhysicalModels

BLOCK_S = 1.0
MIN_BLOCKS = 8


def standard_errors(models: PhysicalModels, theta: F) -> dict[str, list[float]]:
    """Return the standard error of each entry of each group of parameters in the kernels' vector, by its name.

    Empty if there are fewer than MIN_BLOCKS blocks.
    """
    training, layout = models.training, models.layout
    weights = training.estimation + training.selection
    blocks = _number_blocks(training.segments, len(weights), round(BLOCK_S / models.scales.interval_s))
    if blocks.max() + 1 < MIN_BLOCKS:
        return {}
    matrix, gradients = models.block_gradients(theta, weights, blocks)
    free = (theta > layout.low) & (theta < layout.high)
    inverse = np.linalg.pinv(matrix[np.ix_(free, free)] + np.diag((1e-3 / layout.scale[free]) ** 2), hermitian=True)
    spread = layout.matrix[:, free] @ inverse @ gradients[:, free].T
    deviations = np.sqrt((spread**2).sum(axis=1))
    return {g.name: [float(f"{v:.3g}") for v in layout.part(deviations, g.name)] for g in layout.groups}


def _number_blocks(segments: I, ticks: int, length: int) -> I:
    """Return the number of each tick's block; blocks do not cross segments."""
    numbers = np.zeros(ticks, np.int64)
    count = 0
    for start, stop in segments:
        numbers[start:stop] = count + np.arange(stop - start) // length
        count = int(numbers[stop - 1]) + 1 if stop > start else count
    return numbers
