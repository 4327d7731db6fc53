"""Effects on the damper's inputs and its state: planted by independent physics, recovered through the effects' API."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from input_physics import PLANTED, RATE_HZ, SECONDS, Brake, Damper, brakes, loose_brake, planted, recorded, valves
from scipy.optimize import least_squares

from ces_data.arrays import F
from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition, Effect, Setting
from ces_gap.effects.library import library
from ces_gap.trace import Trace

ON_INPUTS = ("backlash", "current_hysteresis", "current_scale", "position_delay", "valve_lag")
EFFECTS = tuple(e for e in library() if e.name in ON_INPUTS and not e.edits)
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

    low, high = np.array([p.search_bounds(usual=True) for p in effect.parameters]).T
    starts = effect.starts_for(trace)
    start = min((searched(s) for s in starts), key=lambda u: float(np.sum(residual(u) ** 2)))
    span = np.maximum(np.abs(start), 0.05 * (high - low))
    fitted = least_squares(residual, start, bounds=(low, high), x_scale=span, diff_step=1e-3, max_nfev=10)
    return values(fitted.x), residual(fitted.x)


@pytest.mark.slow
@pytest.mark.parametrize("form", PLANTED)
def test_a_planted_effect_is_recovered(form: str) -> None:
    values, trace = PLANTED[form][0], planted(form)
    gap = rms(trace.force - trace.simulated, trace)
    fitted, residual = refit(trace, FORMS[form])
    left = float(np.sqrt(np.mean(residual**2)))
    assert left < 0.15 * gap
    for value, expected in zip(fitted, values, strict=True):
        assert value == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("form", [form for form in FORMS if form.startswith(("valve_lag", "current_hysteresis"))])
def test_a_constant_current_stays_as_it_is(form: str) -> None:
    still = recorded(lambda x, v, i: valves(v, i), np.full(int(SECONDS * RATE_HZ), 0.7))
    for values in product(*((p.low, p.high) for p in FORMS[form].parameters)):
        inputs = FORMS[form].drive(still, still.inputs, still.simulated, values)
        np.testing.assert_allclose(inputs.current, 0.7, rtol=0.0, atol=1e-12)


def test_every_form_is_planted() -> None:
    assert set(PLANTED) == set(FORMS)


@pytest.mark.slow
def test_backlash_of_a_brake_is_recovered() -> None:
    trace = recorded(lambda x, v, i: loose_brake(x, i, 3e-3))
    trace = replace(trace, simulated=brakes(trace.inputs.position, trace.inputs.current))
    gap = rms(trace.force - trace.simulated, trace)
    fitted, residual = refit(trace, FORMS["backlash-parted"], Brake())
    assert fitted[0] == pytest.approx(3e-3, rel=0.1)  # a friction that knows no speed is no map with a spring
    assert float(np.sqrt(np.mean(residual**2))) < 0.2 * gap


@pytest.mark.slow
@pytest.mark.parametrize(
    ("true", "other"),
    [
        ("valve_lag-first_order", "current_hysteresis-plays"),
        ("current_hysteresis-plays", "valve_lag-rise_fall"),
    ],
)
def test_similar_effects_are_separated(true: str, other: str) -> None:
    """Refitted, the wrong effect leaves at least a quarter of the gap; the right one a few per cent."""
    trace = planted(true)
    gap = rms(trace.force - trace.simulated, trace)
    wrong = float(np.sqrt(np.mean(refit(trace, FORMS[other])[1] ** 2)))
    assert wrong > 0.25 * gap
