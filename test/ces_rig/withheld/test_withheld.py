"""Withheld effects: none at severity 0, more with more, found by the gap they make, the same for the same seed."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from ces_data.waveforms.strokes import make_stroke
from ces_rig.dampers.model import EFFECTS, OUTSIDE, WithheldEffect
from ces_rig.errors import RigError
from ces_rig.experiments.virtual import load_rig
from ces_rig.sensors import GRID_S, Sensors, measure_signals
from ces_rig.withheld.plants import (
    PLANTS,
    available_effects,
    draw_effect,
    draw_plant,
    gap_from,
    perturb,
    perturb_to_gap,
    physical_numbers,
    scale_to_gap,
    search_size,
    simulate_expected,
    simulate_signals,
)

SECONDS = {"hydraulic": 0.4, "bouc_wen": 1.0, "lookup": 1.0}
CHECKS = {"sticking_check", "late_check"}
WITHOUT = {"hydraulic": set(), "bouc_wen": CHECKS, "lookup": CHECKS}


def gap_N(plant, effects, *inputs):
    return gap_from(plant, simulate_signals(plant, (), *inputs), simulate_signals(plant, effects, *inputs))


def drive(kind, steady=False):
    time = np.arange(round(SECONDS[kind] / GRID_S)) * GRID_S
    noise = {"kind": "noise", "peak_to_peak_m": 0.07, "cutoff_Hz": 8.0, "fade_s": 0.1}
    stroke = make_stroke(noise, "x").samples(time, np.random.default_rng(1))
    low, high = draw_plant(kind, np.random.default_rng(0)).current_A
    levels = np.random.default_rng(2).uniform(low, high, len(time) // 200 + 1)
    command = np.full_like(time, 0.5 * (low + high)) if steady else np.repeat(levels, 200)[: len(time)]
    return time, stroke, command


def plant_of(kind):
    return draw_plant(kind, np.random.default_rng(3))


@pytest.mark.parametrize("kind", PLANTS)
def test_every_effect_of_the_library_is_available(kind):
    assert set(EFFECTS + OUTSIDE) - set(available_effects(kind)) == WITHOUT[kind]
    assert len(OUTSIDE) >= 6 and not set(EFFECTS) & set(OUTSIDE)


def one_plant_for_each_effect():
    """Every effect once, on one plant after the other that has it."""
    for number, name in enumerate(EFFECTS + OUTSIDE):
        plants = [kind for kind in PLANTS if name in available_effects(kind)]
        yield plants[number % len(plants)], name


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "name"), list(one_plant_for_each_effect()))
def test_more_severity_is_a_larger_gap(kind, name):
    plant, inputs = plant_of(kind), drive(kind)
    if name == "sticking_pilot":  # steps would free the spool at once or never
        low, high = plant.current_A
        inputs = (*inputs[:2], 0.5 * (low + high) + 0.4 * (high - low) * np.sin(2.0 * np.pi * 6.0 * inputs[0]))
    effect = draw_effect(kind, name, np.random.default_rng(5))
    free = simulate_signals(plant, (), *inputs)
    small = scale_to_gap(plant, effect, 10.0, *inputs)
    grown = [
        simulate_signals(plant, [replace(small, severity=factor * small.severity)], *inputs) for factor in (1.0, 1.2)
    ]
    gaps = [gap_from(plant, free, true) for true in grown]
    assert gaps[0] == pytest.approx(10.0, rel=0.04)
    assert gaps[1] > 1.05 * gaps[0]
    assert all(np.isfinite(v) for v in physical_numbers(plant, small).values())


@pytest.mark.slow
@pytest.mark.parametrize("kind", PLANTS)
def test_severity_0_is_none_and_a_vanishing_severity_makes_a_vanishing_gap(kind):
    plant, inputs = plant_of(kind), drive(kind)
    free = simulate_signals(plant, (), *inputs)
    for name in available_effects(kind):
        effect = draw_effect(kind, name, np.random.default_rng(5))
        nothing = simulate_signals(plant, [replace(effect, severity=0.0)], *inputs)
        for signal in ("force_N", "stroke_m", "coil_A"):
            assert np.array_equal(getattr(nothing, signal), getattr(free, signal)), (name, signal)
        little = simulate_signals(plant, [replace(effect, severity=1e-5)], *inputs)
        assert gap_from(plant, free, little) < 1.0, name


@pytest.mark.parametrize("kind", PLANTS)
@pytest.mark.slow
def test_the_description_simulates_the_plant(kind, tmp_path):
    plant, inputs = plant_of(kind), drive(kind)
    true = simulate_signals(plant, (), *inputs)
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(plant.description()))
    rig = load_rig(path)
    assert np.sqrt(np.mean((rig(true.time_s, true.stroke_m, true.coil_A) - true.force_N) ** 2)) < 2.0
    recording = measure_signals(true, Sensors(), 1, "x")
    channels = [recording.channel(name) for name in ("position", "current", "force")]
    position, current, force = channels
    seconds = [(c.stamps_ns - position.stamps_ns[0]) * 1e-9 for c in channels]
    found = rig(seconds[0], position.values, np.interp(seconds[0], seconds[1], current.values))
    rest = np.interp(seconds[0], seconds[2], force.values) - found
    assert 6.0 < np.sqrt(np.mean(rest**2)) < 16.0  # the load cell's noise is 8 N


@pytest.mark.parametrize("kind", PLANTS)
def test_perturbed_to_a_wanted_error(kind):
    plant, inputs = plant_of(kind), drive(kind)
    assert perturb(plant, 0.0, np.random.default_rng(1)) == plant
    wrong, size = perturb_to_gap(plant, 20.0, 7, *inputs)
    assert wrong == perturb(plant, size, np.random.default_rng(7))
    difference = simulate_signals(wrong, (), *inputs).force_N - simulate_signals(plant, (), *inputs).force_N
    assert np.sqrt(np.mean(difference**2)) == pytest.approx(20.0, rel=0.04)
    changed = [key for key, number in wrong.description().items() if number != plant.description()[key]]
    assert len(changed) >= 5


@pytest.mark.parametrize("kind", PLANTS)
def test_the_same_seed_gives_the_same(kind):
    one, two = (draw_plant(kind, np.random.default_rng(9)) for _ in range(2))
    assert one == two != draw_plant(kind, np.random.default_rng(10))
    for name in available_effects(kind):
        effects = [draw_effect(kind, name, np.random.default_rng(seed)) for seed in (4, 4, 5)]
        assert effects[0] == effects[1] != effects[2]
    inputs = drive(kind)
    effect = draw_effect(kind, "friction", np.random.default_rng(4))
    assert np.array_equal(
        simulate_signals(one, [effect], *inputs).force_N, simulate_signals(two, [effect], *inputs).force_N
    )


def test_two_effects_add_up_to_more_than_either():
    plant, inputs = plant_of("bouc_wen"), drive("bouc_wen")
    friction, scale = (draw_effect("bouc_wen", name, np.random.default_rng(1)) for name in ("friction", "force_scale"))
    pair = [scale_to_gap(plant, effect, 30.0, *inputs) for effect in (friction, scale)]
    assert gap_N(plant, pair, *inputs) > 36.0


@pytest.mark.parametrize(
    ("kind", "name"), list(zip(PLANTS, ["valve_lag", "current_hysteresis", "sticking_pilot"], strict=True))
)
def test_what_needs_a_changing_current_cannot_be_reached_without(kind, name):
    effect = draw_effect(kind, name, np.random.default_rng(1))
    with pytest.raises(RigError, match=f"{kind} plant: {name}: a gap of 10 N cannot be reached here"):
        scale_to_gap(plant_of(kind), effect, 10.0, *drive(kind, steady=True))


def test_sensor_effects_leave_the_damper_alone():
    plant, inputs = plant_of("bouc_wen"), drive("bouc_wen")
    free = simulate_signals(plant, (), *inputs)
    effect = WithheldEffect("current_scale", 2.0, {"gain": 0.05, "offset": -0.01})
    true = simulate_signals(plant, [effect], *inputs)
    assert np.array_equal(true.force_N, free.force_N)
    assert true.coil_A == pytest.approx(1.1 * free.coil_A - 0.02 * 1.6)
    assert physical_numbers(plant, effect) == pytest.approx({"gain": 0.1, "offset_A": -0.032})
    late = simulate_signals(
        plant, [WithheldEffect("position_delay", 1.0, {"delay_s": 2e-3, "lag_share": 0.0})], *inputs
    )
    assert late.stroke_m[10:] == pytest.approx(inputs[1][6:-4])
    assert np.sqrt(np.mean((simulate_expected(plant, late) - late.force_N) ** 2)) > 3.0


TIME = np.arange(100) * 1e-3


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda: WithheldEffect("frction", 1.0, {}), "'frction' is unknown; expected one of friction"),
        (lambda: WithheldEffect("friction", -1.0, {}), "expected a number of at least 0"),
        (lambda: draw_plant("wet", np.random.default_rng(1)), "'wet' is unknown; expected one of hydraulic"),
        (
            lambda: draw_effect("bouc_wen", "sticking_check", np.random.default_rng(1)),
            "bouc_wen plant: no effect 'sticking_check'; it can have friction",
        ),
        (lambda: simulate_signals(plant_of("bouc_wen"), (), TIME, 0 * TIME, 0 * TIME), r"on a grid of 0\.0005 s"),
    ],
)
def test_mistakes_are_one_line(mistake, says):
    with pytest.raises(RigError, match=says):
        mistake()


@pytest.mark.parametrize("power", [0.5, 6.0])
def test_the_search_finds_sizes_of_any_steepness(power):
    size = search_size(lambda s: 100.0 * s**power, 7.0, "x")
    assert 100.0 * size**power == pytest.approx(7.0, rel=0.031)


def test_the_search_finds_what_begins_late_and_ends_early():
    def gap(size):
        if size > 5.0:
            raise RigError("too large")
        return max(0.0, size - 2.0) * 50.0

    assert gap(search_size(gap, 20.0, "x")) == pytest.approx(20.0, rel=0.031)
    with pytest.raises(RigError, match=r"200 N cannot be reached here; the largest is 1[0-9.]+ N; .* sizes: too large"):
        search_size(gap, 200.0, "x")
