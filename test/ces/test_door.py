"""What `import ces` gives: functions and objects with methods, light to import, and one line for each mistake."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ces
import ces_observer
from ces_data.samples import without_spikes
from ces_identify.scripting import progress
from ces_observer.estimator import Estimator

ROOT = Path(__file__).resolve().parents[2]
ROAD, MODEL = ROOT / "bags/road", ROOT / "config/models/sample.json"
QUICK = {"time": 5.0, "terms": 3, "starts": 1, "band": False}
T = np.arange(0.0, 6.0, 0.002)
X = 0.02 * np.sin(2 * np.pi * 2.0 * T) * np.sin(0.7 * T)
CURRENT = 0.5 + 0.2 * np.sign(np.sin(0.9 * T))
FORCE = 1500.0 * CURRENT * np.tanh(np.gradient(X, T) / 0.1)


def columns(**more):
    return {"time_s": T, "position_m": X, "current_A": CURRENT, "force_N": FORCE} | more


def without_force():
    return {name: values for name, values in columns().items() if name != "force_N"}


def test_the_door_shows_its_names_and_no_others():
    assert dir(ces) == ces.__all__ == sorted(ces.__all__)
    for name in ces.__all__:
        assert inspect.getdoc(getattr(ces, name)), name


def test_the_page_has_every_name_and_every_keyword():
    page = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    for name in ces.__all__:
        value = getattr(ces, name)
        assert f"`{name}" in page, name
        if inspect.isfunction(value):
            (signature,) = re.findall(rf"^\| `{name}\((.*)\)` \|", page, re.MULTILINE)
            written = [part.partition("=")[0].strip("* ") for part in re.split(r",\s*(?![^(]*\))", signature)]
            assert [w for w in written if w] == list(inspect.signature(value).parameters), name


def test_importing_it_imports_nothing_heavy():
    code = "import sys, ces; assert not {'numba', 'scipy', 'numpy', 'matplotlib', 'pandas'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_it_has_a_version():
    assert ces.__version__ == ces_observer.__version__


def test_packages_are_marked_as_typed():
    for package in ("ces", "ces_observer", "ces_identify", "ces_gap", "ces_rig", "ces_cli"):
        assert (ROOT / package / "py.typed").is_file()


def test_a_table_becomes_a_model_that_predicts_draws_reports_and_runs(tmp_path):
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({"Time (ms)": 1e3 * T, "Stroke [mm]": 1e3 * X, "I_A": CURRENT, "Force [kN]": 1e-3 * FORCE})
    model = ces.identify(table, **QUICK)
    assert "proved stable" in repr(model) and "DataFrame" in repr(model) and "<table" in model._repr_html_()
    simulated = model.simulate(table)
    np.testing.assert_allclose(simulated, model.simulate(T, X, CURRENT), atol=1e-6)
    assert simulated.index.equals(table.index) and model.predict(table).index.equals(table.index)
    assert (np.isfinite(model.predict(table, steps=5)) == np.isfinite(simulated)).all()
    frame = model.to_frame()
    assert len(frame) == len(model.body.terms) and (frame["standard_error"] >= 0.0).all()
    page = model.report(tmp_path / "report.html", note="first <try>")
    assert "first &lt;try&gt;" in page.read_text(encoding="utf-8")
    again = model.report(tmp_path / "again.html", table)
    assert again.read_text(encoding="utf-8").count('class="role') == page.read_text(encoding="utf-8").count(
        'class="role'
    )
    model.save(tmp_path / "model.json")
    assert ces.Model.load(tmp_path / "model.json").body == model.body
    assert isinstance(ces.Estimator(tmp_path / "model.json"), Estimator)


def test_a_prediction_uses_the_measured_force_and_many_steps_are_a_simulation(model, road):
    force, simulated = road.channel("force"), model.simulate(road)
    at = np.interp(road.channel("position").stamps_ns, force.stamps_ns, force.values)
    late = np.isfinite(simulated)
    near, far = (np.std((model.predict(road, steps) - at)[late]) for steps in (1, 20))
    assert near < 0.6 * far <= 0.6 * 1.05 * np.std((simulated - at)[late])
    with pytest.warns(UserWarning, match="steps: 99999 ticks are longer than any stretch of road"):
        np.testing.assert_array_equal(model.predict(road, 99_999), simulated)


def test_a_prediction_without_measured_forces_is_said_to_be_a_simulation(model, road):
    pytest.importorskip("pandas")
    table = road.to_frame()
    table.loc[table.index[len(table) // 2 :], "force_N"] = np.nan
    with pytest.warns(UserWarning, match=r"no force was measured for 5\d\.\d% of the time: there it is simulated"):
        model.predict(table)


def test_standard_errors_cover_the_truth():
    pytest.importorskip("pandas")
    dice, t = np.random.default_rng(3), np.arange(0.0, 30.0, 0.004)
    x = sum(0.004 * np.sin(2 * np.pi * hz * t + hz) for hz in (0.6, 1.7, 3.1, 5.3))
    noisy = [2000.0 * np.gradient(x, t) + dice.normal(0.0, 40.0, len(t)) for _ in range(2)]
    frames = [
        ces.identify(
            {"time_s": t, "position_m": x, "current_A": 0.5, "force_N": f}, terms=1, starts=1, time=5.0
        ).to_frame()
        for f in noisy
    ]
    (a, b) = ((float(f["coefficient"][0]), float(f["standard_error"][0])) for f in frames)
    assert abs(a[0] - b[0]) < 4.0 * np.hypot(a[1], b[1]) and 0.0 < a[1] < 0.05 * abs(a[0])


def test_a_model_from_a_file_shows_the_costs_of_its_identification(model):
    row = {"recording": "noise", "role": "identification", "J": 4.94}
    known = replace(model, provenance={"cost_J_percent": [row, {**row, "role": "validation", "J": None}]})
    assert repr(known).splitlines()[-2].split() == ["noise", "identification", "4.94", "–"]
    assert (known.evaluations[0].cost, known.evaluations[1].interval) == (4.94, None)
    with pytest.raises(AttributeError, match="KnownCost has no 'error'"):
        _ = known.evaluations[0].error
    with pytest.raises(IndexError, match="provenance\\['selection'\\]"):
        _ = known.search_results[0]
    full = row | {"low": 4.61, "high": 5.29, "rms_N": 61.23, "outside": 0.0, "band": 91.2}
    shown = repr(replace(model, provenance={"cost_J_percent": [full, row]})).splitlines()
    assert shown[-2].split() == ["noise", "identification", "4.9", "4.6", "to", "5.3", "61.2", "0.0", "91.2"]
    assert "<td" in known._repr_html_()
    assert repr(replace(model, provenance={"cost_J_percent": 3})) == model._describe()


def test_steady_forces_follow_speed_and_current(model):
    pytest.importorskip("pandas")
    forces = model.force_speed([0.3, 0.7], [-0.4, 0.4])
    assert (forces.index.name, forces.columns.name) == ("speed_m_s", "current_A")
    assert (forces.loc[0.4] > forces.loc[-0.4]).all() and forces.loc[0.4, 0.7] > forces.loc[0.4, 0.3]
    low, high = model.envelope.speed_m_s
    with pytest.warns(UserWarning, match=f"{high:g} m/s is taken"):
        assert list(model.force_speed(0.5, [0.0, 1.001 * high]).index) == [0.0, high]
    whole = model.force_speed()
    assert whole.index[0] == low and whole.index[-1] == high and 1 < len(whole.columns) <= 5
    for known, recorded in (((-0.1, 1.1), (0.0, 1.0)), ((1 / 3, 1 / 3), (1 / 3, 1 / 3))):  # the envelope is wider
        within = replace(model, envelope=replace(model.envelope, current_A=known))
        assert tuple(within.force_speed(speeds=0.1).columns[[0, -1]]) == recorded


DOUBTS = {
    "its own recording": (lambda m, r: m.validate(r), "identified on seconds of this recording"),
    "another current": (lambda m, r: m.simulate(T, X, 0.0), "outside the model's envelope for 100.0 % of the time"),
    "mA": (
        lambda m, r: ces.simulate(m, time_s=T, position_m=X, current_A=500.0),
        "multiply it by 0.001 if it is in mA",
    ),
    "a short ride": (
        lambda m, r: m.simulate(T[:300], X[:300], 0.5),
        "no force for 83.3 % of the time: a warm-up of 0.5",
    ),
    "another damper": (lambda m, r: ces.validate(m, columns(current_A=0.0 * T)), "outside the model's envelope for"),
    "other signs": (
        lambda m, r: m.validate(
            ces.Recording.from_arrays(T, -X, 0.5, -np.nan_to_num(m.simulate(T, X, 0.5))).part(1, 6),
        ),
        "sign",
    ),
}


@pytest.mark.parametrize(("call", "text"), DOUBTS.values(), ids=DOUBTS)
def test_what_a_program_warns_of_is_a_warning_at_the_callers_line(call, text, model, road):
    with pytest.warns(UserWarning, match=text) as caught:
        call(model, road)
    assert any(warning.filename == __file__ for warning in caught)


def test_a_recording_is_cut_resampled_shown_and_written(road, tmp_path):
    part = road.part(2.0, 5.0)
    assert len(part) == 3000 and part.duration_s == pytest.approx(3.0, abs=0.01) and "2-5 s" in repr(part)
    assert without_spikes(part, split=0.75).duration_s == part.duration_s
    even = part.resample(250.0)
    assert len(even) == pytest.approx(750, abs=2) and set(even.channels) == {"position", "current", "force"}
    part.save(tmp_path / "bag")
    assert len(ces.Recording.load(tmp_path / "bag")) == len(part)
    assert "<table" in road._repr_html_() and "position" in repr(road)


WRITERS = {
    "model.json": lambda m, r, path, more: m.save(path, **more),
    "page.html": lambda m, r, path, more: m.report(path, r, **more),
    "bag": lambda m, r, path, more: r.save(path, **more),
    "compared.html": lambda m, r, path, more: ces.compare([m, lambda t, x, i: 9.0 * x], r, report=path, **more),
    "folder": lambda m, r, path, more: ces.characterise(r, out=path, **more),
}


@pytest.mark.parametrize(("name", "write"), WRITERS.items())
def test_what_exists_is_replaced_only_if_that_is_asked_for(name, write, model, road, tmp_path):
    part = road.part(2, 8)
    write(model, part, tmp_path / name, {})
    with pytest.raises(ces.CesError, match=f"{name}: exists; choose another name.*overwrite=True"):
        write(model, part, tmp_path / name, {})
    write(model, part, tmp_path / name, {"overwrite": True})


MISTAKES = {
    "no recording": (lambda m, r: ces.identify([]), "no recording given"),
    "a number": (lambda m, r: ces.identify(5), "recordings: expected a recording, a path, a table, or several"),
    "an empty path": (lambda m, r: ces.identify(""), "recording: the path is empty"),
    "signals of a table": (
        lambda m, r: ces.identify(columns(), signals="mine.yaml"),
        "signals: describes the topics of bags; there is none here",
    ),
    "progress": (lambda m, r: ces.identify(r, progress=5), "progress: expected a function of"),
    "seconds as text": (lambda m, r: r.part("1", "3"), "no part from '1' s to '3' s"),
    "no numbers": (lambda m, r: ces.identify(columns(position_m=np.nan)), "'position_m' holds too few numbers"),
    "no such bag": (lambda m, r: ces.identify("none"), "none: no such file or folder"),
    "time as text": (lambda m, r: ces.identify(r, time="ten"), "time is 'ten'; expected a number from"),
    "a region": (lambda m, r: ces.identify(r, weight="much"), "weight='much': expected"),
    "two delays": (lambda m, r: ces.identify(r, delay=(0, 0.003)), "expected a number from 0 to 0.02 s"),
    "terms of a network": (
        lambda m, r: ces.identify(r, structure="hydraulic", terms=3),
        "terms applies to structure='polynomial' or auto",
    ),
    "a structure": (lambda m, r: ces.identify(r, structure="tree"), "structure is 'tree'; expected one of"),
    "a size": (
        lambda m, r: ces.identify(r, structure="sigmoid", unit=3),
        "unit: is no option.*did you mean 'units'",
    ),
    "no force": (lambda m, r: ces.identify(without_force()), "arrays: force: nothing is named like it"),
    "mm as m": (lambda m, r: ces.identify(columns(position_m=1e3 * X)), "more than any damper"),
    "backward times": (lambda m, r: ces.identify(columns(time_s=T[::-1])), "newest row is first; reverse the rows"),
    "text as force": (
        lambda m, r: ces.identify(columns(force_N=["a"] * len(T))),
        "force: row 0 of column 'force_N' is 'a'; expected a number",
    ),
    "lengths": (lambda m, r: ces.identify(columns(force_N=FORCE[1:])), "has 2999 values for 3000 rows"),
    "nothing to simulate": (lambda m, r: m.simulate(T), "expected a recording, a path"),
    "two recordings": (lambda m, r: m.simulate([r, r]), "2 recordings given; expected one"),
    "fewer positions": (lambda m, r: m.simulate(T, X[1:], 0.5), "position: has 2999 values for 3000 times"),
    "text as current": (
        lambda m, r: m.simulate(T, X, "0.5"),
        "current: expected an array of numbers; got a value of type",
    ),
    "no current": (lambda m, r: m.simulate(T, X), "current_A: is missing; expected a recording, or all of time_s"),
    "times that are missing": (lambda m, r: m.simulate(T * np.nan, X, 0.5), "time_s: is nan in row 0"),
    "a page that is none": (lambda m, r: m.report("rep.pdf", r), "a report is an HTML page; expected a name"),
    "half a step": (lambda m, r: m.predict(r, 2.5), "steps: is 2.5; expected a whole number"),
    "a current beyond": (
        lambda m, r: m.force_speed(9.0, 0.1),
        "currents: 9 A; the model knows 0.25.* \\(envelope\\)",
    ),
    "no currents": (lambda m, r: m.force_speed([], 0.1), "currents: expected numbers"),
    "a teacher": (lambda m, r: ces.identify(r, teacher=3), "teacher: expected a model, a function or a path; got"),
    "no option": (
        lambda m, r: ces.identify(r, option=3),
        "option: is no option of identify; expected one of (?!.*options)",
    ),
    "a model": (lambda m, r: ces.validate(None, r), "model: expected a model, a function or a path; got None"),
    "no such model": (lambda m, r: ces.Estimator("x.json"), "x.json: no such model file"),
    "a model's type": (lambda m, r: ces.Estimator(5), "model: expected a model or the path of its file; got"),
    "a mistyped option": (lambda m, r: ces.identify(r, tims=5), "tims: is no option of identify; did you mean 'time'"),
    "the program's option": (lambda m, r: ces.identify(r, validate=r), "did you mean 'validation'"),
    "one model": (ces.compare, "models: 1 given; expected 2"),
    "several models": (lambda m, r: ces.validate({"a": m}, r), "model: expected one; ces.compare takes several"),
    "another function's role": (lambda m, r: ces.identify(r, held_out=r), "did you mean 'validation'"),
    "another tool's option": (lambda m, r: ces.identify(r, random_state=0), "did you mean 'seed'"),
    "a path as a recording": (lambda m, r: ces.Recording("bags/road"), "is read by Recording.load"),
    "a path as a model": (lambda m, r: ces.Model("model.json"), "is read by Model.load"),
    "signals by column": (
        lambda m, r: ces.Recording.from_frame(columns(), columns={"position_m": "position"}),
        "'position_m' is a column",
    ),
    "mm": (lambda m, r: m.simulate(T, 1e3 * X, CURRENT), r"positions are beyond .*; check unit \(m\)"),
    "current for position": (lambda m, r: m.simulate(T, CURRENT, X), "exchanged with the current"),
    "a text as a current": (lambda m, r: m.force_speed("0.5"), "currents: expected numbers; got '0.5'"),
    "a glob of nothing": (lambda m, r: ces.identify("none*"), r"none\*: no bag matches"),
    "a stamp in seconds": (lambda m, r: ces.Estimator(m).step(7.0, 0.0, 0.5), "stamp_ns: is 7.0; expected whole nano"),
    "no position": (lambda m, r: ces.Estimator(m).step(7, None, 0.5), "position_m: is None; expected a number"),
    "a current as text": (lambda m, r: ces.Estimator(m).step(7, 0.0, "1"), "current_A: is '1'; expected a number"),
    "no path": (lambda m, r: ces.DamperModel().fit(["none.csv"]), "none.csv: no such file"),
    "a simulation": (
        lambda m, r: ces.diagnose(3, r),
        "simulation: expected a model, a function or a path; got a value of type int",
    ),
    "a file's kind": (lambda m, r: ces.diagnose("foo", r), "'foo' is no simulation; expected MODEL.json"),
    "an option": (
        lambda m, r: ces.diagnose(m, r, effect="x"),
        "effect: is no option of diagnose; did you mean",
    ),
    "an effect's name": (
        lambda m, r: ces.diagnose(m, r, effects=("friction",)),
        "effects: expected effects of your own",
    ),
    "threads": (lambda m, r: ces.diagnose(m, r, threads="two"), "threads is 'two'; expected a whole number"),
    "no range": (lambda m, r: ces.calibrate(m, r, fit={"knee": 3}), "fit: knee is 3; expected \\(LOW, HIGH\\)"),
    "a parameter": (lambda m, r: ces.calibrate(lambda t, x, i, *, c=2.0: c * x, r, fit="z"), "has no such parameter"),
    "a part": (lambda m, r: r.part(5, 2), "expected 0 <= from < to"),
    "a part beyond": (lambda m, r: r.part(500), "no part from 500 s to inf s; it has 21.999 s"),
    "a rate": (lambda m, r: r.resample(0), "expected a rate above 0"),
    "a column": (lambda m, r: ces.Recording.from_frame(columns(), columns={"position": "z"}), "no column 'z'"),
    "columns": (lambda m, r: ces.Recording.from_frame(columns(), columns="x"), "columns: expected columns by signal"),
    "a unit": (
        lambda m, r: ces.Recording.from_frame(columns(), columns={"force": {"column": "force_N", "unit": "furlong"}}),
        "unit is 'furlong'; expected N, kN, daN, .*kgf$",
    ),
    "no validation": (lambda m, r: ces.identify(r, validation=None), "^validation: expected a recording"),
    "no held-out one": (lambda m, r: ces.diagnose(m, r, held_out=3), "^held_out: expected a recording"),
    "a table by name": (lambda m, r: m.validate({"north": without_force()}), "^north: force: nothing is named like"),
    "a recording as model": (lambda m, r: ces.characterise(r, model=r), "^model: expected a model, a function or"),
    "a recording's type": (lambda m, r: ces.Estimator(r), "path of its file; got Recording$"),
    "an option of another": (lambda m, r: ces.diagnose(m, r, time=9), "is no option of diagnose; expected one of"),
    "a folder like a page": (lambda m, r: ces.characterise(r, out="c.html"), "named like a file; .* a folder"),
    "a list": (lambda m, r: ces.Recording.from_frame([1, 2]), "expected a DataFrame or a mapping of arrays"),
    "an estimator": (lambda m, r: ces.DamperModel().predict(r), "not fitted yet; call fit first"),
    "rows": (
        lambda m, r: ces.DamperModel().fit(np.zeros((9, 2)), np.zeros(9)),
        "X has n_samples = 9, n_features = 2; expected",
    ),
}


@pytest.mark.parametrize(("call", "text"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_one_line(call, text, model, road, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ces.CesError, match=text) as error:
        call(model, road)
    assert "\n" not in str(error.value)


def test_a_script_hears_of_each_step_and_a_terminal_shows_one_line(capsys, monkeypatch):
    heard = []
    ces.identify(columns(), progress=lambda step, share: heard.append(step), **QUICK)
    assert heard[0] == "identifying: preparing the recordings" and any("cost J" in step for step in heard)
    assert not capsys.readouterr().err
    monkeypatch.setattr(progress, "EVERY_S", 0.01)
    with progress.show_progress(True) as tell:
        tell("fitting", 0.25)
        time.sleep(0.2)
    text = capsys.readouterr().err
    assert "\r   0 s  fitting, 25%" in text and "\n" not in text and text.endswith(f"{'':{progress.WIDTH}}\r")
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)  # as where nobody looks
    with progress.show_progress(None) as tell:
        tell("unseen", 0.0)
        time.sleep(0.05)
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    ("look", "text"),
    [
        (lambda m, r: ces.Identify, "did you mean 'identify'"),
        (lambda m, r: m.rms_N, "Model has no 'rms_N'; model.evaluations has it"),
        (lambda m, r: m.enveloppe, "did you mean 'envelope'"),
        (lambda m, r: m.envelope.current, "did you mean 'current_A'"),
        (lambda m, r: m.evaluations.cost, r"its results have, such as \[0\]\.cost"),
        (lambda m, r: r.chanels, "did you mean 'channel"),
    ],
)
def test_an_unknown_name_is_answered_with_the_near_one(look, text, model, road):
    with pytest.raises(AttributeError, match=text):
        look(model, road)


def test_a_stroke_that_stands_still_has_a_force(model):
    with pytest.warns(UserWarning, match="constant at 0.005 m"):
        force = model.simulate(T, 0.005, 0.5)
    assert np.ptp(force[1500:]) == 0.0


def test_results_print_a_few_lines_and_a_table(road):
    model, other = ces.Model.load(MODEL), ces.Model.load(MODEL)
    for result in (ces.compare({"a": model, "b": other}, road), ces.characterise(road), ces.validate(model, road)[0]):
        assert "array(" not in repr(result) and repr(result).count("\n") < 30
        assert result._repr_html_().startswith("<p>")


def test_a_plot_shows_the_band_and_times_outside_the_envelope(model, road):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    slow = {"time_s": T, "position_m": X, "current_A": np.where(T < 3.0, 0.5, 5.0)}
    axes = model.plot(slow).axes[0]
    assert axes.get_legend_handles_labels()[1] == ["simulated", "band (90 %)", "outside the envelope"]
    (line,) = axes.lines
    shown = np.isfinite(line.get_ydata())
    assert not shown[line.get_xdata() < model.warm_up_s - 0.01].any() and shown[-1]  # as `simulate`
    pyplot.close("all")
