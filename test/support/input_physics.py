"""Effects on a damper's inputs as independent physics: slow readable loops on a fine grid, and their recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from made_recordings import recording_of
from numba import njit
from scipy.interpolate import CubicSpline

from ces_data.arrays import F
from ces_gap.baseline.plant import TraceSimulator
from ces_gap.trace import Trace, TraceInputs, make_trace

RATE_HZ, SECONDS, FINER = 1000.0, 5, 8  # physics run FINER times as fast as recordings are logged
Truth = Callable[[F, F, F], F]  # position, speed, current on the fine grid -> force there


@njit(cache=True)
def valve(speed, current):
    """A damper without memory: steep near standstill, softer in compression."""
    side = 0.7 if speed > 0.0 else 1.0
    return side * ((200.0 + 500.0 * current) * np.tanh(speed / 0.08) + (400.0 + 600.0 * current) * speed)


@njit(cache=True)
def valves(speed, current):
    out = np.empty_like(speed)
    for k in range(len(speed)):
        out[k] = valve(speed[k], current[k])
    return out


@njit(cache=True)
def dahl(force, step, current):
    """The next force of a friction that holds (Dahl): 1e6 N/m until it slides."""
    limit = 400.0 + 400.0 * current
    return np.sign(step) * limit + (force - np.sign(step) * limit) * np.exp(-1e6 * abs(step) / limit)


@njit(cache=True)
def brakes(position, current):
    out = np.zeros_like(position)
    for k in range(1, len(position)):
        out[k] = dahl(out[k - 1], position[k] - position[k - 1], current[k])
    return out


@dataclass(frozen=True)
class Damper(TraceSimulator):
    """The simulation."""

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        return np.asarray(valves(inputs.speed, inputs.current))


@dataclass(frozen=True)
class Brake(TraceSimulator):
    """A simulation with memory."""

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        return np.asarray(brakes(inputs.position, inputs.current))


@njit(cache=True)
def spring_in_series(speed, current, forces, strokes, relaxation, step):
    """The force through a spring of tabled stroke over force, by bisection at every step (backward Euler)."""
    out = np.empty_like(speed)
    z = 0.0
    for k in range(len(speed)):
        low, high = forces[0], forces[-1]
        for _ in range(45):
            force = 0.5 * (low + high)
            rate = (np.interp(force, forces, strokes) - z) / (step + relaxation)
            if valve(speed[k] - rate, current[k]) > force:
                low = force
            else:
                high = force
        z += rate * step
        out[k] = force
    return out


@njit(cache=True)
def play(x, half):
    out = np.zeros_like(x)
    y = x[0]
    for k in range(len(x)):
        y = min(max(y, x[k] - half), x[k] + half)
        out[k] = y
    return out


@njit(cache=True)
def gradual_play(x, half, contact):
    """The damper's position: it follows the rod the more, the nearer the joint is to its end in that direction."""
    out = np.zeros_like(x)
    own = x[0]
    for k in range(1, len(x)):
        step = x[k] - x[k - 1]
        room = half - np.sign(step) * (x[k - 1] - own)
        own += step * np.exp(-max(room, 0.0) / contact)
        out[k] = own
    return out


@njit(cache=True)
def loose_brake(x, current, gap):
    """A brake behind a joint with a gap and hard stops of 1e8 N/m: where it stands is where both forces agree."""
    out = np.zeros_like(x)
    own, force = x[0], 0.0
    for k in range(1, len(x)):
        low, high = -1e-3, 1e-3
        for _ in range(40):
            step = 0.5 * (low + high)
            reach = x[k] - own - step
            contact = 1e8 * (max(reach - 0.5 * gap, 0.0) + min(reach + 0.5 * gap, 0.0))
            if dahl(force, step, current[k]) < contact:
                low = step
            else:
                high = step
        force = dahl(force, step, current[k])
        own += step
        out[k] = force
    return out


@njit(cache=True)
def loose(x, current, gap, level, step_s):
    """The same for a damper without memory; the cell reads `level` where the joint passes nothing."""
    out = np.zeros_like(x)
    own = x[0]
    for k in range(1, len(x)):
        low, high = -1e-3, 1e-3
        for _ in range(40):
            step = 0.5 * (low + high)
            reach = x[k] - own - step
            contact = 1e8 * (max(reach - 0.5 * gap, 0.0) + min(reach + 0.5 * gap, 0.0))
            if valve(step / step_s, current[k]) < level + contact:
                low = step
            else:
                high = step
        out[k] = valve(step / step_s, current[k])
        own += step
    return out


@njit(cache=True)
def slow_valve(current, rise, fall, step):
    out = current.copy()
    for k in range(1, len(current)):
        time = rise if current[k] > out[k - 1] else fall
        out[k] = out[k - 1] + (current[k] - out[k - 1]) * step / (time + step)
    return out


@njit(cache=True)
def remanent(current, height, travel):
    h = np.zeros_like(current)
    for k in range(1, len(current)):
        step = current[k] - current[k - 1]
        h[k] = h[k - 1] - (height * step + h[k - 1] * abs(step)) / travel
    return current + h


FINE_S = 1.0 / (RATE_HZ * FINER)
TABLE = np.linspace(-6000.0, 6000.0, 60001)


def series(strokes: F, relaxation: float = 0.0) -> Truth:
    return lambda x, v, i: spring_in_series(v, i, TABLE, strokes, relaxation, FINE_S)


def acting(change: Callable[[F], F]) -> Truth:
    return lambda x, v, i: valves(v, change(i))


def late(values: F, seconds: float) -> F:
    ticks = round(seconds / FINE_S)
    return np.concatenate((np.full(ticks, values[0]), values[: len(values) - ticks]))


PLANTED: dict[str, tuple[tuple[float, ...], Truth]] = {
    "position_delay-shift": ((0.004,), lambda x, v, i: valves(late(v, 0.004), i)),
    "valve_lag-first_order": ((0.03,), acting(lambda i: slow_valve(i, 0.03, 0.03, FINE_S))),
    "valve_lag-rise_fall": ((0.02, 0.05), acting(lambda i: slow_valve(i, 0.02, 0.05, FINE_S))),
    "valve_lag-delay_and_lag": ((0.02, 0.01), acting(lambda i: slow_valve(late(i, 0.02), 0.01, 0.01, FINE_S))),
    "current_hysteresis-plays": (
        (0.08,),
        acting(lambda i: np.mean([play(i, 0.16 * (j + 1) / 8) for j in range(8)], axis=0)),
    ),
    "current_hysteresis-remanence": ((0.08, 0.2), acting(lambda i: remanent(i, 0.08, 0.2))),
    "current_scale-gain": ((1.1,), acting(lambda i: 1.1 * i)),
    "current_scale-gain_offset": ((0.9, 0.05), acting(lambda i: 0.9 * i + 0.05)),
    "backlash-held": ((1e-3,), lambda x, v, i: valves(np.gradient(play(x, 5e-4)) / FINE_S, i)),
    "backlash-soft": (
        (1e-3, 0.2),
        lambda x, v, i: valves(np.gradient(gradual_play(x, 5e-4, 2e-4)) / FINE_S, i),
    ),
    "backlash-parted": ((1e-3, -30.0), lambda x, v, i: loose(x, i, 1e-3, -30.0, FINE_S)),
}


def road(seconds: float, rms_m: float = 0.01, top_Hz: float = 8.0, seed: int = 1) -> F:
    """A broadband stroke [m] at RATE_HZ."""
    count = round(seconds * RATE_HZ)
    noise = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(count, 1.0 / RATE_HZ)
    shape = np.where((frequency > 0.4) & (frequency < top_Hz), 1.0 / np.maximum(frequency, 0.4) ** 1.5, 0.0)
    x = np.fft.irfft(shape * (noise.normal(size=len(shape)) + 1j * noise.normal(size=len(shape))), count)
    return x * rms_m / x.std()


def changing(seconds: float) -> F:
    """A current [A] of ramped steps at RATE_HZ, 0.2 to 1.4 A."""
    knots = np.random.default_rng(2).uniform(0.2, 1.4, round(seconds / 0.4) + 2)
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    hold = np.minimum((time % 0.4) / 0.03, 1.0)
    step = (time // 0.4).astype(int)
    return knots[step] + hold * (knots[step + 1] - knots[step])


def recorded(truth: Truth, current: F | None = None) -> Trace:
    """The trace of `truth` driven by road and current, beside the plain damper."""
    x, i = road(SECONDS), changing(SECONDS) if current is None else current
    time = np.arange(len(x)) / RATE_HZ
    fine = np.arange((len(x) - 1) * FINER + 1) * FINE_S
    spline = CubicSpline(time, x)
    force = truth(spline(fine), spline(fine, 1), np.interp(fine, time, i))[::FINER]
    trace = make_trace(recording_of(time, position=x, current=i, force=force), force)
    return replace(trace, simulated=Damper().force(trace, trace.inputs))


@cache
def plain() -> Trace:
    return recorded(lambda x, v, i: valves(v, i))


@cache
def planted(form: str) -> Trace:
    return recorded(PLANTED[form][1])
