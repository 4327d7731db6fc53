"""How uncertain the fitted parameters of a physical model are, and every number that follows from them.

With A the Gauss-Newton matrix, P the penalty's weights, H = A + P, and g_b the gradient of half the squared error of
block b, the mean squared error of the parameters is  H^-1 (c sum_b g_b g_b' + P S^2 P + g g') H^-1.  The first part
is noise (sandwich estimate: White, Econometrica 50, 1982). Errors that are alike from tick to tick do not count as
independent, as the blocks are longer than their correlation. For n blocks and k parameters, c = n / (n - k/2) lies in
the middle between parameters that all blocks determine together and those that have blocks of their own. The second
part is the penalty's pull if true parameters lie S, the scales of their groups, from their starts: what the data leave
open is then as uncertain as its scale. The third is the way to the optimum that is left where the descent stopped, with
g the gradient there, penalty included. Parameters at a bound have no error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.physical.models import PhysicalModels

BLOCK_S = 0.25
MIN_BLOCKS = 1.0  # for each parameter that the data determine
STEP = 1e-3  # of a parameter's standard error, to differentiate what follows from it


@dataclass(frozen=True)
class ParameterErrors:
    """Parameters `theta` (n,) between `low` and `high`; their mean squared error is root root', `root` (n, m)."""

    theta: F
    low: F
    high: F
    root: F

    def of(self, values: Callable[[F], F]) -> F:
        """Return the standard errors of `values(theta)` (v,), linear in the errors of the parameters (delta method)."""
        at, sizes = values(self.theta), np.sqrt((self.root**2).sum(axis=1))
        spread = np.zeros((len(at), self.root.shape[1]))
        for n in np.flatnonzero(sizes > 0.0):
            step = STEP * sizes[n]
            moved = self.theta.copy()
            moved[n] += step if moved[n] + step < self.high[n] else -min(step, 0.5 * (moved[n] - self.low[n]))
            change = moved[n] - self.theta[n]
            spread += np.outer((values(moved) - at) / change, self.root[n])
        return np.asarray(np.sqrt((spread**2).sum(axis=1)))


def parameter_errors(models: PhysicalModels, theta: F, penalty: float) -> ParameterErrors | None:
    """Return the errors of parameters fitted with a penalty [J %]; None if there are too few blocks of data."""
    training, layout = models.training, models.layout
    weights = training.estimation + training.selection
    blocks = _number_blocks(training.segments, len(weights), round(BLOCK_S / models.scales.interval_s))
    matrix, gradients = models.block_gradients(theta, weights, blocks)
    free = (theta > layout.low) & (theta < layout.high)
    scale = layout.scale[free]
    scaled = matrix[np.ix_(free, free)] * np.outer(scale, scale)
    pull = layout.penalty_weight(penalty) * np.eye(len(scale))
    inverse = np.linalg.inv(scaled + pull)
    used = gradients[(gradients != 0.0).any(axis=1)][:, free] * scale
    determined = float(np.trace(inverse @ scaled))
    if len(used) < MIN_BLOCKS * determined:
        return None
    slope = gradients[:, free].sum(axis=0) * scale + (pull @ ((theta - layout.start)[free] / scale))
    parts = np.column_stack([used.T * np.sqrt(len(used) / (len(used) - 0.5 * determined)), pull, slope])
    root = np.zeros((len(theta), parts.shape[1]))
    root[free] = scale[:, None] * (inverse @ parts)
    return ParameterErrors(theta, layout.low, layout.high, root)


def _number_blocks(segments: I, ticks: int, length: int) -> I:
    """Return the number of each tick's block; blocks do not cross segments."""
    numbers = np.zeros(ticks, np.int64)
    count = 0
    for start, stop in segments:
        numbers[start:stop] = count + np.arange(stop - start) // length
        count = int(numbers[stop - 1]) + 1 if stop > start else count
    return numbers
