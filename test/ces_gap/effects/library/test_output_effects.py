"""Effects on the force: each is planted by textbook equations around a damper and recovered by its Effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import output_plants as plants
import pytest
from output_plants import Planted
from scipy.optimize import least_squares

from ces_gap.effects.effect import Effect
from ces_gap.effects.library import library
from ces_gap.effects.library.gas_spring import POLYTROPIC
from ces_gap.trace import Trace

AREA, VOLUME, PRESSURE = 2.5e-4, 4e-5, 2e6  # of the rod [m2], of the gas [m3], its gauge pressure [Pa]
GAS_STIFFNESS, GAS_COLUMN = 1.3 * PRESSURE * AREA**2 / VOLUME, VOLUME / AREA

FORMS = {(e.name, e.form): e for e in library()}

# form, what is planted, the values to find, and by how much each may be missed (as a share of it)
CASES: list[tuple[tuple[str, str], Planted, Sequence[float], Sequence[float]]] = [
    (
        ("friction", "coulomb_stribeck"),
        plants.coulomb_stribeck(60.0, 0.008, 0.8, 0.1),
        (60.0, 0.008, 0.8, 0.1),
        (0.03, 0.1, 0.1, 0.1),
    ),
    (("friction", "presliding"), plants.lugre(40.0, 1e-4), (40.0, 1e-4), (0.02, 0.1)),
    (("friction", "lugre"), plants.lugre(40.0, 3e-4, 0.6, 0.5), (40.0, 3e-4, 0.6, 0.5), (0.04, 0.15, 0.25, 0.1)),
    (("inertia", "mass"), plants.mass(1.5), (1.5,), (0.03,)),
    (("gas_spring", "linear"), lambda m: m.force + 1500.0 * m.position, (1500.0,), (0.02,)),
    (("gas_spring", "polytropic"), plants.gas(PRESSURE, AREA, VOLUME), (GAS_STIFFNESS, GAS_COLUMN), (0.02, 0.05)),
    (
        ("gas_spring", "charged"),
        lambda m: plants.gas(PRESSURE, AREA, VOLUME)(m) + PRESSURE * AREA,
        (PRESSURE * AREA, GAS_COLUMN),
        (0.02, 0.05),
    ),
    (("temperature_fade", "heated"), plants.faded(2e-5), (2e-5,), (0.02,)),
    (("temperature_fade", "cooled"), plants.faded(4e-5, 8.0), (4e-5, 8.0), (0.05, 0.1)),
    (("bump_stop", "compression"), plants.stopped(6e4, 9e6, 0.03, -1.0), (6e4, 9e6, 0.03), (0.08, 0.05, 0.01)),
    (("bump_stop", "rebound"), plants.stopped(6e4, 9e6, 1.0, -0.03), (6e4, 9e6, -0.03), (0.08, 0.05, 0.01)),
    (("bump_stop", "both"), plants.stopped(4e4, 6e6, 0.03, -0.035), (4e4, 6e6, 0.03, -0.035), (0.08, 0.05, 0.01, 0.01)),
    (("force_offset", "constant"), lambda m: m.force - 40.0, (-40.0,), (0.02,)),
    (("force_scale", "gain"), lambda m: 0.93 * m.force, (0.93,), (0.002,)),
    (("force_drift", "linear"), lambda m: m.force + 2.0 * m.time, (2.0,), (0.02,)),
    (("force_drift", "settling"), plants.drifted(60.0, 6.0), (60.0, 6.0), (0.03, 0.08)),
]


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["compression", "rebound"])
def test_a_void_is_recovered_from_a_damper_whose_chamber_runs_empty(side: float) -> None:
    """The oil is a spring before a valve; it carries `void_N` at most, and must be full again to carry less."""
    known = plants.trace()
    time, speed = known.time_s, known.inputs.speed
    valve, stiffness, void_N = 1500.0, 2e6, 0.6 * side * 1500.0 * float(np.abs(speed).max())

    def force(limit: float) -> np.ndarray:
        out, pressed, parts = np.zeros(len(time)), 0.0, 40
        for k in range(1, len(time)):
            for j in range(parts):
                v = speed[k - 1] + (j + 0.5) / parts * (speed[k] - speed[k - 1])
                carried = side * min(side * stiffness * pressed, side * limit)
                pressed += (v - carried / valve) * (time[k] - time[k - 1]) / parts
            out[k] = side * min(side * stiffness * pressed, side * limit)
        return out

    trace = replace(known, simulated=force(np.inf * side), force=force(void_N))
    (found,) = refit(FORMS["cavitation", "void_in_compression" if side > 0.0 else "void_in_rebound"], trace)
    assert found == pytest.approx(abs(void_N), rel=0.03)


def refit(effect: Effect, trace: Trace) -> tuple[float, ...]:
    """Return the values that fit best from the effect's starts, searched inside the bounds."""
    low, high = np.array([p.search_bounds(usual=True) for p in effect.parameters]).T
    starts = effect.starts_for(trace)

    def values(u: np.ndarray) -> tuple[float, ...]:
        return tuple(p.to_value(x) for p, x in zip(effect.parameters, u, strict=True))

    def residual(u: np.ndarray) -> np.ndarray:
        force = effect.respond(trace, trace.inputs, trace.simulated, values(u))
        return np.asarray((force - trace.force)[trace.usable])

    fits = []
    for start in starts:
        at = np.clip([p.to_search(x) for p, x in zip(effect.parameters, start, strict=True)], low, high)
        fits.append(least_squares(residual, at, bounds=(low, high), x_scale="jac", diff_step=1e-4, max_nfev=40))
    return values(min(fits, key=lambda fit: fit.cost).x)


@pytest.mark.slow
@pytest.mark.parametrize(("key", "planted", "true", "within"), CASES, ids=["-".join(case[0]) for case in CASES])
def test_a_planted_effect_is_recovered_from_its_starts(
    key: tuple[str, str], planted: Planted, true: Sequence[float], within: Sequence[float]
) -> None:
    fitted = refit(FORMS[key], plants.trace(planted))
    off = [abs(f - t) / abs(t) for f, t in zip(fitted, true, strict=True)]
    assert all(o <= w for o, w in zip(off, within, strict=True)), f"{fitted} for {tuple(true)}"


def test_friction_dissipates_energy_in_every_stroke() -> None:
    trace = plants.trace(seconds=5.0)
    for form in ("coulomb_stribeck", "presliding", "lugre"):
        effect = FORMS["friction", form]
        rubbing = respond("friction", form, trace, [p.starts[0] for p in effect.parameters]) - trace.simulated
        assert np.sum(rubbing * trace.inputs.speed) > 0.9 * 20.0 * np.sum(np.abs(trace.inputs.speed)), form


def test_gas_about_the_mean_is_independent_of_the_sensor_zero() -> None:
    trace = plants.trace(seconds=5.0)
    moved = replace(trace, inputs=replace(trace.inputs, position=trace.inputs.position + 0.2))
    values = (1500.0, 0.3)
    here = respond("gas_spring", "about_mean", trace, values)
    assert respond("gas_spring", "about_mean", moved, values) == pytest.approx(here, abs=1e-6)


def test_a_charged_gas_spring_has_its_law_from_any_zero_of_the_position() -> None:
    trace = plants.trace(seconds=5.0)
    moved = replace(trace, inputs=replace(trace.inputs, position=trace.inputs.position - 0.05))
    at_new_zero = 200.0 * (1.0 - 0.05 / 0.3) ** -POLYTROPIC
    here = respond("gas_spring", "charged", trace, (200.0, 0.3))
    assert respond("gas_spring", "charged", moved, (at_new_zero, 0.25)) == pytest.approx(here, abs=1e-6)


def test_heat_without_cooling_is_the_work_done() -> None:
    trace = plants.trace(seconds=10.0)
    faded = respond("temperature_fade", "heated", trace, (1e-5,))
    work = np.cumsum(trace.simulated * trace.inputs.speed) * trace.step_s
    strong = np.abs(trace.simulated) > 200.0
    lost = -np.log((faded / trace.simulated)[strong]) / 1e-5
    assert lost == pytest.approx(work[strong], rel=1e-6)
    slow = respond("temperature_fade", "cooled", trace, (1e-5, 3000.0))
    assert slow == pytest.approx(faded, abs=2.0)


def test_fade_by_measured_temperature_is_recovered() -> None:
    warm = 25.0 + 1.5 * plants.motion().time
    trace = plants.trace(lambda m: m.force * np.exp(-0.004 * (warm - 25.0)), temperature=warm)
    assert refit(FORMS["temperature_fade", "measured"], trace)[0] == pytest.approx(0.004, rel=0.02)


def test_without_a_known_temperature_there_is_no_measured_fade() -> None:
    unknown = np.full(5 * plants.FINE_HZ, np.nan)
    for trace in (plants.trace(seconds=5.0), plants.trace(seconds=5.0, temperature=unknown)):
        assert np.array_equal(respond("temperature_fade", "measured", trace, (0.05,)), trace.simulated)


def test_starts_of_stops_lie_within_the_recording() -> None:
    trace = plants.trace(seconds=5.0)
    furthest = trace.inputs.position.max()
    contacts = [start[2] for start in FORMS["bump_stop", "compression"].starts_for(trace)]
    assert all(0.3 * furthest < at < furthest for at in contacts)


def respond(name: str, form: str, trace: Trace, values: Sequence[float]) -> np.ndarray:
    return FORMS[name, form].respond(trace, trace.inputs, trace.simulated, values)
