"""A sigmoid network NARX (thesis eq. 3.4, with a linear part) on lagged regressors phi.

force = scale * (constant + linear . phi + sum over units of weight * s(slopes . phi + bias)), s(x) = 1 / (1 + e^-x)
"""

from math import exp

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.lagged import LAGGED_COUNT, LAGGED_PHI, N_LAGGED, check_lagged, lagged_force, lagged_inputs
from ces_observer.tick.lagged import apply_layer
from ces_observer.tick.model import P_STRUCTURE, lies_within

# p: force for an output of 1 [N]
SIGMOID_SCALE, P_SIGMOID = range(P_STRUCTURE, P_STRUCTURE + 2)

# n: the units; where these begin: in p the layer of linear part and units, and the units' weights; in s the outputs of
# that layer, in place of which come the sigmoids
SIGMOID_UNITS, SIGMOID_LAYER, SIGMOID_WEIGHTS, SIGMOID_OUTPUTS, N_SIGMOID = range(N_LAGGED, N_LAGGED + 5)

MAX_SIGMOID_EXPONENT = 700.0  # beyond, e^x overflows


def sigmoid_force(p: Floats, n: Ints, s: Floats) -> float:
    """Return the force [N] at the regressors in s, and leave the sigmoids there."""
    outputs = n[SIGMOID_OUTPUTS]
    weight = n[SIGMOID_WEIGHTS]
    units = n[SIGMOID_UNITS]
    apply_layer(p, s, n[SIGMOID_LAYER], 1 + units, n[LAGGED_COUNT], n[LAGGED_PHI], outputs)
    total = s[outputs]
    for i in range(outputs + 1, outputs + 1 + units):
        exponent = -s[i]
        if exponent > MAX_SIGMOID_EXPONENT:
            exponent = MAX_SIGMOID_EXPONENT
        unit = 1.0 / (1.0 + exp(exponent))
        s[i] = unit
        total += p[weight] * unit
        weight += 1
    return p[SIGMOID_SCALE] * total


def sigmoid_tick(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> float:
    """Return the force [N] at this tick's inputs [m, m/s, A], held in its range; infinite if it is not finite."""
    lagged_inputs(p, n, s, k, position, speed, current)
    return lagged_force(p, n, s, k, sigmoid_force(p, n, s))


def check_sigmoid(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether the tick stays within arrays p, n, s and k of these sizes."""
    if counts < N_SIGMOID or numbers < P_SIGMOID or not check_lagged(p, n, numbers, counts, states, flags):
        return False
    units = n[SIGMOID_UNITS]
    fits = 0 <= units < states and lies_within(n[SIGMOID_OUTPUTS], 1 + units, 0, states)
    fits = fits and lies_within(n[SIGMOID_LAYER], (1 + units) * (n[LAGGED_COUNT] + 1), 0, numbers)
    return fits and lies_within(n[SIGMOID_WEIGHTS], units, 0, numbers)
