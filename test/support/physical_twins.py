"""Slow, readable runs of a hydraulic network: the equations of its docstring, solved one inside the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from math import exp, sqrt

from scipy.optimize import brentq

from ces_observer.model import Model
from ces_observer.structures.curves import Bypass, FlowMap, interpolate
from ces_observer.structures.hydraulic import EDGES, SPREAD, Hydraulic, widen
from ces_observer.structures.structure import INPUTS
from ces_observer.tick.pressures import STILL_N, WARMEST, WARMING_S

Inputs = Sequence[tuple[float, float, float]]


def find_root(function: Callable[[float], float]) -> float:
    """Return where an increasing function is zero."""
    size = 1.0
    while function(-size) > 0.0 or function(size) < 0.0:
        size *= 30.0
    return brentq(function, -size, size, xtol=1e-13, rtol=1e-15, maxiter=500)


def clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def limited(model: Model, inputs: Inputs) -> list[list[float]]:
    """Return positions, speeds and currents, clamped to the reach."""
    ranges = widen(model.envelope.by_signal, model.body.reach)
    return [
        [clip(value, *ranges[name]) for value in column]
        for name, column in zip(INPUTS, zip(*inputs, strict=True), strict=True)
    ]


def settings(path, currents: Sequence[float], interval: float, keep: float) -> list[float]:
    """Return the valve's settings."""
    plays = [currents[0]] * 3
    setting, result = path.steady(currents[0]), []
    whole, share = int(path.delay_ticks), path.delay_ticks % 1.0
    for k in range(len(currents)):
        newer, older = (currents[max(k - whole - n, 0)] for n in (0, 1))
        delayed = (1.0 - share) * newer + share * older
        for n, width in enumerate((1.0 / 3.0, 1.0, 5.0 / 3.0)):
            half = width * path.hysteresis_A
            plays[n] = clip(delayed + keep * (plays[n] - delayed), delayed - half, delayed + half)
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


def blend(flow: FlowMap, setting: float) -> list[float]:
    """Return the drops [N] of an edge at a setting from 0 to 1."""
    place = setting * (len(flow.rows) - 1)
    row = max(min(int(place), len(flow.rows) - 2), 0)
    following = flow.rows[min(row + 1, len(flow.rows) - 1)]
    return [a + (place - row) * (b - a) for a, b in zip(flow.rows[row], following, strict=True)]


def bypass_opening(bypass: Bypass, position: float) -> float:
    """Return the opening of a bypass at a position [m]."""
    inside = clip(position, bypass.position_m[0], bypass.position_m[-1])
    return exp(interpolate(bypass.position_m, bypass.logarithms, inside))


def phi(body: Hydraulic, p: float) -> float:
    """Return the volume that oil with air yields at a pressure [N], straight between nodes."""
    at = [body.reservoir_N * (time - 1.0) for time in SPREAD]
    freed = [1.0 - 1.0 / time for time in SPREAD]
    if p < at[0]:
        share = freed[0] + (p / body.reservoir_N + 1.0 - SPREAD[0]) / SPREAD[0] ** 2
    else:
        share = freed[-1] if p > at[-1] else interpolate(at, freed, p)
    return p + body.reservoir_N * body.air * share


def volumes(body: Hydraulic, position: float, p_c: float, p_r: float) -> tuple[float, float]:
    """Return the volumes stored [m] at a position [m] and pressures [N]."""
    return (
        body.compression_m_N * exp(body.compression_growth_1_m * position) * phi(body, p_c),
        body.rebound_m_N * exp(body.rebound_growth_1_m * position) * phi(body, p_r),
    )


def pressures(
    model: Model, positions: Sequence[float], driven: Sequence[float], valve: Sequence[float]
) -> list[tuple[float, float, float]]:
    """Return both pressures and friction [N] of each tick from positions [m], drives [m/s] and settings."""
    body, interval, ratio = model.body, 1.0 / model.sampling.rate_Hz, 1.0 + model.body.area_ratio
    stored, opened, result = (0.0, 0.0), [0.0, 0.0, 0.0], []
    heat, pull, rubbing, give = 0.0, 0.0, [0.0] * len(body.side.friction), body.mount_m_N + interval * body.creep_m_Ns
    keep, kept = exp(-interval / body.relax_s), exp(-interval / body.leak_s)
    shares = [interval / (lag + interval) for lag in (body.piston_s, body.base_s, body.external_s)]
    for x, drive, setting in zip(positions, driven, valve, strict=True):
        curves = [blend(getattr(body, edge), setting) for edge in EDGES]
        limits = [one.yield_N + setting * one.moved_N for one in body.side.friction]
        springs = [
            (clip(keep * z, -y, y), one, y) for z, one, y in zip(rubbing, body.side.friction, limits, strict=True)
        ]
        ends = {0.0, *((end - z) / one.stiffness_N_m for z, one, y in springs for end in (-y, y))}
        ways = sorted({*ends, min(ends) - 1.0, max(ends) + 1.0})
        bypass, warm = (
            bypass_opening(body.bypass, x - body.mount_m_N * pull) if body.bypass else 0.0,
            exp(clip(body.fade_1_W * heat, -WARMEST, WARMEST)),
        )

        def steady(n, drop, curves=curves):
            return interpolate(curves[n], getattr(body, EDGES[n]).at, drop)

        def flow(n, drop, opened=tuple(opened), bypass=bypass, warm=warm, steady=steady):
            passed = shares[n] * steady(n, drop) + (1.0 - shares[n]) * opened[n] * drop / sqrt(
                abs(drop) + body.laminar_N
            )
            return warm * (
                passed
                + (
                    0.0
                    if n
                    else 2.0
                    * bypass
                    * drop
                    / (sqrt(body.bypass_laminar_N + 4.0 * abs(drop)) + sqrt(body.bypass_laminar_N))
                )
            )

        def rub(way, springs=springs):
            return [clip(z + one.stiffness_N_m * way, -y, y) for z, one, y in springs]

        def behind(p_c, p_r, drive=drive, pull=pull, rub=rub, ways=ways):
            """Return the way w [m] behind the mount, where w + give sum_j z_j(w) is straight between `ways`."""
            values = [way + give * sum(rub(way)) for way in ways]
            return interpolate(values, ways, interval * drive + body.mount_m_N * pull - give * (ratio * p_c - p_r))

        def compression(p_r, p_c, x=x, stored=stored, flow=flow, behind=behind):
            gained = volumes(body, x, p_c, p_r)[0] - kept * stored[0]
            return gained - ratio * behind(p_c, p_r) + interval * (flow(0, p_c - p_r) + flow(1, p_c))

        def balanced(p_r, compression=compression):
            return find_root(partial(compression, p_r))

        def rebound(p_r, x=x, stored=stored, flow=flow, balanced=balanced, behind=behind):
            p_c = balanced(p_r)
            gained = volumes(body, x, p_c, p_r)[1] - kept * stored[1]
            return gained + behind(p_c, p_r) - interval * (flow(0, p_c - p_r) - flow(2, p_r))

        p_r = find_root(rebound)
        p_c, p_r = (clip(p, -body.most_N, body.most_N) for p in (balanced(p_r), p_r))
        stored, rubbing = volumes(body, x, p_c, p_r), rub(behind(p_c, p_r))
        pull = ratio * p_c - p_r + sum(rubbing)
        heat += interval / (WARMING_S + interval) * (abs(pull * drive) - heat)
        for n, drop in enumerate((p_c - p_r, p_c, p_r)):
            if abs(drop) >= STILL_N:
                opening = steady(n, drop) * sqrt(abs(drop) + body.laminar_N) / drop
                opened[n] += shares[n] * (opening - opened[n])
        result.append((p_c, p_r, sum(rubbing)))
    return result


def hydraulic_forces(model: Model, inputs: Inputs) -> list[float]:
    """Return the forces of a hydraulic network [N], without its force envelope."""
    body, interval = model.body, 1.0 / model.sampling.rate_Hz
    positions, speeds, currents = limited(model, inputs)
    sides = drives(body.side, positions, speeds, interval)
    valve = settings(body.valve, currents, interval, exp(-interval / body.relax_s))
    oil = pressures(model, positions, [drive for drive, _ in sides], valve)
    forces = []
    for (_, side), (p_c, p_r, rubbed) in zip(sides, oil, strict=True):
        grown = rubbed * (1.0 + body.friction_growth_1_N * max(p_r, 0.0))
        forces.append((1.0 + body.area_ratio) * p_c - p_r + side + grown)
    return forces


def energy(body: Hydraulic, position: float, p_c: float, p_r: float, rubbing: Sequence[float]) -> float:
    """Return the energy stored [N m] at a position [m], pressures [N] and forces [N] of the friction elements."""

    def stored_at(p: float) -> float:
        places = sorted([0.0, p, *(x for x in (body.reservoir_N * (t - 1.0) for t in SPREAD) if 0.0 < x / p < 1.0)])
        area = sum(0.5 * (phi(body, a) + phi(body, b)) * (b - a) for a, b in pairwise(places))
        return p * phi(body, p) - (area if p > 0.0 else -area)

    compression = body.compression_m_N * exp(body.compression_growth_1_m * position)
    rebound = body.rebound_m_N * exp(body.rebound_growth_1_m * position)
    cells = sum(size * stored_at(p) for size, p in ((compression, p_c), (rebound, p_r)) if p)
    springs = sum(0.5 * z**2 / one.stiffness_N_m for z, one in zip(rubbing, body.side.friction, strict=True))
    return cells + springs + 0.5 * body.mount_m_N * ((1.0 + body.area_ratio) * p_c - p_r + sum(rubbing)) ** 2
