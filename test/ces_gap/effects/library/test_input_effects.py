"""Effects on the damper's inputs and its state: planted by independent physics, recovered through the effects' API."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from input_physics import (
    PLANTED,
    RATE_HZ,
    SECONDS,
    Brake,
    Damper,
    brakes,
    loose_brake,
    plain,
    planted,
    recorded,
    valves,
)
from scipy.optimize import least_squares

from ces_data.arrays import F
from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition, Effect, Setting
from ces_gap.effects.library import library
from ces_gap.trace import Trace, TraceInputs

ON_INPUTS = ("backlash", "cavitation", "compressibility", "current_hysteresis", "current_scale", "leakage",
             "mount_compliance", "position_delay", "valve_lag")  # fmt: skip
EFFECTS = tuple(e for e in library() if e.name in ON_INPUTS)
FORMS = {f"{e.name}-{e.form}": e for e in EFFECTS}


def with_effect(trace: Trace, effect: Effect, values: Sequence[float], damper: Damper | Brake | None = None) -> F:
    return Plant(damper or Damper()).with_effects(Composition((Setting(effect, tuple(values)),)), trace)


def rms(values: F, trace: Trace) -> float:
    return float(np.sqrt(np.mean(values[trace.usable] ** 2)))


def refit(trace: Trace, effect: Effect, damper: Damper | Brake | None = None) -> tuple[tuple[float, ...], F]:
    """The effect's values fitted to the measured force from its best start, and the remaining residual [N] (n,)."""

    def values(at: F) -> tuple[float, ...]:
        return tuple(p.to_value(float(u)) for p, u in zip(effect.parameters, at, strict=True))

    def residual(at: F) -> F:
        return (trace.force - with_effect(trace, effect, values(at), damper))[trace.usable]

    def searched(start: tuple[float, ...]) -> F:
        near = [p.to_search(s) for p, s in zip(effect.parameters, start, strict=True)]
        return np.clip(near, low + 1e-6 * (high - low), high - 1e-6 * (high - low))

    low, high = np.array([p.search_bounds() for p in effect.parameters]).T
    starts = effect.starts_for(trace)
    start = min((searched(s) for s in starts), key=lambda u: float(np.sum(residual(u) ** 2)))
    span = np.maximum(np.abs(start), 0.05 * (high - low))
    fitted = least_squares(residual, start, bounds=(low, high), x_scale=span, diff_step=1e-3, max_nfev=10)
    return values(fitted.x), residual(fitted.x)


@pytest.mark.parametrize("form", PLANTED)
def test_a_planted_effect_is_recovered(form: str) -> None:
    values, trace = PLANTED[form][0], planted(form)
    gap = rms(trace.force - trace.simulated, trace)
    fitted, residual = refit(trace, FORMS[form])
    left = float(np.sqrt(np.mean(residual**2)))
    assert left < 0.15 * gap
    for value, expected in zip(fitted, values, strict=True):
        assert value == pytest.approx(expected, rel=0.08)


def test_every_form_is_planted() -> None:
    assert set(PLANTED) == set(FORMS)


def corners(effect: Effect) -> list[tuple[float, ...]]:
    return list(product(*((p.low, p.high) for p in effect.parameters)))


def neutral(effect: Effect) -> tuple[float, ...]:
    return tuple(p.neutral if p.magnitude else p.starts[0] for p in effect.parameters)


def arrays_of(inputs: TraceInputs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return inputs.position, inputs.speed, inputs.current


@pytest.mark.parametrize("form", FORMS)
def test_neutral_values_change_nothing(form: str) -> None:
    trace, values = plain(), neutral(FORMS[form])
    inputs = FORMS[form].drive(trace, trace.inputs, trace.simulated, values)
    force = FORMS[form].respond(trace, inputs, trace.simulated, values)
    for was, now in zip(arrays_of(trace.inputs), arrays_of(inputs), strict=True):
        np.testing.assert_allclose(now, was, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(force, trace.simulated, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("form", FORMS)
def test_forces_are_finite_in_every_corner_and_at_constant_current(form: str) -> None:
    effect, still = FORMS[form], recorded(lambda x, v, i: valves(v, i), np.full(int(SECONDS * RATE_HZ), 0.7))
    for trace, values in product((plain(), still), corners(effect)):
        inputs = effect.drive(trace, trace.inputs, trace.simulated, values)
        force = effect.respond(trace, inputs, trace.simulated, values)
        assert all(np.isfinite(a).all() for a in (*arrays_of(inputs), force))
    if effect.name in ("valve_lag", "current_hysteresis"):
        np.testing.assert_allclose(inputs.current, 0.7, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_forces_are_smooth_in_the_parameters(form: str) -> None:
    """One-sided differences of the steps that a fit takes agree with central ones."""
    effect, values, trace = FORMS[form], PLANTED[form][0], plain()
    for k, p in enumerate(effect.parameters):
        low, high = p.search_bounds()
        at = p.to_search(values[k])
        share = 2e-4 if effect.name == "cavitation" else 1e-3
        step = share * min(high - low, 10.0 * abs(at)) * (-1.0 if p.to_value(high) == values[k] else 1.0)

        def force(searched: float, k: int = k, p=p) -> F:
            return with_effect(trace, effect, (*values[:k], p.to_value(searched), *values[k + 1 :]))

        forward = force(at + step) - force(at)
        twice = 0.5 * (force(at + 2.0 * step) - force(at))
        assert rms(forward, trace) > 0.0
        assert rms(forward - twice, trace) < 0.15 * rms(forward, trace), p.name


def test_backlash_of_a_brake_is_recovered() -> None:
    trace = recorded(lambda x, v, i: loose_brake(x, i, 3e-3))
    trace = replace(trace, simulated=brakes(trace.inputs.position, trace.inputs.current))
    gap = rms(trace.force - trace.simulated, trace)
    fitted, residual = refit(trace, FORMS["backlash-parted"], Brake())
    assert fitted[0] == pytest.approx(3e-3, rel=0.1)  # a friction that knows no speed is no map with a spring
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
def test_similar_effects_are_separated(true: str, other: str) -> None:
    """Refitted, the wrong effect leaves at least a quarter of the gap; the right one a few per cent."""
    trace = planted(true)
    gap = rms(trace.force - trace.simulated, trace)
    wrong = float(np.sqrt(np.mean(refit(trace, FORMS[other])[1] ** 2)))
    assert wrong > 0.25 * gap
