"""Comparison of models: names, training data, divergence, envelopes, and differences of costs at known truth."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from residual_series import RATE, coloured

from ces import Recording as DeskRecording
from ces import compare as compare_models
from ces_data.checks.content import recording_marks
from ces_data.reading import read_recording
from ces_identify.comparison.compared_models import (
    BETTER,
    DIVERGED,
    NO_TEST,
    SAME,
    SHORT,
    TEST,
    TRAINED,
    UNKNOWN,
    AlignedRecording,
    compare_pairs,
    find_differences,
    make_compared_model,
    pooled_costs,
)
from ces_identify.comparison.comparison import Comparison, compare, name_sources, score_models
from ces_identify.numerics.correlation import adjusted_p_values, step_levels
from ces_identify.prepare.cost import cost
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation
from ces_observer.errors import CesError
from ces_observer.model import load_model

ROOT = Path(__file__).parents[3]
MODEL = load_model(ROOT / "config/models/sample.json")


def aligned(errors, seed=0, name="made", diverged=None):
    """A recording of a force of variance 20² N² on which the models make these `errors` (models, n)."""
    errors = np.asarray(errors, dtype=float)
    models, n = errors.shape
    measured = 20.0 * coloured(n, 0.98, seed + 10**6)
    time_s, still = np.arange(n) / RATE, np.zeros(n)
    lost = diverged or (False,) * models
    return AlignedRecording(
        name, f"hash of {name}", "", RATE, time_s, still, still, measured, measured - errors, np.ones(n, bool),
        lost, ((),) * models, dict.fromkeys(("position", "speed", "current"), (0.0, 0.0)),
    )  # fmt: skip


def two_models(n, seed, ratio=1.0, pole=0.9):
    """Errors (2, n) with a common part, whose own parts have sizes `ratio` and 1."""
    common, first, second = (coloured(n, pole, 3 * seed + i) for i in range(3))
    return np.stack([common + ratio * first, common + second])


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
    marks = " ".join(recording_marks(sine.share(0.0, 0.7)))
    facts = {"identification": [{"recording": "sine", "sha256": sine.sha256, "share": [0.0, 0.7], "marks": marks}]}
    model = make_compared_model("m", ModelSimulation(replace(MODEL, provenance=facts)))
    rest = sine.part(0.75 * sine.duration_s)
    assert model.use_of(sine) == TRAINED and model.use_of(rest) == TEST
    copy = replace(sine, sha256="hash of a re-encoded bag")  # marks of the force show it
    assert model.use_of(copy) == TRAINED
    assert make_compared_model("m", ModelSimulation(replace(MODEL, provenance={}))).use_of(rest) == UNKNOWN


def test_models_of_different_rates_have_forces_at_the_same_stamps(sine):
    found = compare_models({"a": MODEL, "b": at_rate(500.0)}, sine)
    (recording,) = found.recordings
    assert recording.forces.shape == (2, len(sine.channel("position")))
    assert np.isfinite(recording.errors).all()
    assert recording.time_s[recording.scored][0] >= 0.5
    assert found.pairs[0].verdict == BETTER and found.pairs[0].better == 0


def test_a_held_force_has_its_cost_and_is_named(sine):
    tight = replace(MODEL, force_envelope_N=(-300.0, 300.0))
    found = compare_models({"a": MODEL, "b": tight}, sine)
    assert found.models[0].pooled < 10.0 and 30.0 < found.models[1].pooled < 100.0
    assert found.pair(0, 1).better == 0
    (note,) = (note for note in found.notes() if note.startswith("b, "))
    held = r"the force was held at its envelope \(-300 to 300 N\) for [\d.]+ % of the time, first at 0\.\d\d s"
    assert re.fullmatch(f"b, sine_4hz: {held}: the model does not fit this recording", note)


def test_a_recording_beyond_the_envelope_is_named(sine):
    narrow = replace(MODEL, envelope=replace(MODEL.envelope, speed_m_s=(-0.01, 0.01)))
    found = compare_models({"a": MODEL, "b": narrow}, sine)
    (note,) = (note for note in found.notes() if "envelope of b" in note)
    assert note.startswith("sine_4hz leaves the envelope of b for ")
    assert "speed -" in note and "model knows -0.01" in note


def test_a_simulation_without_provenance_is_not_called_tested(sine):
    function = FunctionSimulation("rig", lambda t, x, i: 3000.0 * np.gradient(x, t) * (0.3 + i))
    found = compare_models({"a": MODEL, "rig": function}, sine)
    assert any("no file says what rig was identified on" in note for note in found.notes())
    assert found.models[1].force_bound_N is None


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
    with pytest.raises(CesError, match="models: 1 given; expected 2 to 40"):
        compare_models({"a": MODEL}, sine)
    twice = [make_compared_model("a", ModelSimulation(MODEL))] * 2
    with pytest.raises(CesError, match="two models are named 'a'"):
        compare(twice, [sine])
    with pytest.raises(CesError, match="the same recording: its seconds would count twice"):
        compare_models({"a": MODEL, "b": MODEL}, [sine, sine])
    t = np.arange(2000) / 1000.0
    silent = DeskRecording.from_arrays(t, 0.01 * np.sin(20 * t), np.full(2000, 0.4), name="silent")
    with pytest.raises(CesError, match="silent: no force was recorded, which is needed here"):
        compare_models({"a": MODEL, "b": MODEL}, silent)
    brief = DeskRecording.from_arrays(t[:520], 0.01 * np.sin(20 * t[:520]), np.full(520, 0.4), t[:520], name="brief")
    with pytest.raises(CesError, match=r"brief: .* samples at which all models and the measurement have a force"):
        compare_models({"a": MODEL, "b": MODEL}, brief)


def test_more_models_and_recordings_than_charts_can_show():
    """Tables hold all of them, charts the best models, tests first, and the page says what is left out."""
    errors = np.stack([(1.0 + 0.1 * k) * coloured(6_000, 0.9, k) for k in range(10)])
    made = [aligned(errors[:, ::-1] if n else errors, n, f"r{n}") for n in range(4)]
    models = [make_compared_model(f"m{k}", ModelSimulation(MODEL)) for k in range(10)]
    uses = [[TRAINED, TEST, TEST, TEST]] * 10
    results = score_models(models, made, uses)
    pairs = compare_pairs([m.name for m in models], made, uses)
    found = Comparison(tuple(results), tuple(made), tuple(pairs))
    assert found.drawn == tuple(range(8)) and found.drawn_recordings == (1, 2)
    models_left, recordings_left = found.notes_on_charts()
    assert "tables all 10; not in the charts: m8 and m9" in models_left
    assert "2 of 4 recordings, the tables all; not in the charts: r0 and r3" in recordings_left
    assert len(pairs) == 45


def test_a_simulation_that_grows_without_end_has_no_cost(sine):
    def explode(t, x, i):
        return 1000.0 * np.sign(np.gradient(x, t)) * np.exp(np.minimum(20.0 * t, 200.0))

    models = {"a": MODEL, "c": at_rate(700.0)}
    found = compare_models({**models, "wild": FunctionSimulation("wild", explode)}, sine)
    assert found.models[2].pooled == float("inf") and found.pair(0, 2).verdict == DIVERGED
    assert any("wild diverged, to more than 1000 times the measured force" in note for note in found.notes())
    assert found.pair(0, 1).verdict == BETTER  # the others are compared as without it
    assert found.models[0].pooled == pytest.approx(compare_models(models, sine).models[0].pooled)


ALPHA = 0.05
ALL = [(a, b) for a in range(4) for b in range(a + 1, 4)]


def slow_models(n, seed, slow_s, models=2):
    """Errors of equal cost whose sizes change slowly, with a correlation time of `slow_s`."""
    pole = np.exp(-1.0 / (slow_s * RATE))
    sizes = [np.exp(0.5 * coloured(n, pole, 100 * seed + i)) for i in range(models)]
    own = [coloured(n, 0.98, 100 * seed + 50 + i) for i in range(models)]
    return coloured(n, 0.98, 100 * seed + 99) + np.array(sizes) * own


def find(errors, seed=0):
    return find_differences([aligned(errors, seed)], [(0, 1)])[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "count", "limit", "without_bound"),
    [
        (lambda s: two_models(15_000, s, pole=0.5), 60, 0.05, 0.0),
        (lambda s: two_models(15_000, s, pole=0.98), 60, 0.05, 0.0),
        (lambda s: slow_models(5_000, s, 1.0), 80, 0.06, 0.06),
        (lambda s: slow_models(15_000, s, 3.0), 80, 0.06, 0.06),
    ],
    ids=["errors of 2 ticks", "errors of 50 ticks", "slow changes in 10 s", "slow changes in 30 s"],
)
def test_models_of_equal_cost_are_seldom_called_different(make, count, limit, without_bound):
    differences = [find(make(seed), seed) for seed in range(count)]
    assert np.mean([difference.p_value() < ALPHA for difference in differences]) <= limit
    fast = [difference.error.fast_p_value(difference.value) < ALPHA for difference in differences]
    assert np.mean(fast) >= without_bound  # what the bound on slow changes forbids


@pytest.mark.slow
def test_several_recordings_and_several_models_of_equal_cost():
    def any_false(seed):
        recordings = [aligned(slow_models(5_000, 10 * seed + i, 2.0, 4), i, f"r{i}") for i in range(3)]
        return min(adjusted_p_values([one.p_value() for one in find_differences(recordings, ALL)])) < ALPHA

    assert np.mean([any_false(seed) for seed in range(34)]) <= 0.06


def test_a_difference_of_a_few_percent_is_found_in_a_minute():
    assert np.mean([find(two_models(30_000, s, 1.2), s).p_value() < ALPHA for s in range(20)]) >= 0.8


def test_too_short_is_what_only_the_bound_on_slow_changes_forbids():
    found = [find(two_models(5_000, s, 1.3, pole=0.98), s) for s in range(60)]  # 10 s
    short = [one for one in found if one.is_too_short(ALPHA)]
    assert 10 <= len(short) <= 50
    assert all(one.p_value() >= ALPHA > one.error.fast_p_value(one.value) for one in short)
    assert all(one.p_value() < ALPHA or one.error.fast_p_value(one.value) >= ALPHA for one in found if one not in short)


def test_common_errors_cancel():
    """A large common error cancels: without pairing, the error of the difference is several times larger."""
    common = 30.0 * coloured(15_000, 0.9, 1)
    errors = np.stack([common, common + 1.5 * coloured(15_000, 0.5, 2)])
    shifted = np.stack([errors[0], np.roll(errors[1], 5_000)])
    paired, apart = find(errors), find(shifted)
    assert paired.value == pytest.approx(apart.value)
    assert 4.0 * np.diff(paired.interval(0.95)) < np.diff(apart.interval(0.95))


def test_difference_and_pooled_cost_are_those_of_the_definition():
    recordings = [aligned(two_models(5_000, s, 1.3), s, f"r{s}") for s in (1, 2)]
    whole = np.concatenate([r.measured - r.measured.mean() for r in recordings])
    expected = [cost(whole, whole - np.concatenate([r.errors[i] for r in recordings])) for i in range(2)]
    np.testing.assert_allclose(pooled_costs(recordings), expected, rtol=1e-4)
    (found,) = find_differences(recordings, [(0, 1)])
    assert found.value == pytest.approx(expected[0] - expected[1], abs=1e-3)
    low, high = found.interval(0.95)
    assert low < found.value < high


def test_the_interval_excludes_zero_exactly_if_the_test_is_significant():
    for seed in range(12):
        found = find(two_models(20_000, seed, 1.2), seed)
        low, high = found.interval(0.95)
        assert (found.p_value() < ALPHA) == (low > 0.0 or high < 0.0)


@pytest.mark.parametrize("ticks", [300, 2_500])
def test_no_answer_for_a_few_seconds(ticks):
    difference = find(two_models(ticks, 1))
    assert difference.is_too_short(ALPHA) and (difference.error is None) == (ticks < 500)


def test_equal_forces_cannot_differ():
    found = find(two_models(5_000, 1)[[0, 0]])
    assert (found.value, found.p_value(), found.interval(0.95)) == (0.0, 1.0, (0.0, 0.0))
    assert not found.is_too_short(ALPHA)


@pytest.mark.parametrize(
    "p_values", [[0.01, 0.04, 0.03, 0.005], [0.2, 0.001, 0.024], [0.6, 0.7], [0.001, 0.002, 0.003]]
)
def test_level_of_each_step_agrees_with_the_adjusted_values(p_values):
    levels = step_levels(p_values, 0.05)
    assert [p < level for p, level in zip(p_values, levels, strict=True)] == [
        q < 0.05 for q in adjusted_p_values(p_values)
    ]
