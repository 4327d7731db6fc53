"""A recurrent network that forgets for any parameters: linear filters with layers of tanh between them.

Motion (speed v, v / sqrt(|v| + e), sqrt(|v|), position) goes through two stages with a tanh between them, the current
through one of its own; no force is fed back:

    motion -> first -> tanh -> second -> f0, f1, f2        current -> current stage -> q1, q2
    force = scale * sum over members of (f0 + q1 f1 + q2 f2)

A stage has linear filters (a diagonal state-space model) and a layer of tanh, with u the inputs:

    h(k) = pole h(k-1) + drive u(k), complex; at first, h = drive u / (1 - pole), as if u had always been the same
    z = (Re h, Im h, u),  outputs = out . (tanh(hidden . z + hidden_bias), z) + out_bias
"""

from math import sqrt, tanh

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.lagged import apply_layer
from ces_observer.tick.model import (
    CLAMPED, CURRENT_HIGH, CURRENT_LOW, HELD, LARGEST, N_STRUCTURE, POSITION_HIGH, POSITION_LOW, P_STRUCTURE, SMALLEST,
    SPEED_HIGH, SPEED_LOW, STARTED, S_STRUCTURE, are_between, are_indices, clamp, hold_force, is_clamped, lies_within,
)  # fmt: skip

# p: force for an output of 1 [N], and e [m/s]
RECURRENT_SCALE, RECURRENT_SMOOTHING, P_RECURRENT = range(P_STRUCTURE, P_STRUCTURE + 3)

# n: members and the stages of each, 2 or 3; inputs; where these begin: in n the stages and the signal of each input; in
# p pairs (mean, spread) of the inputs; in s the inputs and what drives the filters of a stage
(
    RECURRENT_MEMBERS, RECURRENT_STAGES, RECURRENT_INPUTS, RECURRENT_TABLE, RECURRENT_SIGNALS, RECURRENT_SCALES,
    RECURRENT_SCALED, RECURRENT_DRIVEN, N_RECURRENT,
) = range(N_STRUCTURE, N_STRUCTURE + 9)  # fmt: skip

# n, from a stage on: its sizes; where its inputs and outputs are in s; where these begin: in p its poles (real and
# imaginary parts of pole and 1 / (1 - pole)) and layers, in s tanh and z
(
    STAGE_INPUTS, STAGE_FILTERS, STAGE_TANHS, STAGE_OUTPUTS, STAGE_SOURCE, STAGE_RESULTS, STAGE_POLES, STAGE_DRIVE,
    STAGE_HIDDEN, STAGE_OUT, STAGE_JOINED, N_STAGE,
) = range(12)  # fmt: skip

# s: the signals
SIGNAL_SPEED, SIGNAL_ROOT, SIGNAL_SIZE, SIGNAL_POSITION, SIGNAL_CURRENT, S_RECURRENT = range(
    S_STRUCTURE, S_STRUCTURE + 6
)


def recurrent_reset(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Forget the past."""
    k[CLAMPED] = 0
    k[HELD] = 0
    k[STARTED] = 0


def scale_recurrent_inputs(
    p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float
) -> None:
    """Fill in the scaled inputs of the network at inputs [m, m/s, A], which are clamped to their ranges."""
    k[CLAMPED] = 1 if is_clamped(p, position, speed, current) else 0
    v = clamp(speed, p[SPEED_LOW], p[SPEED_HIGH])
    s[SIGNAL_SPEED] = v
    s[SIGNAL_ROOT] = v / sqrt(abs(v) + p[RECURRENT_SMOOTHING])
    s[SIGNAL_SIZE] = sqrt(abs(v))
    s[SIGNAL_POSITION] = clamp(position, p[POSITION_LOW], p[POSITION_HIGH])
    s[SIGNAL_CURRENT] = clamp(current, p[CURRENT_LOW], p[CURRENT_HIGH])
    scale = n[RECURRENT_SCALES]
    signals = n[RECURRENT_SIGNALS]
    scaled = n[RECURRENT_SCALED]
    for i in range(n[RECURRENT_INPUTS]):
        s[scaled + i] = (s[n[signals + i]] - p[scale]) / p[scale + 1]
        scale += 2


def run_stage(p: Floats, n: Ints, s: Floats, k: Ints, stage: int) -> None:
    """Move a stage, which begins at n[stage], on by a tick, and fill in its outputs."""
    inputs = n[stage + STAGE_INPUTS]
    filters = n[stage + STAGE_FILTERS]
    tanhs = n[stage + STAGE_TANHS]
    source = n[stage + STAGE_SOURCE]
    joined = n[stage + STAGE_JOINED]
    real = joined + tanhs
    imag = real + filters
    driven = n[RECURRENT_DRIVEN]
    apply_layer(p, s, n[stage + STAGE_DRIVE], 2 * filters, inputs, source, driven)
    pole = n[stage + STAGE_POLES]
    for i in range(filters):
        a = s[driven + i]
        b = s[driven + filters + i]
        if k[STARTED] != 0:
            x = s[real + i]
            y = s[imag + i]
            s[real + i] = p[pole] * x - p[pole + 1] * y + a
            s[imag + i] = p[pole] * y + p[pole + 1] * x + b
        else:
            s[real + i] = p[pole + 2] * a - p[pole + 3] * b
            s[imag + i] = p[pole + 2] * b + p[pole + 3] * a
        pole += 4
    for i in range(inputs):
        s[imag + filters + i] = s[source + i]
    width = 2 * filters + inputs
    apply_layer(p, s, n[stage + STAGE_HIDDEN], tanhs, width, real, joined)
    for i in range(joined, real):
        s[i] = tanh(s[i])
    apply_layer(p, s, n[stage + STAGE_OUT], n[stage + STAGE_OUTPUTS], tanhs + width, joined, n[stage + STAGE_RESULTS])


def add_member(p: Floats, n: Ints, s: Floats, k: Ints, first: int, total: float) -> float:
    """Return `total` and the scaled force of a member, whose first stage begins at n[first]."""
    second = first + N_STAGE
    run_stage(p, n, s, k, first)
    between = n[second + STAGE_SOURCE]
    for i in range(between, between + n[second + STAGE_INPUTS]):
        s[i] = tanh(s[i])
    run_stage(p, n, s, k, second)
    force = n[second + STAGE_RESULTS]
    modulated = 0.0
    if n[RECURRENT_STAGES] == 3:
        third = second + N_STAGE
        run_stage(p, n, s, k, third)
        factor = n[third + STAGE_RESULTS]
        for i in range(n[third + STAGE_OUTPUTS]):
            modulated += s[factor + i] * s[force + 1 + i]
    return total + s[force] + modulated


def recurrent_tick(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> float:
    """Return the force [N] at this tick's inputs [m, m/s, A], held in its range; infinite if it is not finite."""
    scale_recurrent_inputs(p, n, s, k, position, speed, current)
    total = 0.0
    first = n[RECURRENT_TABLE]
    for member in range(n[RECURRENT_MEMBERS]):
        total = add_member(p, n, s, k, first + member * n[RECURRENT_STAGES] * N_STAGE, total)
    k[STARTED] = 1
    return hold_force(p, k, p[RECURRENT_SCALE] * total)


def check_stage(n: Ints, stage: int, numbers: int, states: int) -> bool:
    """Return whether a stage, which begins at n[stage], stays within arrays p and s of these sizes."""
    inputs = n[stage + STAGE_INPUTS]
    filters = n[stage + STAGE_FILTERS]
    tanhs = n[stage + STAGE_TANHS]
    outputs = n[stage + STAGE_OUTPUTS]
    if not (1 <= inputs <= states and 1 <= filters <= states and 0 <= tanhs <= states and 1 <= outputs <= states):
        return False
    width = 2 * filters + inputs
    fits = lies_within(n[stage + STAGE_JOINED], tanhs + width, 0, states)
    fits = fits and lies_within(n[stage + STAGE_SOURCE], inputs, 0, states)
    fits = fits and lies_within(n[stage + STAGE_RESULTS], outputs, 0, states)
    fits = fits and lies_within(n[RECURRENT_DRIVEN], 2 * filters, 0, states)
    fits = fits and lies_within(n[stage + STAGE_POLES], 4 * filters, 0, numbers)
    fits = fits and lies_within(n[stage + STAGE_DRIVE], 2 * filters * (inputs + 1), 0, numbers)
    fits = fits and lies_within(n[stage + STAGE_HIDDEN], tanhs * (width + 1), 0, numbers)
    return fits and lies_within(n[stage + STAGE_OUT], outputs * (tanhs + width + 1), 0, numbers)


def check_recurrent(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether the tick stays within arrays p, n, s and k of these sizes."""
    if counts < N_RECURRENT or numbers < P_RECURRENT or states < S_RECURRENT:
        return False
    inputs = n[RECURRENT_INPUTS]
    stages = n[RECURRENT_STAGES]
    members = n[RECURRENT_MEMBERS]
    table = n[RECURRENT_TABLE]
    fits = p[RECURRENT_SMOOTHING] > 0.0 and 1 <= members <= counts and 2 <= stages <= 3
    fits = fits and lies_within(table, members * stages * N_STAGE, 0, counts)
    fits = fits and lies_within(n[RECURRENT_SCALES], 2 * inputs, 0, numbers)
    fits = fits and lies_within(n[RECURRENT_SIGNALS], inputs, 0, counts)
    fits = fits and lies_within(n[RECURRENT_SCALED], inputs, 0, states)
    fits = fits and are_indices(n, n[RECURRENT_SIGNALS], inputs, 1, SIGNAL_SPEED, SIGNAL_CURRENT + 1)
    if not (fits and are_between(p, n[RECURRENT_SCALES] + 1, inputs, 2, SMALLEST, LARGEST)):
        return False
    for i in range(members * stages):
        stage = table + i * N_STAGE
        if not check_stage(n, stage, numbers, states):
            return False
        # the current's outputs multiply those of the stage before it, but for its first one
        if i % stages == 2 and n[stage + STAGE_OUTPUTS] >= n[stage - N_STAGE + STAGE_OUTPUTS]:
            return False
    return True
