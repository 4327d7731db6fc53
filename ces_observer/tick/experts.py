"""Gated experts: a blend of simple recursions, whose shares depend on motion and current alone, never on the force.

    force = scale sum_i share_i (b_i + c_i . u + a_i Y + s_i tanh((d_i Y + f_i . u + h_i) / s_i))
    share_i = e^(g_i . u + r_i) / sum_j e^(g_j . u + r_j)

with u the lagged inputs and Y the last force. The gain of Y in expert i lies between a_i and a_i + d_i.
"""

from math import exp, inf, tanh

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.lagged import LAGGED_COUNT, LAGGED_PHI, N_LAGGED, check_lagged, lagged_force, lagged_inputs
from ces_observer.tick.lagged import apply_layer
from ces_observer.tick.model import LARGEST, P_STRUCTURE, SMALLEST, are_between, lies_within

# p: force for an output of 1 [N]
EXPERTS_SCALE, P_EXPERTS = range(P_STRUCTURE, P_STRUCTURE + 2)

# n: the experts; where these begin: in p the layer on u (the rows r, g of all experts, then b, c, then h, f), and
# a, d, s of each expert; in s the outputs of that layer, in place of which come shares, forces and tanh
EXPERTS_COUNT, EXPERTS_LAYER, EXPERTS_GAINS, EXPERTS_OUTPUTS, N_EXPERTS = range(N_LAGGED, N_LAGGED + 5)


def experts_force(p: Floats, n: Ints, s: Floats) -> float:
    """Return the force [N] at the regressors in s, the last of which is Y, and leave shares, forces and tanh there."""
    count = n[EXPERTS_COUNT]
    share = n[EXPERTS_OUTPUTS]
    width = n[LAGGED_COUNT] - 1
    past = s[n[LAGGED_PHI] + width]
    apply_layer(p, s, n[EXPERTS_LAYER], 3 * count, width, n[LAGGED_PHI], share)
    most = s[share]
    for i in range(share + 1, share + count):
        most = s[i] if s[i] > most else most
    gain = n[EXPERTS_GAINS]
    shares = 0.0
    total = 0.0
    for i in range(share, share + count):
        bend = tanh((p[gain + 1] * past + s[i + 2 * count]) / p[gain + 2])
        force = s[i + count] + p[gain] * past + p[gain + 2] * bend
        part = exp(s[i] - most)
        s[i] = part
        s[i + count] = force
        s[i + 2 * count] = bend
        shares += part
        total += part * force
        gain += 3
    for i in range(share, share + count):
        s[i] /= shares
    return p[EXPERTS_SCALE] * (total / shares) if shares > 0.0 else inf


def experts_tick(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> float:
    """Return the force [N] at this tick's inputs [m, m/s, A], held in its range; infinite if it is not finite."""
    lagged_inputs(p, n, s, k, position, speed, current)
    return lagged_force(p, n, s, k, experts_force(p, n, s))


def check_experts(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether the tick stays within arrays p, n, s and k of these sizes."""
    if counts < N_EXPERTS or numbers < P_EXPERTS or not check_lagged(p, n, numbers, counts, states, flags):
        return False
    count = n[EXPERTS_COUNT]
    gains = n[EXPERTS_GAINS]
    fits = 1 <= count <= states and lies_within(n[EXPERTS_OUTPUTS], 3 * count, 0, states)
    fits = fits and lies_within(n[EXPERTS_LAYER], 3 * count * n[LAGGED_COUNT], 0, numbers)
    return fits and lies_within(gains, 3 * count, 0, numbers) and are_between(p, gains + 2, count, 3, SMALLEST, LARGEST)
