"""Comparison of models through the Python API: names, training data, divergence, envelopes, times."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_errors import aligned, two_models
from residual_series import coloured

from ces_data.checks.content import recording_marks
from ces_identify import compare_models, make_recording, read_recording
from ces_identify.comparison.compared_models import (
    TEST,
    TRAINED,
    UNKNOWN,
    make_compared_model,
    name_sources,
)
from ces_identify.comparison.comparison import Comparison, compare, score_models
from ces_identify.comparison.pair_results import BETTER, DIVERGED, NO_TEST, SAME, SHORT, compare_pairs
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation
from ces_observer.errors import CesError
from ces_observer.model import load_model

ROOT = Path(__file__).parents[3]
MODEL = load_model(ROOT / "config/models/sample.json")


@pytest.fixture(scope="module")
def sine():
    return read_recording(ROOT / "bags/sine_4hz")


def at_rate(rate_Hz):
    """The sample model run at another rate, at which its lags are wrong."""
    return replace(MODEL, sampling=replace(MODEL.sampling, rate_Hz=rate_Hz))


@pytest.mark.parametrize(
    ("sources", "names"),
    [
        (["a.json", "b/c.json"], ["a", "c"]),
        (["one/model.json", "two/model.json", "other.json"], ["one/model", "two/model", "other"]),
        (["x/one/m.json", "y/one/m.json"], ["x/one/m", "y/one/m"]),
        (["damper.fmu", "module:force", "topic:/p"], ["damper.fmu", "module:force", "p"]),
    ],
)
def test_names_are_short_and_differ(sources, names):
    assert name_sources(sources) == names


def test_part_of_a_recording_after_the_split_is_a_test(sine):
    facts = {"identification": [{"recording": "sine", "sha256": sine.sha256, "share": [0.0, 0.7]}]}
    model = make_compared_model("m", ModelSimulation(replace(MODEL, provenance=facts)))
    assert model.use_of(sine, (0.0, 1.0)) == TRAINED
    assert model.use_of(sine, (0.7, 1.0)) == TEST
    copy = replace(sine, sha256="hash of a re-encoded bag")  # marks of the force show it
    facts["identification"][0]["marks"] = " ".join(recording_marks(sine.part(0.0, 0.7)))
    assert model.use_of(copy, (0.0, 1.0)) == TRAINED and model.use_of(copy, (0.75, 1.0)) == TEST
    assert make_compared_model("m", ModelSimulation(replace(MODEL, provenance={}))).use_of(sine, (0.7, 1.0)) == UNKNOWN


def test_models_of_different_rates_have_forces_at_the_same_stamps(sine):
    found = compare_models({"a": MODEL, "b": at_rate(500.0)}, sine, timing=False)
    (recording,) = found.recordings
    assert recording.forces.shape == (2, len(sine.channel("position")))
    assert np.isfinite(recording.errors).all()
    assert recording.time_s[recording.scored][0] >= 0.5
    assert found.pairs[0].verdict == BETTER and found.pairs[0].better == 0
    assert found.models[0].tick is None and found.machine == ""


def test_only_the_part_is_scored(sine):
    found = compare_models({"a": MODEL, "b": at_rate(700.0)}, sine, part=(0.5, 1.0), timing=False)
    (recording,) = found.recordings
    assert recording.time_s[recording.scored][0] == pytest.approx(0.5 * recording.time_s[-1], rel=1e-3)


def test_a_model_that_diverges_has_no_cost_and_spoils_none_of_the_others(sine):
    tight = replace(MODEL, force_envelope_N=(-300.0, 300.0))
    found = compare_models({"a": MODEL, "b": tight, "c": at_rate(700.0)}, sine, timing=False)
    assert np.isinf(found.models[1].pooled) and np.isfinite(found.models[0].pooled)
    assert [pair.verdict for pair in found.pairs].count(DIVERGED) == 2
    assert found.pair(0, 2).verdict == BETTER
    alone = compare_models({"a": MODEL, "c": at_rate(700.0)}, sine, timing=False)
    assert found.models[0].pooled == pytest.approx(alone.models[0].pooled)
    assert "b left its force envelope on sine_4hz: it has no cost there" in found.notes()


def test_a_recording_beyond_the_envelope_is_named(sine):
    narrow = replace(MODEL, envelope=replace(MODEL.envelope, position_m=(-0.01, 0.01)))
    found = compare_models({"a": MODEL, "b": narrow}, sine, timing=False)
    (note,) = (note for note in found.notes() if "envelope of b" in note)
    assert note.startswith("sine_4hz leaves the envelope of b for ")
    assert "position -0.018" in note and "model knows -0.01" in note


def test_a_simulation_without_provenance_is_not_called_tested(sine):
    function = FunctionSimulation("rig", lambda t, x, i: 3000.0 * np.gradient(x, t) * (0.3 + i))
    found = compare_models({"a": MODEL, "rig": function}, sine)
    assert any("no file says what rig was identified on" in note for note in found.notes())
    assert found.models[1].tick is None and found.models[1].force_bound_N is None
    assert found.models[0].tick.fastest_us <= found.models[0].tick.median_us <= found.models[0].tick.slowest_us


def test_verdicts_at_known_truth():
    n = 15_000
    errors = np.concatenate([two_models(n, 1, 1.6), two_models(n, 1)[1:], np.full((1, n), np.nan)])
    errors[2] = errors[1]
    recording = aligned(errors, diverged=(False, False, False, True))
    uses = [["test"], ["test"], ["identified on"], ["test"]]
    found = {(p.first, p.second): p for p in compare_pairs("abcd", [recording], uses)}
    assert (found[0, 1].verdict, found[0, 1].better) == (BETTER, 1)  # neither was identified on it
    assert found[1, 2].verdict == NO_TEST and found[1, 2].pooled.value == 0.0 and found[1, 2].p_value is None
    assert found[0, 3].verdict == DIVERGED
    short = aligned(two_models(300, 1))
    assert compare_pairs("ab", [short], [["test"], ["test"]])[0].verdict == SHORT
    same = aligned(errors[1:3])
    assert compare_pairs("ab", [same], [["test"], ["test"]])[0].verdict == SAME


def test_holm_widens_intervals_of_several_pairs():
    n = 30_000
    errors = np.concatenate([two_models(n, 1, 1.6), two_models(n, 2, 1.1), two_models(n, 3)])
    alone = compare_pairs("ab", [aligned(errors[:2])], [["test"]] * 2)[0]
    among = compare_pairs("abcdef", [aligned(errors)], [["test"]] * 6)[0]
    assert among.p_value > alone.p_value
    assert among.pooled.high - among.pooled.low > alone.pooled.high - alone.pooled.low


def test_mistakes(sine):
    with pytest.raises(CesError, match="1 models to compare; expected 2 to 40"):
        compare_models({"a": MODEL}, sine)
    twice = [make_compared_model("a", ModelSimulation(MODEL))] * 2
    with pytest.raises(CesError, match="two models are named 'a'"):
        compare(twice, [sine])
    with pytest.raises(CesError, match="the same recording: its seconds would count twice"):
        compare_models({"a": MODEL, "b": MODEL}, [sine, sine])
    t = np.arange(2000) / 1000.0
    silent = make_recording(t, 0.01 * np.sin(20 * t), np.full(2000, 0.4), name="silent")
    with pytest.raises(CesError, match="silent: no measured force to compare with"):
        compare_models({"a": MODEL, "b": MODEL}, silent)
    brief = make_recording(t[:520], 0.01 * np.sin(20 * t[:520]), np.full(520, 0.4), t[:520], name="brief")
    with pytest.raises(CesError, match=r"brief: .* samples at which all models and the measurement have a force"):
        compare_models({"a": MODEL, "b": MODEL}, brief)


def test_more_models_and_recordings_than_charts_can_show():
    """Tables hold all of them, charts the best models, tests first, and the page says what is left out."""
    errors = np.stack([(1.0 + 0.1 * k) * coloured(6_000, 0.9, k) for k in range(10)])
    made = [aligned(errors[:, ::-1] if n else errors, n, f"r{n}") for n in range(4)]
    models = [make_compared_model(f"m{k}", ModelSimulation(MODEL)) for k in range(10)]
    uses = [[TRAINED, TEST, TEST, TEST]] * 10
    results = score_models(models, made, uses, {})
    pairs = compare_pairs([m.name for m in models], made, uses)
    found = Comparison(tuple(results), tuple(made), tuple(pairs), (0.0, 1.0), "")
    assert found.drawn == tuple(range(8)) and found.drawn_recordings == (1, 2)
    models_left, recordings_left = found.notes_on_charts()
    assert "tables all 10; not in the charts: m8 and m9" in models_left
    assert "2 of 4 recordings, the tables all; not in the charts: r0 and r3" in recordings_left
    assert len(pairs) == 45


def test_a_simulation_that_grows_without_end_has_no_cost(sine):
    def explode(t, x, i):
        return 1000.0 * np.sign(np.gradient(x, t)) * np.exp(np.minimum(20.0 * t, 200.0))

    found = compare_models({"a": MODEL, "wild": FunctionSimulation("wild", explode)}, sine, timing=False)
    assert found.models[1].pooled == float("inf") and found.pairs[0].verdict == DIVERGED
    assert any("wild diverged, to more than 1000 times the measured force" in note for note in found.notes())
    assert found.models[0].pooled < 10.0
