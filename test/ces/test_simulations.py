"""Models and other simulations side by side: what takes one takes all; an estimator as scikit-learn has them."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hydraulic_models import hydraulic_model, make_hydraulic
from physical_examples import make_valve
from test_door import CURRENT, FORCE, MODEL, QUICK, ROAD, ROOT, T, X, columns, without_force

import ces
from ces_identify.options import list_options
from ces_identify.physical.quantities import ERRORS


def test_simulations_come_alone_in_a_list_or_by_name_and_recordings_by_globs(model):
    pair = ces.compare([model, MODEL, lambda t, x, i: 9.0 * x], str(ROOT / "bags/r[o]ad"))
    assert [one.name for one in pair.models[:2]] == ["polynomial_narx", "sample"] and "lambda" in pair.models[2].name
    twice = ces.compare([model, ces.Model.load(MODEL)], ROAD)
    assert [one.name for one in twice.models] == ["polynomial_narx", "polynomial_narx 2"]
    named = ces.characterise(ROAD, model=MODEL), ces.characterise(ROAD, model={"mine": model})
    assert [one.sources for one in named] == [("measured", "sample"), ("measured", "mine")]


def test_whatever_can_be_compared_can_be_simulated_and_validated(model, tmp_path):
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame(columns())

    def force(time_s, position_m, current_A, *, scale=1.0):
        return scale * 1500.0 * current_A * np.tanh(np.gradient(position_m, time_s) / 0.1)

    np.testing.assert_allclose(ces.simulate(force, T, X, CURRENT), FORCE)
    simulated = ces.simulate(force, table)
    assert simulated.index.equals(table.index)
    with pytest.warns(
        UserWarning, match="no program can open what names the simulation test_simulations:.*force: give"
    ):
        half = ces.calibrate(force, columns(force_N=0.5 * FORCE), out=tmp_path / "half")
    np.testing.assert_allclose(ces.simulate(half.simulation, table), 0.5 * FORCE, rtol=1e-3)
    half_too_much, (exact,) = ces.validate(lambda t, x, i: 1.5 * force(t, x, i), table), ces.validate(force, table)
    assert (exact.cost, exact.rms_N) == pytest.approx((0.0, 0.0), abs=1e-6)
    (pair,) = ces.compare([force, lambda t, x, i: 1.5 * force(t, x, i)], table).pairs
    assert half_too_much[0].cost == pytest.approx(-pair.pooled.value) and "unknown 5.5 s" in repr(half_too_much)
    assert np.isnan(exact.outside_share) and "out %" not in repr(half_too_much)  # a function has no envelope
    for factor, text in ((-1.0, "has the opposite sign"), (1e-3, "1e\\+03 times as large .*; are both in N")):
        with pytest.warns(UserWarning, match=text):
            ces.validate(lambda t, x, i, factor=factor: factor * force(t, x, i), table)
    np.testing.assert_array_equal(ces.simulate(MODEL, table), model.simulate(table))


def test_a_network_predicts_what_it_simulates_and_shows_its_quantities_as_numbers(tmp_path):
    pandas = pytest.importorskip("pandas")
    network = hydraulic_model(make_hydraulic(make_valve()))
    errors = {"selection": {ERRORS: {"quantities": {"Moving mass [kg]": 0.3, "Lead of the drive [ms]": 0.3}}}}
    replace(network, provenance=errors).save(tmp_path / "model.json")
    loaded = ces.Model.load(tmp_path / "model.json")
    jittered = T + np.random.default_rng(1).uniform(-6e-4, 6e-4, len(T))
    logged = columns(time_s=jittered, position_m=0.4 * X)
    np.testing.assert_array_equal(loaded.predict(logged, steps=3), loaded.simulate(logged))
    table = loaded.to_frame().set_index("quantity")
    assert all(table[name].dtype == float for name in ("value", "standard_error", "low", "high"))
    lead = table.loc["Lead of the drive"]
    assert (lead.unit, lead.high - lead.low) == ("ms", pytest.approx(2 * 1.96 * 0.3))
    assert table.loc["Moving mass", "low"] == 0.0 and pandas.isna(table.loc["Friction of the seals", "standard_error"])


def test_a_model_learns_the_force_of_a_teacher():
    def force(time_s, position_m, current_A):
        return 900.0 * np.gradient(position_m, time_s)

    learnt = ces.identify(columns(), teacher=force, **QUICK)
    assert learnt.evaluations[0].cost < 5.0 and "teacher" in learnt.provenance
    (row, *_) = learnt.provenance["teacher"]["cost_J_percent"]
    assert row["teacher_to_measured"] > 20.0 and learnt.provenance["teacher"]["simulation"].endswith("<locals>.force")
    assert ces.identify(without_force(), teacher=force, **QUICK).body == learnt.body


def test_the_parameters_of_the_estimator_are_the_options_of_the_program():
    own = set(inspect.signature(ces.DamperModel).parameters)
    assert own == {option.name for option in list_options()} - {"teacher"}
    with pytest.raises(TypeError, match="tim"):
        ces.DamperModel(tim=1)


def test_scikit_learn_can_search_over_recordings(road):
    parts = [road.part(0, 9), road.part(9, 18)]
    estimator = ces.DamperModel("polynomial", **QUICK)
    assert estimator.fit(parts).score(parts) > 0.7
    assert [len(force) for force in estimator.predict(parts)] == [len(part) for part in parts]
    assert len(estimator.predict(ROAD)) == len(road)
    rows = np.column_stack([T, X, CURRENT])
    assert np.isfinite(estimator.predict(rows)).all() and estimator.score(rows, FORCE) < 1.0
    assert estimator.score(columns()) == pytest.approx(estimator.score(without_force(), FORCE))
    with pytest.raises(ces.CesError, match="acts with the motion"):
        estimator.fit(np.column_stack([T, X, CURRENT]), -FORCE)
    selection = pytest.importorskip("sklearn.model_selection")
    search = selection.GridSearchCV(ces.DamperModel("polynomial", **QUICK), {"terms": [2, 3]}, cv=2).fit(parts)
    assert search.best_params_["terms"] in (2, 3) and search.best_score_ > 0.7
    with pytest.raises(ValueError, match="Invalid parameter 'foo'"):
        estimator.set_params(foo=1)


def test_a_script_hears_that_kernels_are_compiled_but_not_of_its_own(tmp_path):
    code = "import sys, numba, ces, ces_identify.scripting\n"
    code += "numba.njit(lambda x: x + 1)(1); print('own', file=sys.stderr)\n"
    code += "ces.Recording.load('bags/road')"
    more = {"env": {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, "text": True, "capture_output": True}
    before, after = subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, **more).stderr.split("own\n")
    assert not before and after.startswith("<string>:3: UserWarning: compiling numerical kernels, once on this"), after


@pytest.mark.parametrize("word", ["NA", "n/a", "-", ""])
def test_a_cell_that_says_missing_is_missing(word):
    pytest.importorskip("pandas")
    frame = ces.Recording.load(ROOT / "bags/road").part(0, 4).to_frame().dropna()
    text = frame.assign(force_N=frame["force_N"].astype(object))
    text.iloc[50, 2] = word
    assert len(ces.Recording.from_frame(text).channel("force")) == len(frame) - 1


def test_a_pair_names_the_better_one_in_its_frame():
    pytest.importorskip("pandas")
    both = {
        "poor": lambda t, x, i: 3000.0 * np.gradient(x, t),
        "good": lambda t, x, i: (2e3 + 3e3 * i) * np.gradient(x, t),
    }
    pairs = ces.compare(both, ces.Recording.load(ROOT / "bags/road").part(0, 12)).pairs
    assert list(pairs.to_frame()["better"]) == ["good"] and pairs[0].text == "good is better than poor"
