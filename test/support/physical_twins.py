"""Slow, readable runs of the structures with physics inside: the equations of their docstrings, solved by bisection."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ces_observer.model import Model
from ces_observer.structures.curves import interpolate
from ces_observer.structures.physical import INPUTS, widen

Inputs = Sequence[tuple[float, float, float]]


def bisect_root(function: Callable[[float], float], low: float, high: float) -> float:
    """Return where an increasing function is zero."""
    for _ in range(90):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) < 0.0 else (low, middle)
    return 0.5 * (low + high)


def clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def limited(model: Model, inputs: Inputs) -> list[list[float]]:
    """Return positions, speeds and currents, clamped to the reach."""
    ranges = widen(model.envelope.by_signal, model.body.reach)
    return [
        [clip(value, *ranges[name]) for value in column]
        for name, column in zip(INPUTS, zip(*inputs, strict=True), strict=True)
    ]


def settings(path, currents: Sequence[float], interval: float) -> list[float]:
    """Return the valve's settings."""
    plays = [currents[0]] * 3
    setting, result = path.steady(currents[0]), []
    whole, share = int(path.delay_ticks), path.delay_ticks % 1.0
    for k in range(len(currents)):
        newer, older = (currents[max(k - whole - n, 0)] for n in (0, 1))
        delayed = (1.0 - share) * newer + share * older
        for n, width in enumerate((1.0 / 3.0, 1.0, 5.0 / 3.0)):
            half = width * path.hysteresis_A
            plays[n] = clip(plays[n], delayed - half, delayed + half)
        target = path.steady(sum(plays) / 3.0)
        lag = path.rise_s if target > setting else path.fall_s
        setting += interval / (lag + interval) * (target - setting)
        result.append(setting)
    return result


def drives(side, positions: Sequence[float], speeds: Sequence[float], interval: float) -> list[tuple[float, float]]:
    """Return drive [m/s] and gas, viscous and inertia force [N] of each tick."""
    result, before = [], speeds[0]
    for position, speed in zip(positions, speeds, strict=True):
        change = clip((speed - before) / interval, -side.max_acceleration_m_s2, side.max_acceleration_m_s2)
        drive, before = speed + side.lead_s * change, speed
        gas = interpolate(side.position_m, side.gas_N, position)
        result.append((drive, gas + side.viscous_Ns_m * drive + side.mass_kg * change))
    return result


def prepared(model: Model, inputs: Inputs) -> list[tuple[float, float, float]]:
    """Return drive, side force and setting of each tick."""
    positions, speeds, currents = limited(model, inputs)
    interval = 1.0 / model.sampling.rate_Hz
    sides = drives(model.body.side, positions, speeds, interval)
    return [(*side, s) for side, s in zip(sides, settings(model.body.valve, currents, interval), strict=True)]


def relaxation_forces(model: Model, inputs: Inputs) -> list[float]:
    """Return the forces of a relaxation model [N]."""
    body, interval = model.body, 1.0 / model.sampling.rate_Hz
    away = limited(model, inputs)[0][0] - body.mid_stroke_m
    stretched = [clip(stiffness * away, -limit, limit) for stiffness, limit in body.restoring]
    oil, forces = sum(stretched), []
    for drive, side, setting in prepared(model, inputs):
        row, share = body.map.pick(setting)
        limits = [one.yield_N[row] + share * (one.yield_N[row + 1] - one.yield_N[row]) for one in body.springs]

        def stretch(q, limits=limits, before=stretched):
            pulled = zip(before, body.springs, limits, strict=True)
            return [clip(h + one.stiffness_N_m * interval * q, -limit, limit) for h, one, limit in pulled]

        def force(q, setting=setting, stretch=stretch):
            return body.map.force(q, setting) + sum(stretch(q))

        def excess(q, drive=drive, force=force, oil=oil):
            y = force(q)
            return body.compliance_m_N * (y - oil) + interval * (q + body.leak_m_Ns * y - drive)

        q = bisect_root(excess, -1e6, 1e6)
        oil, stretched = force(q), stretch(q)
        forces.append(oil + side)
    return forces


def chambers_forces(model: Model, inputs: Inputs, size_N: float = 1e6) -> list[float]:
    """Return the forces of a model with chambers [N]; pressures are searched within +-`size_N`."""
    body, interval = model.body, 1.0 / model.sampling.rate_Hz
    c_c, c_r, mount, r = body.compression_m_N, body.rebound_m_N, body.mount_m_N, 1.0 + body.area_ratio
    old, rubbing, forces = (0.0, 0.0), [0.0] * len(body.side.friction), []
    for drive, side, setting in prepared(model, inputs):
        curve = body.map.blend(setting)

        def pressed(p_c, p_r, old=old):
            return mount * (r * (p_c - old[0]) - (p_r - old[1])) / interval

        def compression(p_c, p_r, drive=drive, old=old, pressed=pressed):
            flow = r * drive - body.check(p_c - p_r) + body.refill(-p_c)
            return c_c * (p_c - old[0]) / interval + r * pressed(p_c, p_r) - flow

        def balanced(p_r, compression=compression):
            return bisect_root(lambda p_c: compression(p_c, p_r), -size_N, size_N)

        def rebound(p_r, drive=drive, curve=curve, old=old, balanced=balanced, pressed=pressed):
            p_c = balanced(p_r)
            flow = -drive + body.check(p_c - p_r) - interpolate(curve, body.map.at, p_r)
            return c_r * (p_r - old[1]) / interval - pressed(p_c, p_r) - flow

        p_r = bisect_root(rebound, -size_N, size_N)
        old = balanced(p_r), p_r
        elements = zip(rubbing, body.side.friction, strict=True)
        rubbing = [clip(f + e.stiffness_N_m * interval * drive, -e.yield_N, e.yield_N) for f, e in elements]
        forces.append(r * old[0] - old[1] + side + sum(rubbing) * (1.0 + body.friction_growth_1_N * max(p_r, 0.0)))
    return forces
