"""The contract of every form of every effect, documentation included, and the errors of the simulation as effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import output_plants as plants
import pytest
from engine_plant import traced
from made_recordings import recording_of

from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.effects.library import library
from ces_gap.effects.simulation_errors import CALIBRATION_FORMS as FORMS
from ces_gap.effects.simulation_errors import ForceMap, ForceMapOfCurrent, SampleTiming, simulation_errors
from ces_gap.trace import Trace, TraceInputs, make_trace
from ces_identify.characteristics.rows import TABLES
from ces_report.table import row_fields

DESIGNED = {
    "friction", "compressibility", "mount_compliance", "backlash", "inertia", "gas_spring", "cavitation",
    "temperature_fade", "leakage", "blow_off", "bump_stop", "valve_lag", "current_hysteresis", "current_scale",
    "force_offset", "force_drift", "force_scale", "position_delay",
}  # fmt: skip
# the last part of a unit is enough: "N_m", "m_s_rtN"
UNITS = ("_N", "_m", "_s", "_kg", "_A", "_sN", "_rtN", "_m2", "_per_J", "_per_K", "_per_N")
NUMBERS = {
    "gain", "share", "slope", "static_excess", "softness", "area_share", "floor_share", "air",
}  # without a unit  # fmt: skip
SECONDS = 2.0
EFFECTS = library()
IDS = [f"{e.name}-{e.form}" for e in EFFECTS]

each = pytest.mark.parametrize("effect", EFFECTS, ids=IDS)
OUTSIDE = [e for e in EFFECTS if not e.edits]  # the others: test_network.py
each_outside = pytest.mark.parametrize("effect", OUTSIDE, ids=[f"{e.name}-{e.form}" for e in OUTSIDE])


@cache
def rough() -> Trace:
    """Return a rough recording: steps of current, a temperature that rises, a stroke with a pause."""
    time = np.arange(round(SECONDS * 1000)) / 1000.0
    stroke = np.where(time < 1.6, 0.02 * np.sin(2 * np.pi * 2.3 * time) + 0.004 * np.sin(2 * np.pi * 9.1 * time), 0.0)
    current = np.where((time * 2.7).astype(int) % 2 == 0, 0.2, 0.9)
    force = (800.0 + 900.0 * current) * np.tanh(np.gradient(stroke, time) / 0.1) + 60.0
    temperature = 20.0 + 5.0 * time
    return make_trace(recording_of(time, position=stroke, current=current, force=force, temperature=temperature), force)


def arrays(effect: Effect, trace: Trace, values: Sequence[float]) -> np.ndarray:
    """Return the inputs of the damper and the force outside; the damper has the simulated force."""
    composition = Composition((Setting(effect, tuple(values)),))
    inputs = composition.drive(trace, trace.simulated)
    force = composition.respond(trace, inputs, trace.simulated)
    return np.array([inputs.position, inputs.speed, inputs.current, force])


def unchanged(trace: Trace) -> np.ndarray:
    return np.array([trace.inputs.position, trace.inputs.speed, trace.inputs.current, trace.simulated])


def neutral(effect: Effect) -> list[float]:
    return [p.neutral if p.magnitude else p.starts[0] for p in effect.parameters]


def typical(effect: Effect) -> list[float]:
    return [p.starts[0] for p in effect.parameters]


def test_the_library_holds_the_effects_of_the_contract_one_module_each() -> None:
    assert {e.name for e in EFFECTS} == DESIGNED
    assert len({(e.name, e.form) for e in EFFECTS}) == len(EFFECTS)
    for effect in EFFECTS:
        assert type(effect).__module__ == f"ces_gap.effects.library.{effect.name}"


def first_values(effect: Effect) -> list[float]:
    """The first starts, chosen by the trace if the effect does so."""
    own = type(effect).starts_for is not Effect.starts_for
    return list(effect.starts_for(rough())[0]) if own else typical(effect)


@each
def test_an_effect_is_described_and_its_bounds_hold_its_starts(effect: Effect) -> None:
    assert effect.form and effect.needs and effect.summary and type(effect).__doc__
    assert effect.parameters and (effect.edits or any(p.magnitude for p in effect.parameters))
    assert len({p.name for p in effect.parameters}) == len(effect.parameters)
    assert effect.reruns == (type(effect).drive is not Effect.drive)
    assert effect.edits == (type(effect).edit is not Effect.edit)
    for p in effect.parameters:
        assert p.name in NUMBERS or p.name.endswith(UNITS), p.name
        assert p.what and p.low < p.high
        assert p.starts and all(p.low <= s <= p.high for s in p.starts), p.name
        low, high = p.search_bounds()
        assert np.isfinite([low, high]).all() and low < high
        for value in (p.low, p.high, *p.starts):
            assert low <= p.to_search(value) <= high
            assert p.to_value(p.to_search(value)) == pytest.approx(value)
    starts = effect.starts_for(rough())
    assert starts
    for values in starts:
        assert all(p.low <= v <= p.high for p, v in zip(effect.parameters, values, strict=True)), values


@each_outside
def test_an_effect_changes_inputs_or_force_away_from_its_neutral_value_only(effect: Effect) -> None:
    before = unchanged(rough()).copy()
    assert arrays(effect, rough(), neutral(effect)) == pytest.approx(before, rel=1e-9, abs=1e-9)
    assert np.abs(arrays(effect, rough(), first_values(effect)) - before).max() > 1e-4
    assert np.array_equal(before, unchanged(rough())), "an effect does not change its arguments"
    blind = replace(rough(), force=np.full_like(rough().force, np.nan))
    one, other = (arrays(effect, trace, typical(effect)) for trace in (rough(), blind))
    assert np.array_equal(one, other), "an effect does not use the measured force"


@each_outside
def test_forces_are_finite_at_every_corner_and_smooth_in_between(effect: Effect) -> None:
    """Difference quotients of different steps agree, as a Gauss-Newton search needs."""
    for values in product(*((p.low, p.high) for p in effect.parameters)):
        assert np.isfinite(arrays(effect, rough(), values)).all(), values
    for k, p in enumerate(effect.parameters):
        small, large = (slope(effect, k, p, step) for step in (1e-5, 1e-4))
        assert np.linalg.norm(small - large) <= 0.2 * np.linalg.norm(large) + 1e-9, p.name


def slope(effect: Effect, k: int, p: EffectParameter, share: float) -> np.ndarray:
    """Return d(position, speed, current, force)/d(searched value), each over its typical value."""
    values = first_values(effect)
    at = p.to_search(values[k])
    step = share * max(abs(at), 1e-3 * (p.search_bounds()[1] - p.search_bounds()[0]))
    moved = [p.to_value(at + step) if j == k else v for j, v in enumerate(values)]
    change = (arrays(effect, rough(), moved) - arrays(effect, rough(), values)) / step
    return np.asarray(change[:, 50:-50] / np.array([[0.02], [0.5], [1.0], [1000.0]]))


def test_forces_are_finite_at_standstill() -> None:
    still = plants.trace(seconds=2.0)
    rest = replace(
        still,
        inputs=TraceInputs(*(np.zeros_like(still.time_s) for _ in range(3))),
        acceleration=np.zeros_like(still.time_s),
        simulated=np.zeros_like(still.time_s),
    )
    for effect in EFFECTS:
        assert np.isfinite(arrays(effect, rest, typical(effect))).all(), (effect.name, effect.form)


@pytest.fixture(scope="module")
def trace() -> Trace:
    return traced(seed=3)


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f.form)
def test_a_calibration_is_linear_in_its_parameters_and_nothing_at_zero(trace: Trace, form: ForceMap) -> None:
    rng = np.random.default_rng(0)
    one, two = (rng.standard_normal(len(form.parameters)) for _ in range(2))

    def added(values: np.ndarray) -> np.ndarray:
        return form.respond(trace, trace.inputs, trace.simulated, values.tolist()) - trace.simulated

    np.testing.assert_allclose(added(2.0 * one + two), 2.0 * added(one) + added(two), atol=1e-6)
    assert np.abs(added(0.0 * one)).max() == 0.0
    assert np.abs(added(one)).max() > 0.0


def test_a_map_without_current_is_part_of_the_map_of_current(trace: Trace) -> None:
    values = np.arange(1.0, 9.0).tolist()
    plain = ForceMap().respond(trace, trace.inputs, trace.simulated, values)
    wider = ForceMapOfCurrent().respond(trace, trace.inputs, trace.simulated, values + 6 * [0.0])
    np.testing.assert_array_equal(plain, wider)


def test_maps_cost_more_than_effects_and_timing_is_no_cause() -> None:
    assert all(form.prior_share > 0.0 for form in FORMS)
    assert [form.name for form in simulation_errors() if form.nuisance] == ["simulation_timing"]


def test_timing_shifts_by_samples_of_the_log(trace: Trace) -> None:
    shifted = SampleTiming().respond(trace, trace.inputs, trace.simulated, (1.0, 0.0))
    expected = np.interp(trace.time_s - trace.sample_s, trace.time_s, trace.simulated)
    inner = slice(200, -200)
    error = np.sqrt(np.mean((shifted - expected)[inner] ** 2))
    assert error < 0.15 * np.sqrt(np.mean((trace.simulated - expected)[inner] ** 2))


def test_a_negative_spread_sharpens_what_was_smoothed(trace: Trace) -> None:
    smooth = SampleTiming().respond(trace, trace.inputs, trace.simulated, (0.0, 0.2))
    again = SampleTiming().respond(trace, trace.inputs, smooth, (0.0, -0.2))
    inner = slice(200, -200)
    lost, left = (float(np.std((force - trace.simulated)[inner])) for force in (smooth, again))
    assert 0.0 < left < 0.5 * lost


def test_where_a_bench_shows_an_effect_is_a_column_of_its_tables():
    shown = {effect.name: effect.bench for effect in library() if effect.bench != ("", "")}
    assert {"valve_lag", "current_hysteresis", "current_scale", "friction"} <= set(shown)
    for table, name in shown.values():
        assert row_fields(TABLES[table])[name].heading
