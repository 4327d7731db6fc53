"""Errors of one line if a diagnosis is not possible, notes for doubts, nothing otherwise."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from made_recordings import recording_of
from samplings import make_sampling

from ces_data.checks.content import recording_marks
from ces_gap.augmented import AugmentedSimulation
from ces_gap.effects.effect import Composition, Effect, EffectParameter
from ces_gap.effects.library import require_sound, user_effect
from ces_gap.errors import GapError
from ces_gap.inputs.checks import (
    check_recordings,
    check_traces,
    compare_forces,
    exclude_saturated_ticks,
    find_invisible_effects,
    find_saturations,
    is_current_constant,
    require_distinct,
    seen_notes,
)
from ces_gap.trace import make_trace
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation
from ces_observer.errors import CesError
from ces_observer.model import Envelope, Model
from ces_observer.structures.polynomial import Factor, Polynomial, Term

RATE = 500.0
T = np.arange(5000) / RATE


def force_of(position, current):
    speed = np.gradient(position, 1.0 / RATE)
    return 2000.0 * position + np.sign(speed) * np.sqrt(np.abs(speed)) * (300.0 + 800.0 * current) + 40.0


def ride(name="ride", seed=1, noise=8.0, current=None, change=lambda force: force):
    random = np.random.default_rng(seed)
    position = 0.012 * np.sin(2 * np.pi * 1.7 * T + seed) + 0.004 * np.sin(2 * np.pi * 6.3 * T)
    current = 0.6 + 0.2 * np.sin(2 * np.pi * 0.8 * T + seed) if current is None else np.full(5000, current)
    force = change(force_of(position, current) + random.normal(0.0, noise, 5000))
    return recording_of(T, name, 10**18, position=position, current=current, force=force)


def simulated(recording, factor=1.0, fidelity=1.0):
    """The damper's force of a slightly wrong simulation, times a factor."""
    position, current = recording.channel("position").values, recording.channel("current").values
    wrong = 1500.0 * np.gradient(position, 1.0 / RATE)
    return factor * (fidelity * force_of(position, current) + (1.0 - fidelity) * wrong)


def trace(factor=1.0, fidelity=0.7, **more):
    recording = ride(**more)
    return make_trace(recording, simulated(recording, factor, fidelity))


SIM = FunctionSimulation("my:sim", lambda t, x, i: x)


# recordings ------------------------------------------------------------------------------------------------------


def test_different_recordings_have_no_notes():
    assert check_recordings([ride(seed=1), ride(seed=2)], [ride(seed=3)], [ride(seed=4)]) == ()


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (([1, 1], [], []), "a: the same recording, twice under real; pass each recording once"),
        (([1, 2], [2], []), "a: the same recording, under real and held_out; held-out recordings must not"),
        (([1], [], [1]), "a: the same recording, under real and reference; references must be free of"),
        (([1], [2], [2]), "a: the same recording, under held_out and reference"),
    ],
)
def test_a_duplicate_recording_is_refused(sets, message):
    def recording(seed):
        return replace(ride("a", seed), sha256=f"{seed:064x}")

    with pytest.raises(GapError, match=message):
        require_distinct(*([recording(seed) for seed in some] for some in sets))
    with pytest.raises(GapError, match="one and two: the same recording, under real and held_out"):
        require_distinct([ride("one", 1)], [ride("two", 1)], [])  # of the same content, without hashes


def test_a_recording_without_a_force_is_refused():
    channels = {name: c for name, c in ride().channels.items() if name != "force"}
    with pytest.raises(GapError, match="bare: no measured force"):
        check_recordings([replace(ride("bare"), channels=channels)], [], [])


# saturation ------------------------------------------------------------------------------------------------------


def clipped(low=-1e9, high=1e9, step=0.0):
    def change(force):
        quantised = np.round(force / step) * step if step else force
        return np.clip(quantised, low, high)

    return change


@pytest.mark.parametrize("step", [0.0, 10.0])
def test_flat_tops_are_detected_with_any_converter_and_reversals_are_none(step):
    (result,) = find_saturations(ride(change=clipped(high=400.0, step=step)))
    assert result.limit == 400.0 and 0.01 < result.share < 0.4
    assert [s.limit for s in find_saturations(ride(change=clipped(-300.0, 350.0, step)))] == [-300.0, 350.0]
    assert find_saturations(ride(change=clipped(step=step))) == ()
    assert find_saturations(ride(noise=0.0, change=clipped(step=50.0))) == ()


def test_little_saturation_is_a_note_and_its_ticks_are_not_used():
    limit = float(np.percentile(ride().channel("force").values, 97.0))
    recording = ride(change=clipped(high=limit))
    (note,) = check_recordings([recording], [], [])
    assert note.startswith(f"ride: force: the channel saturates: 3.0% of the samples at {limit:.5g} N")
    whole = make_trace(recording, simulated(recording))
    remaining = exclude_saturated_ticks(whole)
    flat = np.interp(whole.time_s, T, (recording.channel("force").values == limit).astype(float)) > 0.0
    assert not (remaining.usable & flat).any()
    assert 0.7 < remaining.usable.sum() / whole.usable.sum() < 0.97
    assert exclude_saturated_ticks(trace()).usable.sum() == trace().usable.sum()


# sign and unit ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "says", "remedy"),
    [
        (-1.0, "the simulated force has the opposite sign of the measured one", "invert the simulation's output"),
        (1e-3, "the simulation's force is in kN", "multiply the simulation's output by 1000"),
        (-1e-3, "opposite sign of the measured one and the simulation's force is in kN", "output by -1000"),
        (1e3, "the measured force is in kN", "set scale: 1000 for force in the signals file"),
        (1.0 / 4.4482, "the simulation's force is in lbf", "multiply the simulation's output by 4.44822"),
        (4.4482, "the measured force is in lbf", "set scale: 4.44822"),
        (9.80665, "the measured force is in kgf", "set scale: 9.80665"),
        (1.0 / 0.00980665, "the simulation's force is in gf", "output by 0.00980665"),
        (0.02, "check the units of the simulation", "expected the same damper"),
    ],
)
def test_wrong_signs_and_units_are_errors_with_a_remedy(factor, says, remedy):
    with pytest.raises(GapError) as raised:
        check_traces([trace(factor, fidelity=0.95)], SIM, "my:sim")
    text = str(raised.value)
    assert text.startswith("my:sim: ") and says in text and remedy in text and "\n" not in text
    if factor in (-1.0, 1e-3):  # in a rough simulation too
        with pytest.raises(GapError, match=says):
            check_traces([trace(factor, fidelity=0.2, noise=150.0)], SIM, "my:sim")


def test_the_gain_is_that_of_the_reduced_major_axis():
    result = compare_forces([trace(factor=0.5, fidelity=1.0, noise=0.0)])
    assert result.correlation == pytest.approx(1.0, abs=1e-6)
    assert result.gain == pytest.approx(2.0, rel=1e-4)


def test_a_constant_force_is_refused():
    recording = ride()
    with pytest.raises(GapError, match="the force of my:sim is constant"):
        check_traces([make_trace(recording, np.full(5000, 3.0))], SIM, "my:sim")


# range -----------------------------------------------------------------------------------------------------------


def model(**ranges):
    bounds = {"position_m": (-0.02, 0.02), "speed_m_s": (-0.6, 0.6), "current_A": (0.3, 0.9), **ranges}
    terms = tuple(Term(gain, (Factor(signal, 0),)) for signal, gain in (("speed", 900.0), ("current", 1.0)))
    return Model(make_sampling(500.0, 0.02), Polynomial(terms), Envelope(**bounds), (-3e4, 3e4))


def partly_missing():
    force = simulated(ride())
    force[1000:3000] = np.nan
    return [make_trace(ride(), force)]


def slow():
    one = trace()
    return [replace(one, inputs=replace(one.inputs, speed=0.01 * one.inputs.speed))]


def in_two_parts():
    whole = trace()
    late = whole.time_s > 6.0
    return [replace(whole, usable=whole.usable & late), replace(whole, usable=whole.usable & ~late)]


def unrelated():
    return [make_trace(ride(), 500.0 * np.sin(2 * np.pi * 3.1 * T))]


@pytest.mark.parametrize(
    ("traces", "ranges", "note"),
    [
        (lambda: [trace(1.0, 1.0)], None, ""),
        (lambda: [trace(0.6, 0.3)], None, ""),
        (lambda: [trace(2.5, 0.3)], None, ""),
        (in_two_parts, None, ""),
        (lambda: [trace()], {}, ""),
        (lambda: [trace()], {"current_A": (0.45, 0.9)}, r"^ride: .*outside the range my:sim .* on \(current 0\.4"),
        (partly_missing, None, r"^ride: 4.*the force of my:sim is missing"),
        (slow, None, "hardly moves"),
        (unrelated, None, "hardly correlates with the measured one"),
    ],
)
def test_doubts_are_notes(traces, ranges, note):
    simulation = SIM if ranges is None else ModelSimulation(model(**ranges))
    notes = check_traces(traces(), simulation, "my:sim")
    assert len(notes) == bool(note) and re.search(note, "".join(notes))


def test_a_force_held_at_its_envelope_is_a_note():
    simulation = ModelSimulation(replace(model(), force_envelope_N=(-50.0, 50.0)))
    (note,) = check_traces([trace()], AugmentedSimulation("a.json", simulation, Composition()), "a.json")
    assert note.startswith("ride: the force was held at its envelope (-50 to 50 N) for ")


@pytest.mark.parametrize("depth", [0, 2])
def test_no_overlap_is_refused_for_a_nested_model(depth):
    simulation = ModelSimulation(model(current_A=(1.2, 1.6)))
    for _ in range(depth):
        simulation = AugmentedSimulation("a.json", simulation, Composition())
    with pytest.raises(GapError, match=r"m\.json: outside the range .* 100% of the time, most in ride \(current"):
        check_traces([trace()], simulation, "m.json")


# current ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Lag(Effect):
    name, form, needs = "lag", "slow", "a changing current"
    parameters = (EffectParameter("lag_s", 0.0, 0.1, (0.01,), "of the valve"),)


@dataclass(frozen=True)
class FreeLag(Lag):
    form, needs = "free", ""


@dataclass(frozen=True)
class Gain(Effect):
    name, form, needs = "gain", "linear", "a current other than zero"
    parameters = (EffectParameter("gain", 0.5, 2.0, (1.1,), "of the current"),)


def test_a_constant_current_is_a_note_and_hides_effects():
    constant = [trace(current=0.6), trace(current=0.6, seed=2)]
    assert is_current_constant(constant)
    says = "the current stays at 0.6 A"
    assert check_traces(constant, SIM, "my:sim") == (f"{says}: effects of the valve are not visible",)
    assert find_invisible_effects([Lag(), Gain()], constant) == (("lag", f"it needs a changing current; {says}"),)
    assert find_invisible_effects([Lag(), FreeLag()], constant) == ()
    assert [name for name, _ in find_invisible_effects([Lag(), Gain()], [trace(current=0.0)])] == ["lag", "gain"]
    assert not is_current_constant([trace(current=0.3), trace(current=0.6)])  # differs between recordings
    assert find_invisible_effects([Lag(), Gain()], [trace()]) == ()


# effects of the user's own ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sound(Effect):
    """An effect that returns, or does, what its `result` gives."""

    name, form = "sound", "one"
    parameters = (EffectParameter("gain", 0.0, 2.0, (1.0,), "of the force"),)
    result: Callable = field(default=lambda force: force, compare=False)

    def respond(self, trace, inputs, force, values):
        return self.result(values[0] * force)


@dataclass(frozen=True)
class Nameless(Sound):
    name = ""


@dataclass(frozen=True)
class Outside(Sound):
    parameters = (EffectParameter("gain", 0.0, 2.0, (3.0,), "of the force"),)


def identified_on(**recording):
    """A model whose provenance names a recording."""
    known = {"identification": [{"recording": "learned", "sha256": "", **recording}]}
    return ModelSimulation(replace(model(), provenance=known))


def test_a_model_identified_on_a_real_recording_is_noted():
    simulation = identified_on(sha256="a1")
    traces = [replace(trace(), recording=replace(trace().recording, sha256=sha)) for sha in ("a1", "c3", "")]
    (note,) = seen_notes(traces, simulation, "model.json")
    assert "model.json was identified on seconds of this recording: it has learned part of the gap" in note
    assert seen_notes(traces[1:], simulation, "model.json") == ()
    assert seen_notes(traces, FunctionSimulation("f", force_of), "f") == ()


def test_a_renamed_copy_or_a_part_is_noted_also_inside_an_augmented_simulation():
    whole = ride("learned", 1)
    simulation = identified_on(marks=" ".join(recording_marks(whole)))
    wrapped = AugmentedSimulation("augmented.json", simulation, Composition())
    for recording in (replace(whole, name="renamed"), replace(whole.share(0.2, 0.8), name="part")):
        seen = replace(trace(), recording=recording, name=recording.name)
        (note,) = seen_notes([seen], wrapped, "augmented.json")
        assert note.startswith(f"{recording.name}: augmented.json was identified on seconds of this recording")
        assert "the gap found here is smaller than on new recordings" in note
    assert seen_notes([replace(trace(), recording=ride("new", 2))], wrapped, "augmented.json") == ()


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (lambda force: force[:-1], r"returned force of shape \(\d+,\); expected"),
        (lambda force: force * np.nan, "force that is not finite"),
        (lambda force: {}["no"], "raised KeyError: 'no'"),
    ],
)
def test_an_effect_of_the_user_is_accepted_or_its_failure_named(result, message):
    assert user_effect("test_gap_checks:Sound") == Sound()
    require_sound(Sound(), trace())
    with pytest.raises(GapError, match=f"effect 'sound': .*{message}"):
        require_sound(Sound(result), trace())


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("nowhere:Sound", "cannot be imported: ModuleNotFoundError"),
        ("test_gap_checks:ride", "not an effect"),
        ("test_gap_checks", "expected module:Class"),
        ("test_gap_checks:Nameless", "expected name, form and parameters"),
        ("test_gap_checks:Outside", r"gain has bounds \[0, 2\] and starts \(3.0,\)"),
        ("test_gap_checks:" + "x" * 900, "expected module:Class"),
    ],
)
def test_an_invalid_effect_is_an_error_of_one_line(spec, message):
    with pytest.raises(CesError, match=message) as raised:
        user_effect(spec)
    assert len(str(raised.value)) < 500
