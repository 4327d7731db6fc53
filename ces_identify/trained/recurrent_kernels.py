"""Kernels of recurrent networks in training: the run of many windows, and the way back for derivatives.

Arrays have the shape (signals, ticks, lanes); lanes are windows that run side by side, from states of zero. Only the
filters are a loop over ticks; all else is products of matrices over ticks and lanes, several times as fast as
`ces_observer.tick.recurrent`, which takes tick by tick.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F


@njit(cache=True, nogil=True, fastmath={"contract"})
def scan(real: F, imag: F, drive_real: F, drive_imag: F, state: F) -> None:
    """Run h(k) = pole h(k-1) + drive(k) in place: the drives (poles, ticks, lanes) become the states.

    `state` (2, poles, lanes) is h before the first tick, and after the last one at the end.
    """
    poles, ticks, lanes = drive_real.shape
    for j in range(poles):
        a, b = real[j], imag[j]
        x, y = state[0, j], state[1, j]
        for k in range(ticks):
            for i in range(lanes):
                p, q = x[i], y[i]
                x[i] = a * p - b * q + drive_real[j, k, i]
                y[i] = b * p + a * q + drive_imag[j, k, i]
                drive_real[j, k, i] = x[i]
                drive_imag[j, k, i] = y[i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def scan_back(real: F, imag: F, state_real: F, state_imag: F, back_real: F, back_imag: F) -> tuple[F, F]:
    """Turn derivatives by the states, in place, into derivatives by the drives; return those by the poles (poles,)."""
    poles, ticks, lanes = state_real.shape
    by_real, by_imag = np.zeros(poles), np.zeros(poles)
    x, y, sums = np.empty(lanes), np.empty(lanes), np.empty((2, lanes))
    for j in range(poles):
        a, b = real[j], imag[j]
        x[:] = 0.0
        y[:] = 0.0
        sums[:] = 0.0
        for k in range(ticks - 1, -1, -1):
            for i in range(lanes):
                p, q = x[i], y[i]
                x[i] = a * p + b * q + back_real[j, k, i]
                y[i] = a * q - b * p + back_imag[j, k, i]
                back_real[j, k, i] = x[i]
                back_imag[j, k, i] = y[i]
            if k > 0:
                for i in range(lanes):
                    p, q = state_real[j, k - 1, i], state_imag[j, k - 1, i]
                    sums[0, i] += x[i] * p + y[i] * q
                    sums[1, i] += y[i] * p - x[i] * q
        by_real[j], by_imag[j] = sums[0].sum(), sums[1].sum()
    return by_real, by_imag


class StageArrays(NamedTuple):
    """A stage as `ces_observer.structures.recurrent.Stage` describes it, or derivatives by its parts.

    Shapes: `poles` (2, poles) real and imaginary parts, `drive` (2 poles, inputs), `hidden` (tanh, states), `out`
    (outputs, tanh + states) with states = 2 poles + inputs, biases (tanh,) and (outputs,).
    """

    poles: F
    drive: F
    hidden: F
    hidden_bias: F
    out: F
    out_bias: F


class MemberArrays(NamedTuple):
    """The stages of a network; `current` is None without a changing current."""

    first: StageArrays
    second: StageArrays
    current: StageArrays | None


class Tape(NamedTuple):
    """What the way back needs: inputs (n, ticks, lanes) of a stage, and `joined` (tanh + states, ticks, lanes)."""

    inputs: F
    joined: F


def run_stage(stage: StageArrays, inputs: F, state: F) -> tuple[F, Tape]:
    """Return the outputs (outputs, ticks, lanes); `state` (2, poles, lanes) moves on to the last tick."""
    count, tanhs = stage.poles.shape[1], len(stage.hidden_bias)
    joined = np.empty((stage.out.shape[1], *inputs.shape[1:]))
    states = joined[tanhs:]
    states[2 * count :] = inputs
    np.matmul(stage.drive, _flat(inputs), out=_flat(states)[: 2 * count])
    scan(*stage.poles, states[:count], states[count : 2 * count], state)
    hidden = _flat(joined)[:tanhs]
    np.matmul(stage.hidden, _flat(states), out=hidden)
    hidden += stage.hidden_bias[:, None]
    np.tanh(hidden, out=hidden)
    outputs = stage.out @ _flat(joined) + stage.out_bias[:, None]
    return outputs.reshape(-1, *inputs.shape[1:]), Tape(inputs, joined)


def run_stage_back(stage: StageArrays, trace: Tape, back: F) -> tuple[F, StageArrays]:
    """Return the derivatives by inputs and parts, from those by the outputs (outputs, ticks, lanes)."""
    count, tanhs = stage.poles.shape[1], len(stage.hidden_bias)
    joined, inputs, back = _flat(trace.joined), _flat(trace.inputs), _flat(back)
    by_joined = stage.out.T @ back
    by_hidden, by_states = by_joined[:tanhs], by_joined[tanhs:]
    by_hidden *= 1.0 - joined[:tanhs] ** 2
    by_states += stage.hidden.T @ by_hidden
    planes = by_states.reshape(-1, *trace.inputs.shape[1:])
    states = trace.joined[tanhs:]
    by_poles = scan_back(
        *stage.poles, states[:count], states[count : 2 * count], planes[:count], planes[count : 2 * count]
    )
    driven = by_states[: 2 * count]
    by_inputs = (by_states[2 * count :] + stage.drive.T @ driven).reshape(trace.inputs.shape)
    return by_inputs, StageArrays(
        np.array(by_poles),
        driven @ inputs.T,
        by_hidden @ joined[tanhs:].T,
        by_hidden.sum(axis=1),
        back @ joined.T,
        back.sum(axis=1),
    )


def _flat(planes: F) -> F:
    return planes.reshape(len(planes), -1)


def new_states(member: MemberArrays, lanes: int) -> list[F]:
    """Return states of zero (2, poles, lanes) for each stage."""
    return [np.zeros((*stage.poles.shape, lanes)) for stage in member if stage is not None]


def run_member(member: MemberArrays, motion: F, current: F, states: list[F]) -> tuple[F, list[Tape]]:
    """Return the scaled force (ticks, lanes) for inputs (n, ticks, lanes), and the traces."""
    between, first = run_stage(member.first, motion, states[0])
    forces, second = run_stage(member.second, np.tanh(between, out=between), states[1])
    if member.current is None:
        return forces[0], [first, second]
    factors, third = run_stage(member.current, current, states[2])
    force = forces[0] + (factors * forces[1:]).sum(axis=0)
    return force, [first, second, third, Tape(factors, forces)]


def run_member_back(member: MemberArrays, traces: list[Tape], back: F) -> MemberArrays:
    """Return the derivatives by all parts, from those by the force (ticks, lanes)."""
    first, second, *rest = traces
    by_forces, by_current = back[None], None
    if member.current is not None:
        third, (factors, forces) = rest
        by_forces = np.concatenate([back[None], back * factors])
        _, by_current = run_stage_back(member.current, third, back * forces[1:])
    by_between, by_second = run_stage_back(member.second, second, by_forces)
    by_between *= 1.0 - second.inputs**2
    _, by_first = run_stage_back(member.first, first, by_between)
    return MemberArrays(by_first, by_second, by_current)
