"""Recordings from DataFrames and arrays: the right numbers, or a word on what is doubted."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from planted_dampers import planted_model

import ces
from ces_data.reading import describe_finding
from ces_identify.scripting.model import as_model

ROOT = Path(__file__).resolve().parents[2]
MODEL = ROOT / "config/models/sample.json"
T = np.arange(0.0, 4.0, 0.002)
X = 0.02 * np.sin(6.0 * T) + 0.003 * np.sin(31.0 * T)
FORCE = 1500.0 * np.gradient(X, T)


def table(**changes):
    columns = {"t_s": T, "x_mm": 1e3 * X, "F_kN": 1e-3 * FORCE, "I_A": np.full(len(T), 0.5)}
    return {name: values for name, values in {**columns, **changes}.items() if values is not None}


def values(recording, signal):
    return recording.channel(signal).values


@pytest.mark.parametrize(
    "columns",
    [
        {},
        {"force": "F_kN"},
        {"time": "t_s", "position": "x_mm", "current": "I_A", "force": "F_kN"},
        {"position": {"column": "x_mm"}, "current": 0.5},
    ],
    ids=["found", "force named", "all named", "mapping without unit"],
)
def test_a_named_column_has_the_unit_in_its_name(columns):
    recording = ces.Recording.from_frame(table(), columns=columns)
    np.testing.assert_allclose(values(recording, "position"), X)
    np.testing.assert_allclose(values(recording, "force"), FORCE)
    np.testing.assert_allclose(values(recording, "current"), 0.5)


def test_a_named_column_is_not_turned():
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        recording = ces.Recording.from_frame(table(F_kN=-1e-3 * FORCE), columns={"force": "F_kN"})
    np.testing.assert_allclose(values(recording, "force"), -FORCE)
    assert not any("the force is turned" in str(w.message) for w in said)


def test_all_that_is_not_found_is_one_message(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t_s,b,c\n" + "".join(f"{t},{n % 7},{n % 5}\n" for n, t in enumerate(T)))
    why = "position and current: nothing is named like it"
    for given, where in (
        ({"t_s": T, "b": np.arange(len(T)) % 7, "c": np.arange(len(T)) % 5}, " in Recording.from_frame"),
        (path, " in Recording.load"),
    ):
        with pytest.raises(ces.CesError, match=why) as error:
            ces.simulate(MODEL, given)
        columns = "{'position': {'column': 'NAME', 'unit': 'mm'}, 'current': 'NAME'}"
        assert f"they are{where}: columns={columns}, or 'current': 0.0 for a passive" in str(error.value)


def test_an_unclear_unit_names_its_column():
    given = table(x_mm=None, stroke=1e3 * X)
    with pytest.raises(ces.CesError, match="arrays: position: perhaps mm") as error:
        ces.Recording.from_frame(given)
    assert str(error.value).endswith("columns={'position': {'column': 'stroke', 'unit': 'mm'}}")


def test_a_recording_has_the_name_it_is_given():
    pandas = pytest.importorskip("pandas")
    for name in ("r1.5", "a/b", "sweep 0.5 A"):
        frame = pandas.DataFrame(table())
        frame.attrs["name"] = name
        assert [ces.Recording.from_frame(t, name=n).name for t, n in ((table(), name), (frame, ""))] == [name, name]


def test_what_was_found_is_shown():
    shown = repr(ces.Recording.from_frame(table(), columns={"current": "I_A"}))
    assert (
        "position from 'x_mm' [mm to SI], force from 'F_kN' [kN to SI]" in shown and "current from 'I_A' [A]" in shown
    )


@pytest.mark.parametrize("named", [{}, {"position": "stroke"}, {"position": {"column": "stroke"}}], ids=str)
def test_a_unit_that_is_a_guess_is_not_taken_for_a_named_column_either(named):
    content = table(x_mm=None, stroke=2e3 * X)
    remedy = r"perhaps mm, .*; say its unit in Recording.from_frame: columns={'position': {'column': 'stroke', "
    with pytest.raises(ces.CesError, match=remedy):
        ces.Recording.from_frame(content, columns=named)
    said = ces.Recording.from_frame(content, columns={"position": {"column": "stroke", "unit": "mm"}})
    np.testing.assert_allclose(values(said, "position"), 2.0 * X)
    assert "position from 'stroke' [mm]" in repr(said)


@pytest.mark.parametrize("kind", ["datetime64[us]", "timedelta64[us]", "datetime64[ns]"])
def test_arrays_take_dates_and_durations(kind):
    times = (1e6 * T).round().astype("timedelta64[us]")
    if kind.startswith("datetime"):
        times = (np.datetime64("2026-03-01T12:00:00") + times).astype(kind)
    recording = ces.Recording.from_arrays(times, X, 0.5, FORCE)
    assert recording.duration_s == pytest.approx(T[-1], abs=1e-6)
    assert recording.day == ("2026-03-01" if kind.startswith("datetime") else "")


def test_text_that_is_a_date_is_a_time():
    dates = np.datetime_as_string(np.datetime64("2026-03-01T12:00:00") + (1e6 * T).round().astype("timedelta64[us]"))
    recording = ces.Recording.from_frame(table(t_s=None, Timestamp=list(dates)), columns={"current": 0.0})
    assert recording.duration_s == pytest.approx(T[-1], abs=1e-6) and recording.day == "2026-03-01"


SAID = {
    "a cell that is no number": (
        lambda: ces.Recording.from_frame(table(F_kN=[*map(str, 1e-3 * FORCE[:-1]), "bad"])),
        "force: row 1999 of column 'F_kN' is 'bad'; expected a number; it is not read",
    ),
    "decimal commas": (
        lambda: ces.Recording.from_frame(table(F_kN=[f"{f:.3f}".replace(".", ",") for f in 1e-3 * FORCE])),
        "expected a number; give a decimal point",
    ),
    "times in ms that are named s": (lambda: ces.Recording.from_frame(table(t_s=1e3 * T)), "if the times are in ms"),
    "a force that pulls in compression": (
        lambda: ces.Recording.from_frame(table(F_kN=-1e-3 * FORCE)),
        "force: 'F_kN' is read with its sign turned",
    ),
    "newtons that are named kN": (lambda: ces.Recording.from_frame(table(F_kN=FORCE)), "if it is in N, not kN"),
    "millimetres in position_m": (
        lambda: ces.Recording.from_arrays(T, 1e3 * X, 0.5),
        "multiply it by 0.001 if it is in mm",
    ),
    "an infinite force": (
        lambda: ces.Recording.from_arrays(T, X, 0.5, np.where(T[5] == T, np.inf, FORCE)),
        "1 of 2000 samples are NaN or infinite",
    ),
}


@pytest.mark.parametrize(("read", "text"), SAID.values(), ids=SAID)
def test_what_looks_wrong_is_said(read, text):
    with pytest.warns(UserWarning, match=text.replace(".", r"\.")):
        read()


REFUSED = {
    "no current": (
        table(I_A=None),
        "columns={'current': 'NAME'}, or 'current': 0.0 for a passive damper",
    ),
    "no time": (table(t_s=None), "columns={'time': 'NAME'}, or 'rate': 1000 [Hz] without a time"),
    "a short column": (table(x_mm=X[:-1]), "arrays: position: 'x_mm' has 1999 values for 2000 rows"),
}


@pytest.mark.parametrize(("content", "end"), REFUSED.values(), ids=REFUSED)
def test_an_error_ends_with_what_helps(content, end):
    with pytest.raises(ces.CesError) as refused:
        ces.Recording.from_frame(content)
    assert str(refused.value).endswith(end)


def test_tables_have_names_of_their_own():
    costs = repr(ces.validate(MODEL, [table(), table(F_kN=1.1e-3 * FORCE)]))
    assert "arrays 1" in costs and "arrays 2" in costs


def test_another_kind_of_file_is_named(tmp_path):
    (tmp_path / "gap.json").write_text('{"schema": "ces-gap/1"}', encoding="utf-8")
    with pytest.raises(ces.CesError, match=r"is a file of another kind, ces-gap; expected ces-model"):
        ces.Model.load(tmp_path / "gap.json")
    with pytest.raises(ces.CesError, match="such as a model, and no recording"):
        ces.identify(MODEL)


def test_a_log_takes_columns_as_a_frame_does(tmp_path):
    rows = np.column_stack([T, 1e3 * X, FORCE])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t_s,Weg_mm,Kraft_N", comments="")
    recording = ces.Recording.load(tmp_path / "log.csv", columns={"current": 0.5})
    np.testing.assert_allclose(values(recording, "position"), X, atol=1e-12)
    np.testing.assert_allclose(values(recording, "current"), 0.5)
    assert recording.sha256


def test_recordings_have_the_names_of_a_mapping():
    costs = ces.validate(MODEL, {"front": table(), 0.5: table(F_kN=1.1e-3 * FORCE)})  # 0.5, as `groupby` has it
    assert [one.name for one in costs] == ["front", "0.5"]


def test_a_simulation_has_every_row_of_the_frame():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(table())
    frame.loc[1000:1040, "x_mm"] = np.nan
    force = ces.simulate(MODEL, frame)
    assert force.index.equals(frame.index) and force[1000:1040].isna().all() and force[1900:].notna().all()


def test_a_frame_comes_back_as_it_was():
    pandas = pytest.importorskip("pandas")
    road = ces.Recording.load(ROOT / "bags/road")
    frame = road.to_frame()
    assert [*frame] == [*road.resample(100.0).to_frame()] == ["position_m", "current_A", "force_N"]
    again = ces.Recording.from_frame(frame)
    np.testing.assert_allclose(again.channel("position").values, road.channel("position").values)
    dated = frame.set_index(pandas.Timestamp("2026-03-01 12:00", tz="UTC") + pandas.to_timedelta(frame.index, unit="s"))
    seconds = dated.set_index(dated.index - dated.index[0])
    plain = frame.set_axis(frame.index.to_numpy())  # fractions without a name
    for other in (
        dated,
        seconds,
        plain,
        plain.assign(time=frame.index),
        {name: frame[name].to_numpy() for name in frame} | {"time_s": frame.index.to_numpy()},
    ):
        assert ces.Recording.from_frame(other).duration_s == pytest.approx(road.duration_s, abs=1e-6)


def test_results_have_frames_and_a_comparison_a_plot():
    pandas = pytest.importorskip("pandas")
    pyplot = pytest.importorskip("matplotlib.pyplot")
    part = ces.Recording.load(ROOT / "bags/road").part(0, 12)
    costs = ces.validate(MODEL, part)
    frame = costs.to_frame()
    assert frame["J_percent"][0] == costs[0].cost and frame["low_percent"][0] < costs[0].cost < frame["high_percent"][0]
    pair = ces.compare([MODEL, lambda t, x, i: 3000.0 * np.gradient(x, t)], part)
    assert len(repr(pair.models)) < 2000 and ces.DamperModel(terms=3).get_params()["terms"] == 3
    assert list(pair.to_frame()["J_percent"]) == [one.costs[0].cost for one in pair.models]
    (axes,) = pair.plot().axes
    labels = axes.get_legend_handles_labels()[1]
    assert labels[0] == "measured" and all(": J = " in label for label in labels[1:]) and len(labels) == 3
    pyplot.close("all")
    tables = ces.characterise(part)
    assert len(tables.to_frame("speed_bins")) == len(tables.speed_bins) > 0
    assert isinstance(tables.to_frame(), pandas.DataFrame)
    with pytest.raises(ces.CesError, match="'loop': is no table; did you mean 'loops'"):
        tables.to_frame("loop")


def test_stamps_that_are_no_nanoseconds_are_told():
    estimator = ces.Estimator(MODEL)
    assert all(estimator.step(k, 0.01, 0.5) is None for k in range(500))
    assert estimator.reason.startswith("warming up: the stamps hardly go on; expected whole nanoseconds")


@pytest.mark.parametrize(("rate_Hz", "why"), [(50, "at about 50 Hz; this model needs 58 Hz or more"), (250, "")])
def test_too_few_positions_a_second_are_named_as_the_cause(model, road, rate_Hz, why):
    slow, estimator = road.resample(rate_Hz), ces.Estimator(model)
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        model.validate(slow)
        force = model.simulate(slow)
    for stamp_ns, x in zip(slow.channel("position").stamps_ns.tolist(), slow.channel("position").values, strict=True):
        last = estimator.step(stamp_ns, x, 0.5)
    assert np.isfinite(force).any() == (last is not None) == (not why)
    assert estimator.reason == (f"warming up: positions come {why}" if why else "ok")
    texts = [str(warning.message) for warning in given]
    for start in ("road: on the vehicle there is no force at 100 %", "road: no force for 100.0 %") * bool(why):
        assert any(text.startswith(start) and text.endswith(why) for text in texts)
    assert why or not any("no force" in text for text in texts)
    estimator.reset()
    assert estimator.step(0, 0.01, 0.5) is None and estimator.step(1_000_000, 0.01, 0.5) is None
    assert estimator.reason == "warming up"


def test_the_door_warns_of_what_the_error_depends_on_with_its_own_words(model, monkeypatch):
    lines = ["The error depends on the speed: try --structure auto, or more --starts."]
    monkeypatch.setattr("ces_identify.scripting.model.head_lines", lambda own, evaluations: lines * len(evaluations))
    with pytest.warns(UserWarning, match='the speed: try structure="auto", or more starts'):
        model.validate(ROOT / "bags/road")
    with pytest.warns(UserWarning, match='the speed: try structure="auto", or more starts'):
        ces.identify(table(), terms=1, starts=1, time=2.0, band=False)


def test_one_evaluation_has_a_table_and_shows_no_internals(model, road):
    (one,) = evaluations = model.validate(road)
    assert one.to_frame().equals(evaluations.to_frame())
    with pytest.raises(AttributeError) as error:
        _ = one.qqq
    assert "to_frame" in str(error.value) and "_text" not in str(error.value)


def test_a_model_without_a_past_force_says_so_and_why_its_quantities_have_no_intervals(road):
    damper = as_model(planted_model("uniflow"))
    with pytest.warns(UserWarning, match="steps: 'hydraulic.* has no past force in it: what it predicts is what it"):
        damper.predict(road, 5)
    with pytest.warns(UserWarning, match="no 95 % intervals of the quantities: .* no time for them: give more time"):
        damper.to_frame()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("Spannung [V]", "its unit is V, no current; give its scale in A per V"),
        ("voltage_V", "its unit is V, no current; give its scale in A per V"),
        ("current [%]", "'%', which is not one of a current; give its scale"),
        ("current [Ohm]", "'Ohm', which is not one of a current; give its scale"),
        ("current [N]", "its unit N is not one of a current"),
    ],
)
def test_another_quantity_is_no_current(name, text):
    given = table(I_A=None, **{name: np.full(len(T), 0.5)})
    with pytest.raises(ces.CesError, match="current: .*" + text) as found:
        ces.Recording.from_frame(given)
    with pytest.raises(ces.CesError, match=r"scale|expected A, mA$"):
        ces.Recording.from_frame(given, columns={"current": name})
    if "scale" in text:
        assert f"columns={{'current': {{'column': '{name}', 'scale': 'A per unit'}}}}" in str(found.value)
        recording = ces.Recording.from_frame(given, columns={"current": {"column": name, "scale": 0.5}})
        np.testing.assert_allclose(values(recording, "current"), 0.25)


@pytest.mark.parametrize("current", ["I_A", "current", "valve [A]"])
def test_a_voltage_beside_a_current_is_left_out(current):
    given = table(**{"I_A": None, "supply [V]": 12.0 + 0.1 * np.sin(T), current: np.full(len(T), 0.5)})
    np.testing.assert_allclose(values(ces.Recording.from_frame(given), "current"), 0.5)


def test_a_force_in_another_unit_is_not_left_out_silently():
    with pytest.warns(UserWarning, match=r"force: 'Kraft \[m\]' is named like it, but its unit m .* it is not read"):
        ces.Recording.from_frame(table(F_kN=None, **{"Kraft [m]": FORCE}))


@pytest.mark.parametrize("name", ["part_3A", "axle_12A run", "test 0.3A and 0.9A"])
def test_the_name_of_a_table_is_no_current(name):
    with pytest.raises(ces.CesError, match=r"current: the name says [0-9. and]+ A, but no column"):
        ces.Recording.from_frame(table(I_A=None), name=name)


def test_the_current_of_a_files_name_is_said(tmp_path):
    head, rows = "t_s,x_mm,F_kN,supply [V]\n", zip(T, 1e3 * X, 1e-3 * FORCE, 12.0 + 0.1 * np.sin(T), strict=True)
    text = head + "".join(",".join(map(repr, map(float, row))) + "\n" for row in rows)
    for name in ("run_0.5A.csv", "run_0.5A_0.9A.csv"):
        (tmp_path / name).write_text(text)
    with pytest.warns(UserWarning, match="current: 0.5 A, as the file's name says"):
        recording = ces.Recording.load(tmp_path / "run_0.5A.csv")
    np.testing.assert_allclose(values(recording, "current"), 0.5)
    with pytest.raises(ces.CesError, match="current: its unit is V"):
        ces.Recording.load(tmp_path / "run_0.5A_0.9A.csv")


def test_a_position_at_rest_is_one_by_its_name_and_unit():
    noise = 0.001 * np.random.default_rng(1).standard_normal(len(T))
    recording = ces.Recording.from_frame(table(x_mm=None, **{"Weg [mm]": noise}))
    np.testing.assert_allclose(values(recording, "position"), 1e-3 * noise)
    with pytest.raises(ces.CesError, match=r"jumps like noise .* or rests: a span of 0\.00\d+ without a unit"):
        ces.Recording.from_frame(table(x_mm=None, Weg=noise))


def test_a_late_force_is_corrected_by_its_delay():
    late = table(F_kN=1e-3 * np.interp(T - 0.03, T, FORCE))
    advice = describe_finding("force: add 0.030 to the key delay (default 0) of force in the signals file")
    assert advice == "force: add 0.030 to the delay (in from_frame's columns={...}, default 0) of force"
    moved = ces.Recording.from_frame(late, columns={"force": {"column": "F_kN", "delay": 0.03}})
    stamps = {name: channel.stamps_ns for name, channel in moved.channels.items()}
    np.testing.assert_array_equal(stamps["position"] - stamps["force"], 30_000_000)
    assert stamps["force"][0] == 0
    with pytest.raises(ces.CesError, match="time: delay is 1; expected it for signals only"):
        ces.Recording.from_frame(late, columns={"time": {"column": "t_s", "delay": 1}})


def test_a_rate_beside_a_time_that_contradicts_it_is_said():
    with pytest.warns(UserWarning, match="rate: 250 Hz takes the place of the times in 't_s', which give 500 Hz"):
        recording = ces.Recording.from_frame(table(), columns={"rate": 250})
    assert recording.duration_s == pytest.approx(2.0 * T[-1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ces.Recording.from_frame(table(), columns={"rate": 500})


@pytest.mark.parametrize(
    ("columns", "text"),
    [
        ({"time": 0}, r"time is 0; expected the name of a column, or \{'column': 0\} for the first"),
        ({"rate": "1kHz"}, r"rate is '1kHz'; expected a number \[Hz\], or the name of a column"),
    ],
)
def test_a_time_or_rate_of_another_form_is_named(columns, text):
    with pytest.raises(ces.CesError, match=text):
        ces.Recording.from_frame(table(), columns=columns)


def test_load_reads_one_recording_and_names_the_near_one():
    with pytest.raises(ces.CesError, match=r"\*: names 4 recordings \(.*noise.*\); expected one"):
        ces.Recording.load(ROOT / "bags/*")
    with pytest.raises(ces.CesError, match=r"raod: no such file or folder; did you mean '.*bags/road'"):
        ces.Recording.load(ROOT / "bags/raod")
    assert ces.Recording.load(ROOT / "bags/roa*").name == "road"


def test_recordings_of_one_name_are_told_apart():
    costs = ces.validate(MODEL, [ces.Recording.from_frame(table(x_mm=x_mm), name="run") for x_mm in (1e3 * X, 2e3 * X)])
    assert [row.name for row in costs] == ["run", "run (2)"]
