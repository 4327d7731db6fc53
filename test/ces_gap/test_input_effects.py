"""Effects on the damper's inputs and its state: planted by independent physics, recovered through the effects' API."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from numba import njit
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from ces_gap.effect import Composition, Effect, Setting
from ces_gap.effects import (
    backlash,
    cavitation,
    compressibility,
    current_hysteresis,
    current_scale,
    leakage,
    mount_compliance,
    position_delay,
    valve_lag,
)
from ces_gap.plant import Plant
from ces_gap.trace import F, Inputs, Trace, make_trace
from ces_identify.recording import Channel, Recording

RATE_HZ, SECONDS, FINER = 1000.0, 5, 8  # physics run FINER times as fast as recordings are logged
MODULES = (
    backlash,
    cavitation,
    compressibility,
    current_hysteresis,
    current_scale,
    leakage,
    mount_compliance,
    position_delay,
    valve_lag,
)
EFFECTS: tuple[Effect, ...] = tuple(form for module in MODULES for form in module.FORMS)
FORMS = {f"{e.name}-{e.form}": e for e in EFFECTS}
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
class Damper:
    """The simulation."""

    def force(self, trace: Trace, inputs: Inputs) -> F:
        return np.asarray(valves(inputs.speed, inputs.current))


@dataclass(frozen=True)
class Brake:
    """A simulation with memory."""

    def force(self, trace: Trace, inputs: Inputs) -> F:
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
def starving(speed, force, side, limit, share, bubbles, step):
    out = force.copy()
    z = 0.0
    for k in range(len(speed)):
        onward = side * speed[k]
        z = max(z + step * (share * (onward - limit) if onward > 0.0 else onward - share * limit), 0.0)
        if side * force[k] < 0.0:
            out[k] = force[k] * np.exp(-z / bubbles)
    return out


@njit(cache=True)
def floored(speed, force, side, limit, bubbles, step):
    out = force.copy()
    z = 0.0
    for k in range(len(speed)):
        onward, pull = side * speed[k], side * force[k]
        if onward > 0.0:
            z = max(z + step * onward * (pull - limit) / max(abs(pull), 0.1 * limit), 0.0)
        else:
            z = max(z + step * onward, 0.0)
        out[k] = side * (min(pull, limit) if pull > 0.0 else pull * np.exp(-z / bubbles))
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
    "backlash-parted": ((1e-3,), lambda x, v, i: valves(np.gradient(play(x, 5e-4)) / FINE_S, i)),
    "cavitation-rebound_intake": (
        (0.8, 0.04, 5e-4),
        lambda x, v, i: starving(v, valves(v, i), -1.0, 0.04, 0.8, 5e-4, FINE_S),
    ),
    "cavitation-compression_intake": (
        (0.8, 0.04, 5e-4),
        lambda x, v, i: starving(v, valves(v, i), 1.0, 0.04, 0.8, 5e-4, FINE_S),
    ),
    "cavitation-rebound_floor": (
        (1.0, 400.0, 5e-4),
        lambda x, v, i: floored(v, valves(v, i), -1.0, 400.0, 5e-4, FINE_S),
    ),
    "cavitation-compression_floor": (
        (1.0, 250.0, 5e-4),
        lambda x, v, i: floored(v, valves(v, i), 1.0, 250.0, 5e-4, FINE_S),
    ),
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
    stamps = np.round(time * 1e9).astype(np.int64)
    pairs = (("position", "m", x), ("current", "A", i), ("force", "N", force))
    trace = make_trace(Recording("planted", {n: Channel(n, u, stamps, y) for n, u, y in pairs}), force)
    return replace(trace, simulated=Damper().force(trace, trace.inputs))


@cache
def plain() -> Trace:
    return recorded(lambda x, v, i: valves(v, i))


@cache
def planted(form: str) -> Trace:
    return recorded(PLANTED[form][1])


def with_effect(trace: Trace, effect: Effect, values: Sequence[float], damper: Damper | Brake | None = None) -> F:
    return Plant(damper or Damper()).with_effects(Composition((Setting(effect, tuple(values)),)), trace)


def rms(values: F, trace: Trace) -> float:
    return float(np.sqrt(np.mean(values[trace.usable] ** 2)))


def refit(trace: Trace, effect: Effect, damper: Damper | Brake | None = None) -> tuple[tuple[float, ...], F]:
    """The effect's values fitted to the measured force from its best start, and the residual [N] left (n,)."""

    def values(at: F) -> tuple[float, ...]:
        return tuple(p.to_value(float(u)) for p, u in zip(effect.parameters, at, strict=True))

    def residual(at: F) -> F:
        return (trace.force - with_effect(trace, effect, values(at), damper))[trace.usable]

    def searched(start: tuple[float, ...]) -> F:
        near = [p.to_search(s) for p, s in zip(effect.parameters, start, strict=True)]
        return np.clip(near, low + 1e-6 * (high - low), high - 1e-6 * (high - low))

    low, high = np.array([p.search_bounds() for p in effect.parameters]).T
    given = getattr(effect, "starts_for", None)
    starts = given(trace) if given else list(product(*(p.starts for p in effect.parameters)))
    start = min((searched(s) for s in starts), key=lambda u: float(np.sum(residual(u) ** 2)))
    span = np.maximum(np.abs(start), 0.05 * (high - low))
    found = least_squares(residual, start, bounds=(low, high), x_scale=span, diff_step=1e-3, max_nfev=10)
    return values(found.x), residual(found.x)


@pytest.mark.parametrize("form", PLANTED)
def test_a_planted_effect_is_recovered(form: str) -> None:
    values, trace = PLANTED[form][0], planted(form)
    gap = rms(trace.force - trace.simulated, trace)
    found, residual = refit(trace, FORMS[form])
    left = float(np.sqrt(np.mean(residual**2)))
    assert left < 0.15 * gap
    for value, expected in zip(found, values, strict=True):
        assert value == pytest.approx(expected, rel=0.08)


def test_every_form_is_planted() -> None:
    assert set(PLANTED) == set(FORMS)


def corners(effect: Effect) -> list[tuple[float, ...]]:
    return list(product(*((p.low, p.high) for p in effect.parameters)))


def neutral(effect: Effect) -> tuple[float, ...]:
    return tuple(p.neutral if p.magnitude else p.starts[0] for p in effect.parameters)


@pytest.mark.parametrize("form", FORMS)
def test_neutral_changes_nothing(form: str) -> None:
    trace, values = plain(), neutral(FORMS[form])
    if form == "mount_compliance-linear":
        values = (values[0], 0.0)
    inputs = FORMS[form].drive(trace, trace.inputs, trace.simulated, values)
    force = FORMS[form].respond(trace, inputs, trace.simulated, values)
    for was, now in zip(vars(trace.inputs).values(), vars(inputs).values(), strict=True):
        np.testing.assert_allclose(now, was, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(force, trace.simulated, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("form", FORMS)
def test_finite_in_every_corner_and_at_a_constant_current(form: str) -> None:
    effect, still = FORMS[form], recorded(lambda x, v, i: valves(v, i), np.full(int(SECONDS * RATE_HZ), 0.7))
    for trace, values in product((plain(), still), corners(effect)):
        inputs = effect.drive(trace, trace.inputs, trace.simulated, values)
        force = effect.respond(trace, inputs, trace.simulated, values)
        assert all(np.isfinite(a).all() for a in (*vars(inputs).values(), force))
    if effect.name in ("valve_lag", "current_hysteresis"):
        np.testing.assert_allclose(inputs.current, 0.7, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_smooth_in_its_parameters(form: str) -> None:
    """One-sided differences of the steps that a fit takes agree with central ones."""
    effect, values, trace = FORMS[form], PLANTED[form][0], plain()
    for k, p in enumerate(effect.parameters):
        low, high = p.search_bounds()
        at = p.to_search(values[k])
        step = (
            (2e-4 if effect.name == "cavitation" else 1e-3)
            * min(high - low, 10.0 * abs(at))
            * (-1.0 if p.to_value(high) == values[k] else 1.0)
        )

        def force(searched: float, k: int = k, p=p) -> F:
            return with_effect(trace, effect, (*values[:k], p.to_value(searched), *values[k + 1 :]))

        forward = force(at + step) - force(at)
        twice = 0.5 * (force(at + 2.0 * step) - force(at))
        assert rms(forward, trace) > 0.0
        assert rms(forward - twice, trace) < 0.15 * rms(forward, trace), p.name


def test_a_loose_brake_is_found_with_a_simulation_that_holds_its_force() -> None:
    trace = recorded(lambda x, v, i: loose_brake(x, i, 3e-3))
    trace = replace(trace, simulated=brakes(trace.inputs.position, trace.inputs.current))
    gap = rms(trace.force - trace.simulated, trace)
    found, residual = refit(trace, FORMS["backlash-parted"], Brake())
    assert found[0] == pytest.approx(3e-3, rel=0.05)
    assert float(np.sqrt(np.mean(residual**2))) < 0.2 * gap


@pytest.mark.parametrize(
    ("true", "other"),
    [
        ("compressibility-sides", "mount_compliance-linear"),
        ("compressibility-aerated", "mount_compliance-linear"),
        ("compressibility-aerated", "mount_compliance-progressive"),
        ("leakage-rebound", "current_scale-gain_offset"),
        ("current_scale-gain_offset", "leakage-rebound"),
        ("cavitation-rebound_intake", "backlash-held"),
        ("backlash-held", "cavitation-rebound_intake"),
        ("backlash-held", "mount_compliance-progressive"),
        ("backlash-held", "compressibility-aerated"),
        ("mount_compliance-progressive", "backlash-held"),
        ("valve_lag-first_order", "current_hysteresis-plays"),
        ("current_hysteresis-plays", "valve_lag-rise_fall"),
        ("current_hysteresis-remanence", "current_scale-gain_offset"),
        ("position_delay-shift", "mount_compliance-linear"),
        ("mount_compliance-linear", "position_delay-shift"),
    ],
)
def test_pairs_part(true: str, other: str) -> None:
    """Refitted, the wrong effect leaves at least a quarter of the gap; the right one leaves a few per cent."""
    trace = planted(true)
    gap = rms(trace.force - trace.simulated, trace)
    wrong = float(np.sqrt(np.mean(refit(trace, FORMS[other])[1] ** 2)))
    assert wrong > 0.25 * gap
