"""An augmented simulation survives saving and runs like any other; an invalid file is an error of one line."""

import json
import warnings
from dataclasses import dataclass

import numpy as np
import pytest
from example_effects import CurrentGain, Spring
from made_recordings import recording_of

from ces_data.recording import Channel, Recording
from ces_gap.augmented import MAX_BYTES, is_augmented, load_augmented, name_simulation, save_augmented
from ces_gap.baseline.learner import Dictionary, LearnedCorrection, Scales
from ces_gap.baseline.twin_fit import fit_twin
from ces_gap.effects.effect import FLUID, Composition, Effect, EffectParameter, Setting
from ces_gap.trace import make_trace
from ces_identify.simulations.simulation import FunctionSimulation, RecordedSimulation
from ces_observer.errors import CesError

RATE = 500.0
LIMIT = "effects[0]"


def damper(time_s, position_m, current_A):
    """A spring and a current-dependent dashpot on a smoothed position."""
    return 2000.0 * position_m + 900.0 * np.gradient(position_m, time_s) * (0.5 + current_A)


def open_here(spec):
    return FunctionSimulation(spec, damper)


@dataclass(frozen=True)
class Yielding(Effect):
    """A soft mount: the piston moves less by force over stiffness."""

    name = "yielding"
    form = "linear"
    stage = FLUID
    reruns = True
    parameters = (EffectParameter("stiffness_N_m", 1e5, 1e8, (1e6,), "of the mount", scale="inverse", magnitude=True),)

    def drive(self, trace, inputs, force, values):
        return inputs.with_position(inputs.position - force / values[0], trace.rate_Hz)


class Broken(Spring):
    """An effect whose arithmetic fails."""

    form = "broken"

    def respond(self, trace, inputs, force, values):
        return force + np.zeros(3)


PULL, GAIN = Setting(Spring(), (3000.0,)), Setting(CurrentGain(), (1.3,))


def recording(seconds=6.0, seed=0):
    t = np.arange(round(seconds * RATE)) / RATE
    position = 0.01 * np.sin(2 * np.pi * 2.0 * t) + 0.003 * np.sin(2 * np.pi * 5.1 * t + seed)
    current = 0.6 + 0.2 * np.sin(2 * np.pi * 0.9 * t + seed)
    return recording_of(t, start_ns=10**18, position=position, current=current)


def save(folder, *settings, spec="here:damper", **more):
    path = folder / "augmented.json"
    save_augmented(path, spec, Composition(settings), **more)
    return path


def inner(force):
    """The samples away from the ends, where filters settle."""
    return force[100:-100]


def test_the_loaded_simulation_has_the_saved_physics(tmp_path):
    ride = recording()
    x, i = ride.channel("position").values, ride.channel("current").values
    t = (ride.channel("position").stamps_ns - ride.channel("position").stamps_ns[0]) * 1e-9
    augmented = load_augmented(save(tmp_path, PULL, GAIN), open_here)
    expected = damper(t, x, 1.3 * i) + 3000.0 * x
    difference = inner(augmented.force(ride) - expected)
    assert np.abs(difference).max() < 0.004 * np.abs(expected).max()
    assert np.abs(inner(damper(t, x, i) - expected)).max() > 0.2 * np.abs(expected).max()


def test_an_effect_that_needs_the_force_gets_the_simulated_one(tmp_path):
    ride, stiffness = recording(), 4e5
    x, i = ride.channel("position").values, ride.channel("current").values
    t = np.arange(len(x)) / RATE
    augmented = load_augmented(save(tmp_path, Setting(Yielding(), (stiffness,))), open_here)
    own = damper(t, x, i)
    expected = damper(t, x - own / stiffness, i)
    assert inner(augmented.force(ride) - expected).std() < 0.03 * inner(own - expected).std()


def test_without_a_simulated_force_the_result_is_nan(tmp_path):
    ride = recording()
    spoiled = ride.channel("position").values.copy()
    spoiled[1000:1010] = np.nan
    channel = ride.channel("position")
    gapped = Recording("gap", {**ride.channels, "position": Channel("position", "m", channel.stamps_ns, spoiled)})
    force = load_augmented(save(tmp_path, PULL), open_here).force(gapped)
    np.testing.assert_array_equal(np.flatnonzero(~np.isfinite(force)), np.arange(1000, 1010))
    own = load_augmented(save(tmp_path), open_here).force(ride)  # without effects
    np.testing.assert_array_equal(own, open_here("x").force(ride))


def test_values_class_and_provenance_survive_a_round_trip(tmp_path):
    path = save(tmp_path, PULL, GAIN, provenance={"real": [{"recording": "road", "sha256": "ab"}]})
    augmented = load_augmented(path, open_here)
    assert augmented.composition == Composition((PULL, GAIN))
    assert augmented.provenance["real"] == [{"recording": "road", "sha256": "ab"}]
    assert json.loads(path.read_text())["effects"][0]["class"] == "example_effects:Spring"
    assert is_augmented(path)


def constant_correction(ride):
    """A correction that always adds 7 N."""
    trace = make_trace(ride, open_here("x").force(ride))
    dictionary = Dictionary(Scales((0.0, 0.01), 0.1, (0.6, 0.1), (0.0, 100.0), True))
    weights = np.zeros(dictionary.features(trace, trace.inputs, trace.simulated).shape[1])
    weights[:9] = 7.0  # hats over the speed, which sum to one
    return LearnedCorrection(dictionary, weights)


def stamps(ride):
    return ride.channel("position").stamps_ns


def test_the_correction_is_added(tmp_path):
    ride = recording()
    correction = constant_correction(ride)
    added = load_augmented(save(tmp_path, correction=correction), open_here).force(ride) - open_here("x").force(ride)
    np.testing.assert_allclose(inner(added), 7.0, atol=1e-6)


@pytest.mark.slow
def test_recorded_predictions_change_through_the_twin(tmp_path):
    ride = recording(4.0)
    own = open_here("x").force(ride)
    force = Channel("force", "N", stamps(ride), own)
    taught = make_trace(Recording("taught", {**ride.channels, "force": force}), own)
    twin = fit_twin([taught])
    path = save(tmp_path, GAIN, spec="topic:/p", twin=twin, is_recorded=True)
    augmented = load_augmented(path, lambda spec: RecordedSimulation(spec.removeprefix("topic:")))
    bag = Recording("bag", {**ride.channels, "sim_force": Channel("sim_force", "N", stamps(ride), own)})
    trace = make_trace(bag, own)
    more = trace.inputs.with_current(1.3 * trace.inputs.current)
    predicted = twin.force(trace, more) - twin.force(trace, trace.inputs)
    np.testing.assert_allclose(augmented.force(bag) - own, predicted, atol=1e-9)
    assert np.corrcoef(inner(predicted), inner(damper_at(1.3, ride) - own))[0, 1] > 0.7


def test_jumps_of_the_current_stay_sharp(tmp_path):
    """The added force has the rate of the position, four times that of the diagnosis."""
    seconds = np.arange(8000) / (4.0 * RATE)
    position, current = 0.01 * np.sin(2 * np.pi * 2.0 * seconds), np.where(seconds % 0.4 < 0.2, 0.3, 1.2)
    ride = recording_of(seconds, start_ns=10**18, position=position, current=current)
    force = load_augmented(save(tmp_path, GAIN), open_here).force(ride)
    off = inner(force - damper_at(1.3, ride))
    assert np.sqrt(np.mean(off**2)) < 0.02 * np.std(inner(damper_at(1.3, ride) - damper_at(1.0, ride)))


def damper_at(gain, ride):
    seconds = (stamps(ride) - stamps(ride)[0]) * 1e-9
    return damper(seconds, ride.channel("position").values, gain * ride.channel("current").values)


@pytest.mark.parametrize("variables", ["", ":position=x,force=f"])
def test_the_simulation_is_found_from_any_working_directory(tmp_path, monkeypatch, variables):
    (tmp_path / "out").mkdir()
    (tmp_path / "sims").mkdir()
    (tmp_path / "sims" / "d.fmu").write_bytes(b"PK")
    monkeypatch.chdir(tmp_path)
    path = save(tmp_path / "out", PULL, spec="sims/d.fmu" + variables)
    assert json.loads(path.read_text())["sim"]["spec"] == "../sims/d.fmu" + variables
    monkeypatch.chdir("/")
    opened = []
    load_augmented(path, lambda spec: opened.append(spec) or open_here(spec))
    assert opened[0].endswith(variables)
    found = tmp_path / "out" / opened[0].removesuffix(variables)
    assert found.resolve() == tmp_path / "sims" / "d.fmu"


def test_a_changed_or_missing_simulation_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.yaml").write_text("made: up\n")
    path = save(tmp_path, PULL, spec="rig.yaml")
    (tmp_path / "rig.yaml").write_text("made: otherwise\n")
    with pytest.raises(CesError, match=r"its simulation .*rig\.yaml has changed since; run `ces diagnose` again"):
        load_augmented(path, open_here)
    (tmp_path / "rig.yaml").unlink()
    with pytest.raises(CesError, match="is missing; restore it"):
        load_augmented(path, open_here)


def change_file(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return path


def put(*keys, value):
    def change(document):
        for key in keys[:-1]:
            document = document[key]
        document[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("schema", value="ces-augmented/9"), "schema is 'ces-augmented/9'; expected 'ces-augmented/1'"),
        (put("effects", value={}), r"effects is \{\}; expected a list of 0 to 20 mappings"),
        (put("effects", 0, "parameters", "stiffness_N_m", value=2e9), "a number from 0 to 100000"),
        (put("effects", 0, "parameters", value={}), "key 'stiffness_N_m' is missing"),
        (put("effects", 0, "parameters", "mass_kg", value=1.0), "unknown key 'mass_kg'; known are stiffness_N_m"),
        (put("effects", 0, "form", value="cubic"), r"class is spring \(linear\); expected spring \(cubic\)"),
        (put("effects", 0, "class", value="example_effects:Gone"), "cannot be imported: AttributeError"),
        (put("correction", value={"weights": [1.0]}), "correction: key 'dictionary' is missing"),
        (put("correction", value=[]), "correction is .*; expected a mapping"),
        (put("sim", value={}), "key 'spec' is missing"),
        (lambda document: document.pop("provenance"), "key 'provenance' is missing"),
        (lambda document: document["effects"][0].pop("class"), "unknown effect 'spring'"),
    ],
)
def test_an_invalid_file_is_an_error_of_one_line(tmp_path, change, message):
    path = change_file(save(tmp_path, PULL), change)
    with pytest.raises(CesError, match=message) as raised:
        load_augmented(path, open_here)
    assert str(raised.value).startswith(str(path))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not a JSON file"),
        ('{"schema": NaN}', "expected a finite number"),
        ("[]", "expected an object"),
        ('{"schema": "ces-augmented/1"}' + " " * MAX_BYTES, f"expected at most|at most {MAX_BYTES}"),
    ],
    ids=["cut off", "not finite", "a list", "too large"],
)
def test_a_file_that_is_no_augmented_simulation_is_refused(tmp_path, text, message):
    path = tmp_path / "a.json"
    path.write_text(text)
    assert not is_augmented(path)
    with pytest.raises(CesError, match=message):
        load_augmented(path, open_here)


def test_weights_that_do_not_match_the_features_are_refused(tmp_path):
    correction = constant_correction(recording())
    spoiled = LearnedCorrection(correction.dictionary, correction.weights[:-1])
    with pytest.raises(CesError, match=r"correction: weights are \d+ numbers; expected \d+"):
        load_augmented(save(tmp_path, correction=spoiled), open_here)


def test_a_force_that_is_not_finite_is_an_error(tmp_path):
    correction = constant_correction(recording())
    wild = LearnedCorrection(correction.dictionary, np.full_like(correction.weights, 1e308))
    with np.errstate(all="ignore"), pytest.raises(CesError, match=r"the force is not finite at 0\.\d+ s"):
        load_augmented(save(tmp_path, correction=wild), open_here).force(recording())


def test_a_failing_effect_of_the_user_is_an_error(tmp_path):
    path = save(tmp_path, Setting(Broken(), (1.0,)))
    with pytest.raises(CesError, match="cannot be run: ValueError: operands could not be broadcast"):
        load_augmented(path, open_here).force(recording())


def test_a_simulation_that_no_program_finds_by_its_name_is_warned_of(tmp_path):
    for spec in ("__main__:force", f"{__name__}:<lambda>", "model"):
        with pytest.warns(UserWarning, match="no program can open what names the simulation"):
            name_simulation(spec, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for spec in ("topic:/force", "not_yet_imported:force", f"{__name__}:{damper.__name__}"):
            name_simulation(spec, tmp_path)
