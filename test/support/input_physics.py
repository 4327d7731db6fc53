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
def pumped(speed, current, pumping, other, step):
    """The force through a spring of 1/`pumping` while pushed and moving in, 1/`other` otherwise."""
    out = np.zeros_like(speed)
    for k in range(1, len(speed)):
        compliance = 1.0 / pumping if out[k - 1] > 0.0 and speed[k] > 0.0 else 1.0 / other
        low, high = -6000.0, 6000.0
        for _ in range(45):
            out[k] = 0.5 * (low + high)
            if valve(speed[k] - compliance * (out[k] - out[k - 1]) / step, current[k]) > out[k]:
                low = out[k]
            else:
                high = out[k]
    return out


@njit(cache=True)
def leaking(speed, current, forces, leaks):
    out = np.empty_like(speed)
    for k in range(len(speed)):
        low, high = forces[0], forces[-1]
        for _ in range(45):
            out[k] = 0.5 * (low + high)
            if valve(speed[k] - np.interp(out[k], forces, leaks), current[k]) > out[k]:
                low = out[k]
            else:
                high = out[k]
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
def starving(speed, force, side, limit, share, bubbles, step):
    out = force.copy()
    z = 0.0
    for k in range(len(speed)):
        onward = side * speed[k]
        z = max(z + step * (share * (onward - limit[k]) if onward > 0.0 else onward - share * limit[k]), 0.0)
        if side * force[k] < 0.0:
            out[k] = force[k] * np.exp(-z / bubbles)
    return out


def floored(speed, current, side, limit, bubbles, step):
    """The force of `valves` held at the limit while there is a void, which takes what they do not pass."""
    low, high = np.zeros_like(speed), np.full_like(speed, 5.0)
    for _ in range(50):
        middle = 0.5 * (low + high)
        less = side * valves(side * middle, current) < limit
        low, high = np.where(less, middle, low), np.where(less, high, middle)
    return held_by_void(speed, valves(speed, current), low, side, limit, bubbles, step)


@njit(cache=True)
def held_by_void(speed, force, passed, side, limit, bubbles, step):
    out = force.copy()
    z = 0.0
    for k in range(len(speed)):
        pull = side * force[k]
        z = max(z + step * (side * speed[k] - passed[k]), 0.0) if z > 0.0 or pull > limit else 0.0
        left = np.exp(-((z / bubbles) ** 2))
        out[k] = side * (left * min(pull, limit) + (1.0 - left) * limit)
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


def leak(leaks: F) -> Truth:
    return lambda x, v, i: leaking(v, i, TABLE, leaks)


def acting(change: Callable[[F], F]) -> Truth:
    return lambda x, v, i: valves(v, change(i))


def late(values: F, seconds: float) -> F:
    ticks = round(seconds / FINE_S)
    return np.concatenate((np.full(ticks, values[0]), values[: len(values) - ticks]))


def two_sides(low: float, high: float) -> F:
    return np.where(TABLE > 0.0, TABLE * high, TABLE * low)


PLANTED: dict[str, tuple[tuple[float, ...], Truth]] = {
    "mount_compliance-linear": ((1.5e6, 0.002), series(TABLE / 1.5e6, 0.002)),
    "mount_compliance-progressive": ((5e5, 400.0), series(400.0 / 5e5 * np.arcsinh(TABLE / 400.0))),
    "compressibility-sides": ((3e6, 1e6), series(two_sides(1e-6, 1 / 3e6))),
    "compressibility-aerated": (
        (1e-3, 3e-4, 200.0),
        series(np.where(TABLE > 0, 1e-3, 3e-4) * TABLE / (np.abs(TABLE) + 200.0)),
    ),
    "compressibility-pumped": ((1e6, 5e6), lambda x, v, i: pumped(v, i, 1e6, 5e6, FINE_S)),
    "leakage-rebound": ((3e-5,), leak(np.minimum(TABLE, 0.0) * 3e-5)),
    "leakage-both": ((3e-5,), leak(TABLE * 3e-5)),
    "leakage-orifice": (
        (1e-3, 5e-4),
        leak(np.where(TABLE < 0.0, 1e-3, 5e-4) * np.sign(TABLE) * np.sqrt(np.abs(TABLE))),
    ),
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
    "backlash-parted": ((1e-3, -30.0), lambda x, v, i: loose(x, i, 1e-3, -30.0, FINE_S)),
    "cavitation-rebound_intake": (
        (0.8, 0.04, 5e-4),
        lambda x, v, i: starving(v, valves(v, i), -1.0, 0.04 + 0.0 * v, 0.8, 5e-4, FINE_S),
    ),
    "cavitation-rebound_reservoir": (
        (1.0, 0.08, 3e-3, 0.06),
        lambda x, v, i: starving(v, valves(v, i), -1.0, 0.08 * np.sqrt(1.0 + x / 0.06), 1.0, 3e-3, FINE_S),
    ),
    "cavitation-compression_intake": (
        (0.8, 0.04, 5e-4),
        lambda x, v, i: starving(v, valves(v, i), 1.0, 0.04 + 0.0 * v, 0.8, 5e-4, FINE_S),
    ),
    "cavitation-rebound_floor": ((1.0, 400.0, 5e-4, 1.0), lambda x, v, i: floored(v, i, -1.0, 400.0, 5e-4, FINE_S)),
    "cavitation-compression_floor": ((1.0, 250.0, 5e-4, 1.0), lambda x, v, i: floored(v, i, 1.0, 250.0, 5e-4, FINE_S)),
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
